"""Rotations by the thousand: exponential and logarithm on arrays (splitslam.se3 has them for one)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def hats(w: Array) -> Array:
    """(N, 3) -> (N, 3, 3) cross-product matrices."""
    K = np.zeros((len(w), 3, 3))
    K[:, 2, 1], K[:, 0, 2], K[:, 1, 0] = w.T
    return K - K.transpose(0, 2, 1)


def exps(w: Array) -> Array:
    """Rotation vectors (N, 3), rad -> (N, 3, 3). Rodrigues' formula."""
    theta = np.linalg.norm(w, axis=1)[:, None, None]
    K = hats(w)
    return np.eye(3) + np.sinc(theta / np.pi) * K + 0.5 * np.sinc(theta / (2 * np.pi)) ** 2 * (K @ K)


def logs(R: Array) -> Array:
    """(N, 3, 3) -> rotation vectors (N, 3), rad; for angles that stay away from 180 degrees."""
    v = 0.5 * np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=1)
    sine = np.linalg.norm(v, axis=1)
    theta = np.arctan2(sine, 0.5 * (np.trace(R, axis1=1, axis2=2) - 1.0))
    return v * np.where(sine > 1e-9, theta / np.maximum(sine, 1e-12), 1.0)[:, None]


def increments(R: Array) -> Array:
    """Rotations (N, 3, 3) -> rotation vectors (N - 1, 3) from each to the next, in the frame of the earlier one."""
    return logs(R[:-1].transpose(0, 2, 1) @ R[1:])
