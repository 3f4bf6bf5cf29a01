"""Scans of made ways, as a store has them."""

from __future__ import annotations

import numpy as np

from map_service.scans import Scans
from map_service.types import State
from splitslam import se3

FRAME_NS = 100_000_000
T0_NS = 1_700_000_000_123_456_789
NOISE_RAD, NOISE_M = 2e-5, 2e-4


def circling(n: int, speed_mps: float = 1.0, seed: int = 1, noise: float = 1.0) -> np.ndarray:
    """T_map_lidar (n, 4, 4) each 0.1 s on a circle of 16 m, `noise` times as inexact; speed 0: parked."""
    rng, radius_m = np.random.default_rng(seed), 16.0
    poses = []
    for i in range(n):
        angle = speed_mps * 0.1 * i / radius_m
        at = radius_m * np.array([np.sin(angle), 1.0 - np.cos(angle), 0.0])
        T = se3.compose(se3.so3_exp(np.array([0.0, 0.0, angle])), at)
        poses.append(T @ se3.exp(noise * rng.normal(0.0, np.repeat([NOISE_RAD, NOISE_M], 3))))
    return np.array(poses)


def scans_along(way: np.ndarray, every: int = 10, seed: int = 1) -> Scans:
    """Scans (n,) answered at `way`, a keyframe each `every` of them, stamps that jitter by 20 us."""
    n, rng = len(way), np.random.default_rng(seed)
    keyframe = np.arange(n) // every
    keyframes = way[::every][keyframe]
    factor = np.linalg.cholesky(np.diag([1e-8, 1e-8, 4e-8, 1e-6, 4e-6, 1e-6]) * np.exp(rng.normal(0, 0.01, (n, 1, 1))))
    return Scans(
        seq=np.arange(1, n + 1),
        stamp_ns=T0_NS + np.arange(1, n + 1) * FRAME_NS + rng.integers(-20_000, 20_000, n),
        state=np.full(n, int(State.TRACKING)),
        keyframe=keyframe,
        T_keyframe_lidar=np.array([se3.inv(K) @ T for K, T in zip(keyframes, way, strict=True)]),
        T_map_lidar=way,
        T_map_odom=np.tile(se3.exp(np.array([0.0, 0.0, 0.5, 3.0, -2.0, 0.1])), (n, 1, 1)),
        factor=factor,
        rejected=np.full(n, "", "U64"),
        thinned=np.zeros(n, bool),
    )


def furthest(found: np.ndarray, expected: np.ndarray) -> tuple[float, float]:
    """Of poses (n, 4, 4): the largest distance, m, and angle, rad."""
    away_m = np.linalg.norm(found[:, :3, 3] - expected[:, :3, 3], axis=1).max()
    turned = max(se3.angle(se3.inv(a) @ b) for a, b in zip(found, expected, strict=True))
    return float(away_m), turned
