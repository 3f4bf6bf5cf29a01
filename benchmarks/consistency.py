"""Is the doubt of the online answers honest? NEES: errors in units of the covariance that came with them.

An answer is X_k = T_map_lidar with covariance P_k (perturbation on the right, rotation first). `map` starts at the
first pose, so the truth G_k is brought into it there, T_map_world = X_0 inv(G_0), and not where it fits best over the
whole drive: an alignment after the fact would take away the very drift that P_k speaks of. With that,

    e_k = log(inv(X_k) X_0 inv(G_0) G_k),   E[e_k e_k^T] = P_k + Ad P_0 Ad^T,   Ad = adjoint of inv(G_k) G_0,

because an error of X_0 turns and shifts all that follows (first order; X_0 and X_k taken as independent). A session
that calls its first pose exact, which is what "origin at the first pose" says, has P_0 = 0 and the second term is
nothing. NEES_k = e_k^T inv(cov) e_k has six degrees of freedom: its mean over six is 1 for honest answers, larger for
overconfident ones. Bar-Shalom, Li, Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001, 5.4.2.
"""

from __future__ import annotations

import csv
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from splitslam import se3
from splitslam.alignment import interpolate
from splitslam.errors import InputError
from splitslam.evaluate import inside
from splitslam.tum import Trajectory

Array = NDArray[np.float64]
_UPPER = np.triu_indices(6)


@dataclass(frozen=True, slots=True, eq=False)
class Doubt:
    """What the answers say of themselves. stamps_ns (N,) int64; states (N,) names; covariances (N, 6, 6)."""

    stamps_ns: NDArray[np.int64]
    states: tuple[str, ...]
    covariances: Array

    @property
    def state_shares(self) -> dict[str, float]:
        """Share of the answers in each state."""
        return {state: count / len(self.states) for state, count in sorted(Counter(self.states).items())}


@dataclass(frozen=True, slots=True)
class Consistency:
    """NEES per degree of freedom over n answers: 1 is honest, above 2 overconfident, below 0.5 timid.

    mean, median: all six (the median of an honest one is 0.89). rotation, translation: means of the marginals, three
    degrees of freedom each. origin_exact: the mean if the first pose's own covariance is left out.
    """

    n: int
    mean: float
    median: float
    rotation: float
    translation: float
    origin_exact: float


def read_doubt(path: Path) -> Doubt:
    """Reads online_covariance.csv (docs/conventions.md). Raises InputError for anything else."""
    with path.open(newline="") as file:
        rows = list(csv.reader(file))[1:]
    try:
        numbers = np.array([row[2:] for row in rows], np.float64).reshape(len(rows), 21)
        stamps_ns = np.array([int(row[0]) for row in rows], np.int64)
    except (ValueError, IndexError):
        raise InputError(f"{path}: expected stamp_ns, state and 21 numbers a row") from None
    covariances = np.zeros((len(rows), 6, 6))
    covariances[:, _UPPER[0], _UPPER[1]] = covariances[:, _UPPER[1], _UPPER[0]] = numbers
    return Doubt(stamps_ns, tuple(row[1] for row in rows), covariances)


def consistency(online: Trajectory, covariances: Array, truth: Trajectory) -> Consistency | None:
    """NEES of the answers `online` (N) with `covariances` (N, 6, 6) against `truth`; None without two poses in it.

    The first answer that the truth covers is the origin and is not scored.
    """
    rows = np.flatnonzero(inside(online, truth))
    if len(rows) < 2:
        return None
    X, P = _poses(online[rows]), covariances[rows]
    G = _poses(interpolate(truth, online.stamps_ns[rows]))
    T_map_world = X[0] @ se3.inv(G[0])
    scores = [
        _nees(se3.log(se3.inv(X[k]) @ T_map_world @ G[k]), P[k], P[0], se3.adjoint(se3.inv(G[k]) @ G[0]))
        for k in range(1, len(rows))
    ]
    nees, rotation, translation, origin_exact = np.array(scores).T
    return Consistency(
        n=len(scores),
        mean=float(nees.mean()),
        median=float(np.median(nees)),
        rotation=float(rotation.mean()),
        translation=float(translation.mean()),
        origin_exact=float(origin_exact.mean()),
    )


def _nees(error: Array, P: Array, P_origin: Array, adjoint: Array) -> tuple[float, float, float, float]:
    """Per degree of freedom: all, rotation, translation, all with an exact origin."""
    total = P + adjoint @ P_origin @ adjoint.T
    return (
        float(error @ np.linalg.solve(total, error)) / 6.0,
        float(error[:3] @ np.linalg.solve(total[:3, :3], error[:3])) / 3.0,
        float(error[3:] @ np.linalg.solve(total[3:, 3:], error[3:])) / 3.0,
        float(error @ np.linalg.solve(P, error)) / 6.0,
    )


def _poses(trajectory: Trajectory) -> list[Array]:
    return [se3.from_quat(t, q) for t, q in zip(trajectory.positions_m, trajectory.quats_xyzw, strict=True)]
