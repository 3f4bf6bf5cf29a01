"""A frame's motion through the coder: each part to what it means, expected to be what the knots say already."""

from __future__ import annotations

import numpy as np

from splitslam.codec import _motion_kernels as kernels
from splitslam.codec.coder import MOTION, Coder
from splitslam.codec.knots import code_knots
from splitslam.features import Motion

_WIDTHS = (1, 2, 1, 15, 15)  # bits of the fields


def code_motion(coder: Coder, motion: Motion | None) -> Motion:
    """The motion, or the one that is decoded; ValueError when it is not finite or not possible.

    T_prev_lidar is expected to be what the last knot says: the scan before was as long, and the rate the same. Sigmas
    (of the covariance's diagonal and of gravity) are in logarithmic steps.
    """
    knots = code_knots(coder, None if motion is None else motion.knots)
    fields, steps = np.zeros(kernels.FIELDS, np.int64), np.zeros(kernels.STEPS, np.int64)
    if motion is not None:
        known, T = motion.velocity_known, motion.T_prev_lidar
        down, sigma_rad = motion.gravity_lidar, motion.gravity_sigma_rad
        fields[0] = known
        if not kernels.measure(T, motion.covariance, motion.velocity_lidar_mps, down, sigma_rad, fields, steps):
            raise ValueError("motion is not finite, or beyond all bounds")
    last = knots.rotation[-1], knots.translation_m[-1], (knots.offsets_ns[-1] - knots.offsets_ns[0]) // 1000
    coder.fields(fields, _WIDTHS)
    if motion is not None:
        kernels.expect(steps, *last, False)
        coder.numbers(steps, MOTION)
        return motion
    kernels.expect(coder.numbers(steps, MOTION), *last, True)
    T_prev_lidar, covariance, velocity_mps, down = np.eye(4), np.zeros((6, 6)), np.empty(3), np.empty(3)
    gravity_sigma_rad = kernels.place(fields, steps, T_prev_lidar, covariance, velocity_mps, down)
    if gravity_sigma_rad < 0.0:
        raise ValueError("motion beyond all bounds, or gravity is no direction")
    return Motion(T_prev_lidar, covariance, velocity_mps, knots, down, gravity_sigma_rad, bool(fields[0]))
