"""A frame's motion through the coder: each part to what it means, expected to be what the knots say already."""

from __future__ import annotations

import numpy as np

from splitslam import se3
from splitslam.codec import knots as knot_grid
from splitslam.codec.coder import Coder, Integers
from splitslam.codec.knots import code_knots
from splitslam.features import Knots, Motion

ROTATION_STEP_RAD = 1e-5
TRANSLATION_STEP_M = 1e-4
VELOCITY_STEP_MPS = 1e-3
_GRAVITY_STEPS = 1 << 14  # to a unit: 0.03 mrad
_SIGMA_STEPS = 8  # to a factor of two: 4 %
_LEAST_SIGMA = 1e-6
_LARGEST_SIGMA = 65_504.0
_LIMIT = 1 << 28
_ROTATION, _TRANSLATION, _VELOCITY, _SIGMAS = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 16)
_FIELDS = (1, 2, 1, 15, 15)  # velocity known; axis and sign of the largest part of gravity, the two others


def code_motion(coder: Coder, motion: Motion | None) -> Motion:
    """The motion as it travels, or the one that is decoded; ValueError when it is not finite or not possible.

    T_prev_lidar is expected to be what the last knot says: the scan before was as long, and the rate the same. Sigmas
    (of the covariance's diagonal and of gravity) are in logarithmic steps.
    """
    knots = code_knots(coder, None if motion is None else motion.knots)
    fields, steps = ([0] * len(_FIELDS), np.zeros(16, np.int64)) if motion is None else _measure(motion)
    fields = coder.fields(fields, _FIELDS)
    expected = _expected(knots)
    steps -= expected
    steps[_SIGMAS] = np.diff(steps[_SIGMAS], prepend=0)
    steps = coder.numbers(steps)
    steps[_SIGMAS] = np.cumsum(steps[_SIGMAS])
    steps += expected
    if np.any(np.abs(steps) > _LIMIT):
        raise ValueError("motion beyond all bounds")
    return _motion(knots, fields, steps)


def _measure(motion: Motion) -> tuple[list[int], Integers]:
    sigmas = np.append(np.sqrt(np.diagonal(motion.covariance)), motion.gravity_sigma_rad)
    T, down = motion.T_prev_lidar, motion.gravity_lidar / np.linalg.norm(motion.gravity_lidar)
    parts = [se3.so3_log(T[:3, :3]), T[:3, 3], motion.velocity_lidar_mps]
    if not (all(np.all(np.isfinite(p)) for p in parts) and np.all(np.isfinite(down)) and not np.any(np.isnan(sigmas))):
        raise ValueError("motion is not finite")
    scaled = np.concatenate(
        [
            parts[0] / ROTATION_STEP_RAD,
            parts[1] / TRANSLATION_STEP_M,
            parts[2] / VELOCITY_STEP_MPS,
            _SIGMA_STEPS * np.log2(np.clip(sigmas, _LEAST_SIGMA, _LARGEST_SIGMA) / _LEAST_SIGMA),
        ]
    )
    if np.any(np.abs(scaled) > _LIMIT):
        raise ValueError("motion beyond all bounds")
    axis = int(np.argmax(np.abs(down)))
    others = np.rint(np.delete(down, axis) * _GRAVITY_STEPS).astype(int) + _GRAVITY_STEPS
    fields = [int(motion.velocity_known), axis, int(down[axis] < 0), int(others[0]), int(others[1])]
    return fields, np.rint(scaled).astype(np.int64)


def _expected(knots: Knots) -> Integers:
    """What the last knot says of the motion before the scan, and of the velocity, in whole steps."""
    rotation = np.rint(knots.rotation[-1] / knot_grid.ROTATION_UNIT_RAD).astype(np.int64)
    translation = np.rint(knots.translation_m[-1] / knot_grid.TRANSLATION_UNIT_M).astype(np.int64)
    span_us = (knots.offsets_ns[-1] - knots.offsets_ns[0]) // 1000
    expected = np.zeros(16, np.int64)
    expected[_ROTATION] = rotation // 10
    expected[_TRANSLATION] = translation // 5
    expected[_VELOCITY] = np.clip(translation * 20_000 // max(span_us, 1), -_LIMIT, _LIMIT)
    return expected


def _motion(knots: Knots, fields: list[int], steps: Integers) -> Motion:
    known, axis, negative, *others = fields
    a, b = ((value - _GRAVITY_STEPS) / _GRAVITY_STEPS for value in others)
    if axis > 2 or a * a + b * b > 0.7:
        raise ValueError("gravity is no direction")
    largest = float(np.sqrt(1.0 - a * a - b * b))
    sigmas = _LEAST_SIGMA * np.exp2(np.clip(steps[_SIGMAS], 0, 320) / _SIGMA_STEPS)
    parts = steps.astype(np.float64)
    return Motion(
        T_prev_lidar=se3.compose(
            se3.so3_exp(parts[_ROTATION] * ROTATION_STEP_RAD), parts[_TRANSLATION] * TRANSLATION_STEP_M
        ),
        covariance=np.diag(sigmas[:6] ** 2),
        velocity_lidar_mps=parts[_VELOCITY] * VELOCITY_STEP_MPS,
        knots=knots,
        gravity_lidar=np.insert(np.array([a, b]), axis, -largest if negative else largest),
        gravity_sigma_rad=float(sigmas[6]),
        velocity_known=bool(known),
    )
