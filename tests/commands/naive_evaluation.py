"""The definitions of CONVENTIONS' evaluation, one pose at a time, with scipy's rotations."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from splitslam.tum import Trajectory


def evaluate(estimate: Trajectory, truth: Trajectory) -> dict[str, float | int | None]:
    """Same keys as `splitslam eval --json`."""
    inside = [t for t in range(len(estimate)) if truth.stamps_ns[0] <= estimate.stamps_ns[t] <= truth.stamps_ns[-1]]
    T = [_matrix(estimate.positions_m[t], Rotation.from_quat(estimate.quats_xyzw[t])) for t in inside]
    G = [_at(truth, int(estimate.stamps_ns[t])) for t in inside]
    stamps = [int(estimate.stamps_ns[t]) for t in inside]
    path = [_path_m(truth, stamp) for stamp in stamps]

    p, g = np.array([t[:3, 3] for t in T]), np.array([t[:3, 3] for t in G])
    rotation = Rotation.align_vectors(g - g.mean(axis=0), p - p.mean(axis=0))[0]
    errors = np.linalg.norm(rotation.apply(p - p.mean(axis=0)) - (g - g.mean(axis=0)), axis=1)
    first = G[0] @ np.linalg.inv(T[0])
    return {
        "n": len(inside),
        "outside": len(estimate) - len(inside),
        "ate_m": float(np.sqrt(np.mean(errors**2))),
        "max_m": float(errors.max()),
        "rpe_1s_m": _rpe(T, G, stamps, 10**9),
        "rpe_10m_m": _rpe(T, G, path, 10.0),
        "end_m": float(np.linalg.norm((first @ T[-1])[:3, 3] - G[-1][:3, 3])),
    }


def _rpe(T: list[np.ndarray], G: list[np.ndarray], at: list, step: float) -> float | None:
    squares = []
    for i in range(len(T)):
        for j in range(i, len(T)):
            if at[j] >= at[i] + step:
                error = np.linalg.inv(np.linalg.inv(G[i]) @ G[j]) @ np.linalg.inv(T[i]) @ T[j]
                squares.append(float(error[:3, 3] @ error[:3, 3]))
                break
    return float(np.sqrt(np.mean(squares))) if squares else None


def _at(truth: Trajectory, stamp_ns: int) -> np.ndarray:
    seconds = (truth.stamps_ns - truth.stamps_ns[0]) / 1e9
    at = (stamp_ns - int(truth.stamps_ns[0])) / 1e9
    rotation = Slerp(seconds, Rotation.from_quat(truth.quats_xyzw))(at)
    position = [np.interp(at, seconds, truth.positions_m[:, axis]) for axis in range(3)]
    return _matrix(np.array(position), rotation)


def _path_m(truth: Trajectory, stamp_ns: int) -> float:
    length = 0.0
    for k in range(1, len(truth)):
        step = float(np.linalg.norm(truth.positions_m[k] - truth.positions_m[k - 1]))
        before, after = int(truth.stamps_ns[k - 1]), int(truth.stamps_ns[k])
        length += step * min(max((stamp_ns - before) / (after - before), 0.0), 1.0)
    return length


def _matrix(position_m: np.ndarray, rotation: Rotation) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation.as_matrix(), position_m
    return T
