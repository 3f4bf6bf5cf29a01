"""Frames for the codec tests: made from random beams, as a sensor would have seen them."""

from __future__ import annotations

import numpy as np

from splitslam import se3
from splitslam.codec import quantise_knots
from splitslam.features import FeatureFrame, FeatureSet, Motion
from tests.deskew.motions import HEAD_TURN_RADPS, imu_offsets, turning

ELEVATIONS_RAD = np.radians(np.arange(-15, 16, 2)).astype(np.float32)
COLUMNS = 1800


def motion(rate_hz: float = 500.0, peak_radps: float = HEAD_TURN_RADPS, quantised: bool = True) -> Motion:
    knots = turning(imu_offsets(rate_hz), peak_radps)
    return Motion(
        T_prev_lidar=se3.exp(np.array([0.01, -0.02, 0.2, 0.13, 0.01, -0.02])),
        covariance=np.diag([1e-6, 2e-6, 3e-6, 1e-4, 2e-4, 100.0]),
        velocity_lidar_mps=np.array([1.3, -0.1, 0.02]),
        knots=quantise_knots(knots) if quantised else knots,
        gravity_lidar=np.array([0.0, 0.6, -0.8]),
        gravity_sigma_rad=0.015,
        velocity_known=True,
    )


def feature_set(rng: np.random.Generator, count: int, clockwise: bool = True, spread_m: float = 0.05) -> FeatureSet:
    """`count` features of distinct cells near their beams; times follow the column, as a spinning sensor's do."""
    cells = np.sort(rng.choice(len(ELEVATIONS_RAD) * COLUMNS, count, replace=False))
    ring, column = cells // COLUMNS, cells % COLUMNS
    azimuth = (column - COLUMNS // 2) * 2 * np.pi / COLUMNS
    e = ELEVATIONS_RAD[ring].astype(np.float64)
    d = np.stack([np.cos(e) * np.cos(azimuth), np.cos(e) * np.sin(azimuth), np.sin(e)], axis=1)
    points = d * rng.uniform(0.8, 90, (count, 1)) + rng.normal(0, spread_m, (count, 3))
    turned = (700 - column if clockwise else column - 700) % COLUMNS
    t = turned * 55_555 + ring * 2_304 + rng.integers(-20_000, 20_000, count)
    return FeatureSet(
        points_lidar=points.astype(np.float32),
        ring=ring.astype(np.uint8),
        column=column.astype(np.uint16),
        t_offset_ns=np.clip(t, 0, None).astype(np.int32),
        intensity=rng.integers(0, 256, count).astype(np.uint8),
    )


def made_frame(seed: int = 0, corners: int = 80, surfs: int = 400, dense: bool = True) -> FeatureFrame:
    rng = np.random.default_rng(seed)
    return FeatureFrame(
        7, 1_700_000_000_123_456_789, dense, motion(), feature_set(rng, corners), feature_set(rng, surfs)
    )
