"""Kernels between a frame's motion and the whole steps in which it travels."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from splitslam._motion_kernels import rotation_from_vector, vector_of
from splitslam.codec._knot_kernels import ROTATION_UNIT_RAD, TRANSLATION_UNIT_M

FASTMATH = {"contract", "nsz"}

ROTATION_STEP_RAD = 1e-5
TRANSLATION_STEP_M = 1e-4
VELOCITY_STEP_MPS = 1e-3
GRAVITY_STEPS = 1 << 14  # to a unit: 0.03 mrad
LIMIT = 1 << 28
_SIGMA_STEPS = 8  # to a factor of two: 4 %
_LEAST_SIGMA = 1e-6
_LARGEST_SIGMA = 65_504.0

# `fields`: is the velocity known; axis and sign of the largest part of gravity, the two others
FIELDS = 5
# `steps`: rotation vector, translation, velocity; sigmas of their covariance's diagonal and of gravity
STEPS = 16


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def measure(T_prev_lidar, covariance, velocity_mps, down, gravity_sigma_rad, fields, steps):
    """Fills steps, and all of fields but the first (int64); False for what is not finite or too large."""
    rotation = np.empty(3)
    vector_of(T_prev_lidar, rotation)
    for k in range(3):
        turn, way = rotation[k] / ROTATION_STEP_RAD, T_prev_lidar[k, 3] / TRANSLATION_STEP_M
        velocity = velocity_mps[k] / VELOCITY_STEP_MPS
        if not (abs(turn) <= LIMIT and abs(way) <= LIMIT and abs(velocity) <= LIMIT):
            return False
        steps[k], steps[3 + k], steps[6 + k] = round(turn), round(way), round(velocity)
    for k in range(7):
        sigma = math.sqrt(covariance[k, k]) if k < 6 else gravity_sigma_rad
        if math.isnan(sigma):
            return False
        octaves = math.log2(min(max(sigma, _LEAST_SIGMA), _LARGEST_SIGMA) / _LEAST_SIGMA)
        steps[9 + k] = round(_SIGMA_STEPS * octaves)
    norm = math.sqrt(down[0] * down[0] + down[1] * down[1] + down[2] * down[2])
    if not 0.0 < norm < math.inf:
        return False
    axis = 0
    for k in range(3):
        if abs(down[k]) > abs(down[axis]):
            axis = k
    fields[1], fields[2] = axis, 1 if down[axis] < 0 else 0
    others = 3
    for k in range(3):
        if k != axis:
            fields[others] = round(down[k] / norm * GRAVITY_STEPS) + GRAVITY_STEPS
            others += 1
    return True


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def expect(steps, rotation, translation_m, span_us, decoding):
    """steps to their differences to what the last knot says of the motion before the scan, or back; sigmas each to the
    one before. rotation, translation_m (3,): of the last knot.
    """
    sign = 1 if decoding else -1
    for k in range(3):
        turn, way = round(rotation[k] / ROTATION_UNIT_RAD), round(translation_m[k] / TRANSLATION_UNIT_M)
        velocity = way * 20_000 // max(span_us, 1)
        steps[k] += sign * (turn // 10)
        steps[3 + k] += sign * (way // 5)
        steps[6 + k] += sign * min(max(velocity, -LIMIT), LIMIT)
    if decoding:
        for k in range(10, STEPS):
            steps[k] += steps[k - 1]
    else:
        for k in range(STEPS - 1, 9, -1):
            steps[k] -= steps[k - 1]


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def place(fields, steps, T_prev_lidar, covariance, velocity_mps, down):
    """The inverse of measure; returns the sigma of gravity, rad, or -1 for no motion at all.

    T_prev_lidar (4, 4) and covariance (6, 6) come as unit and zero matrix.
    """
    a, b = fields[3] / GRAVITY_STEPS - 1.0, fields[4] / GRAVITY_STEPS - 1.0
    if fields[1] > 2 or a * a + b * b > 0.7:
        return -1.0
    for k in range(STEPS):
        if abs(steps[k]) > LIMIT:
            return -1.0
    largest = math.sqrt(1.0 - a * a - b * b)
    for k in range(3):
        down[k] = (-largest if fields[2] else largest) if k == fields[1] else a if k == (fields[1] == 0) else b
        T_prev_lidar[k, 3] = steps[3 + k] * TRANSLATION_STEP_M
        velocity_mps[k] = steps[6 + k] * VELOCITY_STEP_MPS
    w = ROTATION_STEP_RAD
    rotation_from_vector(steps[0] * w, steps[1] * w, steps[2] * w, T_prev_lidar)
    for k in range(6):
        sigma = _sigma(steps[9 + k])
        covariance[k, k] = sigma * sigma
    return _sigma(steps[15])


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def _sigma(step):
    return _LEAST_SIGMA * math.pow(2.0, min(max(step, 0), 320) / _SIGMA_STEPS)
