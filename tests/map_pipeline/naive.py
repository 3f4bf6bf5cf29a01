"""Twins of the map kernels in plain Python, and a small made room."""

from __future__ import annotations

import numpy as np


def plane_fit(points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean (3,), eigenvalues ascending (3,), eigenvectors in columns."""
    values, vectors = np.linalg.eigh(np.cov(points.T, bias=True))
    return points.mean(axis=0), values, vectors


def normal_equations(points, T, fits, noise):
    """Point by point, numeric Jacobian of the distance; fits: (n, mean, axis, wide, thin, is_plane)."""
    from splitslam import se3

    H, b = np.zeros((6, 6)), np.zeros(6)
    for p, f in zip(points, fits, strict=True):
        n, mean, axis, wide, thin, plane = f

        def residual(xi, p=p, mean=mean, axis=axis, plane=plane):
            q = (T @ se3.exp(xi))[:3, :3] @ p + (T @ se3.exp(xi))[:3, 3] - mean
            return np.array([axis @ q]) if plane else q - axis * (axis @ q)

        r = residual(np.zeros(6))
        q = T[:3, :3] @ p + T[:3, 3] - mean
        along = axis @ q
        spread = (q @ q - along**2) if plane else along**2
        variance = (thin + noise[0] ** 2) * (1 + (1 + spread / (wide + 1e-4)) / n)
        weight = 1 / (1 + (r @ r) / variance / noise[1] ** 2) / variance
        step = 1e-6
        J = np.stack([(residual(step * e) - residual(-step * e)) / (2 * step) for e in np.eye(6)], axis=1)
        H += weight * J.T @ J
        b -= weight * J.T @ r
    return H, b


def room(rng: np.random.Generator, count: int, sigma_m: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Points on floor and walls of a 12 x 8 x 3 m room, and on six vertical poles: surfs (N, 3), corners (M, 3)."""
    u = rng.uniform(0, 1, (count, 2))
    faces = rng.integers(0, 5, count)
    surfs = np.empty((count, 3))
    for k, (a, b) in enumerate(u):
        surfs[k] = [
            [12 * a - 6, 8 * b - 4, 0],
            [-6, 8 * a - 4, 3 * b],
            [6, 8 * a - 4, 3 * b],
            [12 * a - 6, -4, 3 * b],
            [12 * a - 6, 4, 3 * b],
        ][faces[k]]
    poles = np.array([[-3, -2], [0, -2.5], [3, -1.5], [-2, 2], [1, 2.5], [4, 2]])
    which = rng.integers(0, len(poles), count // 4)
    corners = np.column_stack([poles[which], rng.uniform(0.2, 2.8, count // 4)])
    return surfs + rng.normal(0, sigma_m, surfs.shape), corners + rng.normal(0, sigma_m, corners.shape)
