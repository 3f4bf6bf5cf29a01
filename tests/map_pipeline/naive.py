"""Twins of the map kernels in plain Python, and a small made room."""

from __future__ import annotations

import numpy as np

from splitslam.registration import _kernels as kernels


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


def equation_fits(rows):
    """What `normal_equations` takes of matched voxels' geometry (N, 16), see splitslam/registration/_kernels.py."""
    return [equation_fit(g) for g in rows]


def equation_fit(g):
    plane = g[kernels.KIND] == kernels.PLANE
    wide, thin = (kernels.L_MID, kernels.L_MIN) if plane else (kernels.L_MAX, kernels.L_MID)
    return g[kernels.COUNT], g[:3], g[3:6], g[wide], g[thin], plane


def descent(classes, T_start, prior, gains, settings, gate_m, again):
    """Step by step, with every matrix inverted; classes: (voxels, points, times). T and the number of iterations."""
    from splitslam import se3

    s, T, twist, unmatched_m = settings, T_start, np.zeros(6), np.inf
    points, fits = [c[1] for c in classes], [np.empty((len(c[1]), 16)) for c in classes]
    for iteration in range(1, s.max_iterations + 1):
        if unmatched_m > s.rematch_m:
            for (voxels, _, _), p, f in zip(classes, points, fits, strict=True):
                voxels.match(p, T, gate_m, f)
            unmatched_m = 0.0
        H, b = np.zeros((6, 6)), np.zeros(6)
        for p, f in zip(points, fits, strict=True):
            d = p @ T[:3, :3].T + T[:3, 3] - f[:, :3]
            along = np.sum(d * f[:, 3:6], axis=1)
            square = np.where(f[:, kernels.KIND] == kernels.PLANE, along**2, np.sum(d**2, axis=1) - along**2)
            near = (f[:, kernels.KIND] != 0.0) & (square <= gate_m**2)
            part = normal_equations(p[near], T, equation_fits(f[near]), (s.point_sigma_m, s.robust_sigmas))
            H, b = H + part[0], b + part[1]
        A = H + prior
        step = np.linalg.inv(A + s.damping * np.diag(np.diag(A))) @ (b - prior @ se3.log(se3.inv(T_start) @ T))
        T, before = T @ se3.exp(step), twist
        twist = gains[0] * se3.log(se3.inv(T_start) @ T)
        turned_rad, moved_m = np.linalg.norm(step[:3]), np.linalg.norm(step[3:])
        if again:
            moved_m += 0.1 * np.linalg.norm((twist - before) * gains[1])
            points = [p + t[:, None] * (twist[3:] + np.cross(twist[:3], p)) for _, p, t in classes]
        if moved_m < s.converged_m and turned_rad < s.converged_rad:
            break
        unmatched_m += moved_m + s.lever_m * turned_rad
        gate_m = max(s.gate_end_m, 0.6 * gate_m)
    return T, iteration


def spurious_information(points, T, fits, noise, draws: int, rng: np.random.Generator) -> np.ndarray:
    """By drawing axes that waver as fits of n points do; fits: (n, mean, axes (3, 3) in columns, variances, is_plane).

    Columns and variances (3,) ascend. The information of the wavering axes less that of the right ones, in the mean.
    """
    H = np.zeros((6, 6))
    for p, (n, mean, axes, variances, plane) in zip(points, fits, strict=True):
        q = T[:3, :3] @ p + T[:3, 3] - mean
        own, thin, spread = (0, variances[0], variances[1]) if plane else (2, variances[1], variances[2])
        axis = axes[:, own]
        along = axis @ q
        distance2, other = (along**2, q @ q - along**2) if plane else (q @ q - along**2, along**2)
        variance = (thin + noise[0] ** 2) * (1 + (1 + other / (spread + 1e-4)) / n)
        weight = 1 / (1 + distance2 / variance / noise[1] ** 2) / variance
        tilt = max(thin, 2.5e-5) / (n - 3)
        for _ in range(draws):
            wavering = axis.copy()
            for j in range(3):
                if j != own:
                    reach = variances[j] if plane else variances[2]
                    wavering += axes[:, j] * rng.normal(0, np.sqrt(tilt / (reach + 1e-6)))
            for direction in (wavering - axis,) if plane else _across(axes, wavering - axis):
                a = T[:3, :3].T @ direction
                J = np.concatenate([np.cross(p, a), a])
                H += weight / draws * np.outer(J, J)
    return H


def _across(axes: np.ndarray, error: np.ndarray) -> list[np.ndarray]:
    """A line's axis is off by `error`: what the two directions across it gain along it."""
    return [axes[:, 2] * (axes[:, j] @ error) for j in (0, 1)]


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


def closeness(voxels, points, poses, gate_m):
    """Point by point: the finest voxel with a fit, its distance, 1 - (d / gate)^2."""
    s, found = voxels.settings, {}
    for i in np.flatnonzero(voxels.geometry[:, kernels.KIND]):
        key = int(voxels.keys[i])
        index = [((key >> shift) & ((1 << 20) - 1)) - (1 << 19) for shift in (40, 20, 0)]
        found[(key >> 60, *index)] = voxels.geometry[i]
    scores = np.zeros(len(poses))
    for c, T in enumerate(poses):
        for p in points.astype(float) @ T[:3, :3].T + T[:3, 3]:
            for level in range(s.levels):
                g = found.get((level, *np.floor(p / (s.voxel_m * 2**level)).astype(int)))
                if g is not None:
                    d, axis = p - g[:3], g[3:6]
                    distance = abs(axis @ d) if g[kernels.KIND] == kernels.PLANE else np.linalg.norm(np.cross(axis, d))
                    scores[c] += max(0.0, 1.0 - (distance / gate_m) ** 2)
                    break
    return scores
