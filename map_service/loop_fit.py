"""Two clouds of a loop candidate laid on each other: GICP, how well they fit, and what the fit does not tell."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import small_gicp
from numpy.typing import NDArray

from splitslam import se3

if TYPE_CHECKING:
    from map_service.settings import LoopFitSettings

Array = NDArray[np.float64]
_FEW = 4  # every fourth point tells whether a rival is worth a look at all of them


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """How two clouds lie on each other at T_target_source.

    forward: share of the source's points on the target; backward: share of the target's points in sight on the
    source. rms_m: of the source's points on the target. covariance (6, 6): right tangent, rotation first.
    observed: the fit holds in every direction; directions in which it does not have a large covariance.
    """

    T_target_source: Array
    converged: bool
    forward: float
    backward: float
    rms_m: float
    information: Array
    covariance: Array
    observed: bool


@dataclass(frozen=True, slots=True, eq=False)
class Rival:
    """Another alignment: T_target_source and its score as a share of the score of the one it competes with."""

    share: float
    T_target_source: Array


class CloudPair:
    """Target (N, 3) and source (M, 3), any float type, each in the frame of its keyframe, thinned and with normals."""

    def __init__(self, target: NDArray, source: NDArray, settings: LoopFitSettings) -> None:
        self.settings = s = settings
        clouds = np.asarray(target, np.float64), np.asarray(source, np.float64)
        fine = [small_gicp.preprocess_points(c, s.voxel_m, s.neighbours) for c in clouds]
        self._coarse = [small_gicp.preprocess_points(c[0], 2 * s.voxel_m, s.neighbours) for c in fine]
        self._fine = fine
        self._target, self._source = (c[0].points()[:, :3] for c in fine)
        self._normals = fine[0][0].normals()[:, :3]
        self._tree, self._source_tree = fine[0][1], fine[1][1]

    @property
    def empty(self) -> bool:
        """Too little to lay anything on."""
        return min(len(self._target), len(self._source)) < self.settings.min_points

    def align(self, T_target_source: Array) -> tuple[Array, bool]:
        """GICP from a guess, coarse then fine: the transform and whether it converged."""
        s = self.settings
        T, _ = _gicp(self._coarse, T_target_source, s.coarse_distance_m)
        return _gicp(self._fine, T, s.fine_distance_m)

    def near_share(self, T_target_source: Array, distance_m: float) -> float:
        """Share of the source's points within a distance of the target."""
        squares, _ = self._to_target(self._source, T_target_source)
        return float((squares < distance_m**2).mean())

    def fit(self, T_target_source: Array, converged: bool) -> Fit:
        """Measures the fit at a transform."""
        s = self.settings
        squares, nearest = self._to_target(self._source, T_target_source)
        near = squares < s.inlier_m**2
        information = self._information(T_target_source, near, nearest[near])
        covariance, observed = _covariance(information, s)
        return Fit(
            T_target_source,
            converged,
            float(near.mean()),
            self._backward(T_target_source),
            float(np.sqrt(squares[near].mean())) if near.any() else float("inf"),
            information,
            covariance,
            observed,
        )

    def rival(self, fit: Fit, up_target: Array, turned: bool) -> Rival:
        """The best other alignment nearby; `turned`: also with another heading, where nothing tells the heading.

        Corridors and rows of columns fit again a door further on: shifts along the two horizontal axes of the fit are
        tried, which are its weakest and strongest. Rooms and crossings fit again after a half or a quarter turn.
        """
        s = self.settings
        some = self._source[:: 1 + len(self._source) // s.rival_points]
        T = fit.T_target_source
        rough_m = s.inlier_m + s.rival_step_m / 2
        enough = s.rival_rough_share * self._score(some, T, rough_m)
        starts = self._turned(T, up_target) if turned else []
        tried = [(self._rough_score(some, start, rough_m, enough), start) for start in starts]
        distances = np.arange(s.rival_m, s.rival_reach_m + 1e-9, s.rival_step_m)
        for axis in _horizontal_axes(fit, up_target):
            for direction in (axis, -axis):
                starts = [_shifted(T, d * direction) for d in distances]
                scores = np.array([self._rough_score(some, start, rough_m, enough) for start in starts])
                tried += [(scores[k], starts[k]) for k in _peaks(scores)]
        best = Rival(0.0, T)
        own = max(self._score(some, T, s.inlier_m), 1e-9)
        likely = sorted((one for one in tried if one[0] > enough), key=lambda one: -one[0])
        for _, start in likely[: s.rivals]:
            other, _ = _gicp(self._fine, start, s.fine_distance_m)
            off = se3.inv(T) @ other
            if np.linalg.norm(off[:3, 3]) < 0.7 * s.rival_m and se3.angle(off) < s.rival_rad:
                continue  # it slid back
            share = self._score(some, other, s.inlier_m) / own
            best = Rival(share, other) if share > best.share else best
        return best

    def _turned(self, T: Array, up_target: Array) -> list[Array]:
        """The source turned about the vertical through its middle by quarters, roughly aligned again."""
        middle = T[:3, :3] @ self._source.mean(axis=0) + T[:3, 3]
        turned = []
        for quarters in (1, 2, 3):
            R = se3.so3_exp(0.5 * np.pi * quarters * up_target / np.linalg.norm(up_target))
            start = se3.compose(R, middle - R @ middle) @ T
            turned.append(_gicp(self._coarse, start, self.settings.coarse_distance_m, 10)[0])
        return turned

    def _rough_score(self, source: Array, T: Array, distance_m: float, enough: float) -> float:
        """The score, where it may be enough; a few points say where it is not near that."""
        few = self._score(source[::_FEW], T, distance_m)
        return few if few < 0.5 * enough else self._score(source, T, distance_m)

    def _score(self, source: Array, T: Array, distance_m: float) -> float:
        """Mean over the points: 1 on the target, 0 at the distance and beyond."""
        squares, _ = self._to_target(source, T)
        return float(np.maximum(0.0, 1.0 - squares / distance_m**2).mean())

    def _to_target(self, source: Array, T: Array) -> tuple[Array, NDArray[np.int64]]:
        nearest, squares = self._tree.batch_nearest_neighbor_search(source @ T[:3, :3].T + T[:3, 3])
        return np.asarray(squares).reshape(-1), np.asarray(nearest, np.int64).reshape(-1)

    def _backward(self, T: Array) -> float:
        """Share of the target's points around the source's keyframe that the source has too."""
        s = self.settings
        back = se3.inv(T)
        moved = self._target @ back[:3, :3].T + back[:3, 3]
        moved = moved[np.einsum("ij,ij->i", moved, moved) < s.sight_m**2]
        if not len(moved):
            return 0.0
        _, squares = self._source_tree.batch_nearest_neighbor_search(moved)
        return float((np.asarray(squares) < s.inlier_m**2).mean())

    def _information(self, T: Array, near: NDArray[np.bool_], nearest: NDArray[np.int64]) -> Array:
        """Point to plane at the fit: r = n . (R p + t - q), dr = [p x R^T n, R^T n] . xi (right tangent)."""
        s = self.settings
        p, q, n = self._source[near], self._target[nearest], self._normals[nearest]
        r = np.einsum("ij,ij->i", p @ T[:3, :3].T + T[:3, 3] - q, n)
        n_source = n @ T[:3, :3]
        J = np.hstack([np.cross(p, n_source), n_source])
        sigma_m = max(s.sigma_m, 1.4826 * float(np.median(np.abs(r)))) if len(r) else s.sigma_m
        return J.T @ J / (s.correlation * sigma_m**2)


def _gicp(clouds: list, T_target_source: Array, distance_m: float, iterations: int = 40) -> tuple[Array, bool]:
    (target, tree), (source, _) = clouds
    result = small_gicp.align(
        target,
        source,
        tree,
        T_target_source,
        registration_type="GICP",
        max_correspondence_distance=distance_m,
        max_iterations=iterations,
    )
    return result.T_target_source, result.converged


def _covariance(information: Array, s: LoopFitSettings) -> tuple[Array, bool]:
    """The inverse, opened along translations that only the noise of the normals seems to observe.

    Compared are the eigenvalues of translation's information with rotation marginalised out (Schur complement).
    """
    full = information + 1e-3 * np.eye(6)
    covariance = np.asarray(np.linalg.inv(full), np.float64)
    values, vectors = np.linalg.eigh(full[3:, 3:] - full[3:, :3] @ np.linalg.solve(full[:3, :3], full[:3, 3:]))
    weak = vectors[:, values < s.weak_share * values[-1]]
    covariance[3:, 3:] += s.open_sigma_m**2 * weak @ weak.T
    return covariance, not weak.size


def _horizontal_axes(fit: Fit, up_target: Array) -> Array:
    """(2, 3): directions in the target's frame, horizontal, along which the fit is weakest and strongest."""
    R = se3.level_rotation(up_target)
    in_level = R @ fit.T_target_source[:3, :3]
    horizontal = (in_level @ fit.information[3:, 3:] @ in_level.T)[:2, :2]
    _, vectors = np.linalg.eigh(horizontal)
    return np.column_stack([vectors.T, np.zeros(2)]) @ R


def _peaks(values: Array) -> NDArray[np.int64]:
    """Indices of the values that no neighbour exceeds."""
    padded = np.concatenate([[-np.inf], values, [-np.inf]])
    return np.flatnonzero((values >= padded[:-2]) & (values >= padded[2:]))


def _shifted(T: Array, by_m: Array) -> Array:
    shifted = T.copy()
    shifted[:3, 3] += by_m
    return shifted
