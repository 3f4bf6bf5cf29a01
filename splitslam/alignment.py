"""Two trajectories brought together: interpolated to common stamps, moved rigidly onto each other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from splitslam import se3
from splitslam.tum import Trajectory

Array = NDArray[np.float64]


def interpolate(trajectory: Trajectory, stamps_ns: NDArray[np.int64]) -> Trajectory:
    """Poses at `stamps_ns` (M,) int64 in the trajectory's time span: translation linear, rotation by slerp."""
    if len(trajectory) == 1:
        rows = np.zeros(len(stamps_ns), np.intp)
        return Trajectory(stamps_ns, trajectory.positions_m[rows], trajectory.quats_xyzw[rows])
    before = np.searchsorted(trajectory.stamps_ns, stamps_ns, side="right").clip(1, len(trajectory) - 1) - 1
    start_ns = trajectory.stamps_ns[before]
    ratio = ((stamps_ns - start_ns) / (trajectory.stamps_ns[before + 1] - start_ns))[:, None]
    positions_m = (1.0 - ratio) * trajectory.positions_m[before] + ratio * trajectory.positions_m[before + 1]
    quats = _slerp(trajectory.quats_xyzw[before], trajectory.quats_xyzw[before + 1], ratio)
    return Trajectory(stamps_ns, positions_m, quats)


def aligned(estimate: Trajectory, reference: Trajectory) -> Array:
    """Positions (N, 3) of `estimate`, moved rigidly onto those of `reference` (same stamps), least squares."""
    T_reference_estimate = umeyama(estimate.positions_m, reference.positions_m)
    return estimate.positions_m @ T_reference_estimate[:3, :3].T + T_reference_estimate[:3, 3]


def umeyama(points_a: Array, points_b: Array) -> Array:
    """T_b_a (4, 4), the rigid transform of least squares that maps `points_a` (N, 3) onto `points_b` (N, 3).

    Umeyama, "Least-squares estimation of transformation parameters between two point patterns", 1991, eq. 40, scale 1.
    """
    centre_a, centre_b = points_a.mean(axis=0), points_b.mean(axis=0)
    U, _, Vt = np.linalg.svd((points_b - centre_b).T @ (points_a - centre_a))
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    return se3.compose(R, centre_b - R @ centre_a)


def _slerp(a_xyzw: Array, b_xyzw: Array, ratio: Array) -> Array:
    """Shortest way from a to b, (M, 4) each; ratio (M, 1)."""
    dot = np.sum(a_xyzw * b_xyzw, axis=1, keepdims=True)
    b_xyzw = np.where(dot < 0.0, -b_xyzw, b_xyzw)
    angle_rad = 2.0 * np.arcsin(np.minimum(np.linalg.norm(b_xyzw - a_xyzw, axis=1, keepdims=True) / 2.0, 1.0))
    sine = np.sin(angle_rad)
    close = sine < 1e-9  # the weights' limits
    safe = np.where(close, 1.0, sine)
    weight_a = np.where(close, 1.0 - ratio, np.sin((1.0 - ratio) * angle_rad) / safe)
    weight_b = np.where(close, ratio, np.sin(ratio * angle_rad) / safe)
    quats = weight_a * a_xyzw + weight_b * b_xyzw
    return quats / np.linalg.norm(quats, axis=1, keepdims=True)
