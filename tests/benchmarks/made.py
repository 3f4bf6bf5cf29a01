"""Trajectories with known errors for the benchmark's own tests."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from splitslam import se3
from splitslam.tum import Trajectory

Array = NDArray[np.float64]
SCAN_NS = 100_000_000


def walk(stamps_ns: NDArray[np.int64]) -> Trajectory:
    """A walker's head at `stamps_ns`: 1.3 m/s round a bend, with bob, sway and a head turn."""
    t = np.asarray(stamps_ns * 1e-9, np.float64)
    heading = 0.15 * t + 0.6 * np.exp(-((t - 6.0) ** 2))
    positions = np.stack([8.0 * np.sin(0.15 * t), 8.0 - 8.0 * np.cos(0.15 * t), np.zeros_like(t)], axis=1)
    positions += np.stack([0 * t, 0.01 * np.sin(2 * np.pi * t), 0.02 * np.sin(4 * np.pi * t)], axis=1)
    quats = np.stack([0 * t, 0 * t, np.sin(heading / 2), np.cos(heading / 2)], axis=1)
    return Trajectory(stamps_ns, np.asarray(positions, np.float64), np.asarray(quats, np.float64))


def scans(seconds: float = 12.0) -> NDArray[np.int64]:
    """(N,) stamps of scans at 10 Hz."""
    return np.arange(round(seconds * 10), dtype=np.int64) * SCAN_NS


def poses(trajectory: Trajectory) -> list[Array]:
    """(4, 4) each."""
    return [se3.from_quat(t, q) for t, q in zip(trajectory.positions_m, trajectory.quats_xyzw, strict=True)]


def trajectory(stamps_ns: NDArray[np.int64], transforms: list[Array]) -> Trajectory:
    """The way back."""
    positions = np.array([T[:3, 3] for T in transforms])
    return Trajectory(stamps_ns, positions, np.array([se3.quat_from_matrix(T[:3, :3]) for T in transforms]))
