"""Scan-to-map registration: equation 3 of the paper on SE(3).

Corner-to-line and surf-to-plane distances, weighted by what is known of each fit, are minimised by
Levenberg-Marquardt from the motion that the edge's Imu node predicts. That prediction is also a measurement: with
its covariance it fills the directions that the features do not observe.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from splitslam import se3
from splitslam.registration import _descent_kernels as descent
from splitslam.registration import _equation_kernels as kernels
from splitslam.registration._kernels import GEOMETRY
from splitslam.registration.local_map import LocalMap, VoxelMap
from splitslam.registration.settings import RegistrationSettings

Array = NDArray[np.float64]
Real = TypeVar("Real", np.float32, np.float64)
_NO_AXES = np.zeros((0, 6))
_QUANTILES = np.array([0.1, 0.3, 0.5, 0.7, 0.9])


@dataclass(frozen=True, slots=True, eq=False)
class RegistrationResult:
    """How a registration went.

    T_local_lidar: (4, 4). information: (6, 6) of the features alone, right tangent, rotation first.
    covariance: (6, 6), features and prior together, inflated by the residuals.
    degenerate_axes: (A, 6) unit directions the features do not observe. inliers: features within 3 sigma.
    delta_twist: (6,) correction of the scan's twist, rad/s and m/s, that the points were deskewed again with.
    keyframes: (Q,) int64, who saw first what the scan was matched with: quantiles over its features.
    """

    T_local_lidar: Array
    information: Array
    covariance: Array
    converged: bool
    iterations: int
    matched: int
    inliers: int
    features: int
    error: float
    degenerate_axes: Array
    delta_twist: Array
    keyframes: NDArray[np.int64]

    @classmethod
    def without_features(cls, T_local_lidar: Array, covariance: Array) -> RegistrationResult:
        """Of a scan that brought none: the pose (4, 4) is the prediction, with its covariance (6, 6)."""
        nothing = np.zeros((6, 6)), np.eye(6), np.zeros(6), np.zeros(0, np.int64)
        return cls(T_local_lidar, nothing[0], covariance, True, 0, 0, 0, 0, 0.0, *nothing[1:])


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """Where the scan should be: T_local_lidar (4, 4), its information (6, 6), and how well its twist is known.

    interval_s: time since the previous frame. rate_sigma_radps, velocity_sigmas_mps (3,): of the edge's motion.
    """

    T_local_lidar: Array
    information: Array
    interval_s: float
    rate_sigma_radps: float
    velocity_sigmas_mps: Array


class Registration:
    """Holds the settings and the scratch arrays; one per session."""

    def __init__(self, settings: RegistrationSettings) -> None:
        self.settings = settings
        self._scale = settings.scale
        self._in_metres = np.diag(self._scale**2)
        self._rules = _rules(settings)
        self._scratch = _Scratch(), _Scratch()

    def align(
        self,
        local_map: LocalMap,
        corners_lidar: NDArray[np.float32],
        surfs_lidar: NDArray[np.float32],
        offsets_s: tuple[Array, Array],
        prediction: Prediction,
        deskew_again: bool,
    ) -> RegistrationResult:
        """Aligns the features (N, 3), frame `lidar`, to the map, from the prediction.

        offsets_s: per class (N,), time of each point after the scan's reference time. With `deskew_again` the
        points follow the twist that the found motion implies: p' = p + (dv + dw x p) t. A point is matched again when
        the pose has moved by `rematch_m` since.
        """
        corners = self._scratch[0].of(local_map.corners, corners_lidar, offsets_s[0])
        surfs = self._scratch[1].of(local_map.surfs, surfs_lidar, offsets_s[1])
        T, T_back = prediction.T_local_lidar.copy(), se3.inv(prediction.T_local_lidar)
        H, b, spurious = np.empty((6, 6)), np.empty(6), np.empty((6, 6))
        tangents, state = np.zeros((3, 6)), np.zeros(descent.STATE)
        gains = np.stack([self._gain(prediction) / prediction.interval_s * deskew_again, self._scale])
        state[descent.GATE_M], state[descent.UNMATCHED_M] = self._gate_m(prediction), np.inf
        state[descent.AGAIN] = deskew_again
        axes, seen_at = _NO_AXES, 0.0  # and in which iteration
        arrays = (T, T_back), prediction.information, (H, b, spurious, self._in_metres), tangents, gains
        while (end := descent.descend(corners, surfs, *arrays, (self._rules, state))) == descent.UNOBSERVED:
            axes, seen_at = self._without_unobserved(H, spurious, b, _Fit.of(state)), state[descent.ITERATIONS]
        if seen_at != state[descent.ITERATIONS]:
            axes = _NO_AXES
        fit = _Fit.of(state)
        information, covariance = H * self._trust(fit), np.empty((6, 6))
        if not kernels.invert(information, prediction.information, covariance):
            raise np.linalg.LinAlgError("the information of a pose is not positive definite")
        return RegistrationResult(
            T_local_lidar=se3.orthonormalised(T),
            information=information,
            covariance=covariance,
            converged=end == descent.CONVERGED,
            iterations=int(state[descent.ITERATIONS]),
            matched=fit.matched,
            inliers=fit.inliers,
            features=len(corners_lidar) + len(surfs_lidar),
            error=fit.error,
            degenerate_axes=axes,
            delta_twist=tangents[1],
            keyframes=_first_seen_by(corners[-1], surfs[-1]),
        )

    def _gain(self, prediction: Prediction) -> Array:
        """(6,): how much of the twist that the found motion implies is believed, against the edge's own."""
        s, dt = self.settings, prediction.interval_s
        known = np.empty(6)
        known[:3], known[3:] = prediction.rate_sigma_radps**2, prediction.velocity_sigmas_mps**2
        seen = np.empty(6)
        seen[:3], seen[3:] = (s.rotation_sigma_rad / dt) ** 2, (s.position_sigma_m / dt) ** 2
        return known / (known + seen)

    def _gate_m(self, prediction: Prediction) -> float:
        """How far from the map a point may lie at first."""
        s, dt = self.settings, prediction.interval_s
        reach_m = float(prediction.velocity_sigmas_mps.max()) * dt + s.lever_m * prediction.rate_sigma_radps * dt
        return min(s.gate_start_m + s.gate_sigmas * reach_m, s.gate_limit_m)

    def _trust(self, fit: _Fit) -> float:
        """Neighbouring residuals are correlated (same plane, same laser): features count for less than they are."""
        return 1.0 / (self.settings.correlation * max(fit.error**2, 0.25))

    def _without_unobserved(self, H: Array, spurious: Array, b: Array, fit: _Fit) -> Array:
        """Takes the directions that the features do not observe out of H and b, and returns them (A, 6).

        Solution remapping, Zhang et al., "On degeneracy of optimization-based state estimation problems", 2016, with
        the eigenvalues as information in metres at a lever arm, so that the threshold is a position's sigma. A
        direction is also unobserved when its information is of the size that noisy normals make out of nothing.
        """
        s = self.settings
        scale = np.outer(self._scale, self._scale) / self._trust(fit)
        values, vectors = np.linalg.eigh(H / scale)
        by_chance = np.einsum("ij,ik,kj->j", vectors, spurious / scale, vectors)
        weak = (values < s.degenerate_information) | (values < s.degenerate_ratio * by_chance)
        if not weak.any():
            return _NO_AXES
        # xi * scale = metres: keep only its components along the strong eigenvectors
        keep = np.diag(1 / self._scale) @ (np.eye(6) - vectors[:, weak] @ vectors[:, weak].T) @ np.diag(self._scale)
        axes = (vectors[:, weak] / self._scale[:, None]).T
        H[:], b[:] = keep.T @ H @ keep, keep.T @ b
        return axes / np.linalg.norm(axes, axis=1, keepdims=True)


def _rules(s: RegistrationSettings) -> Array:
    """In the order of _descent_kernels.py."""
    points = s.point_sigma_m, s.robust_sigmas, s.correlation
    ends = s.converged_m, s.converged_rad
    directions = s.degenerate_information, s.degenerate_ratio
    return np.array([s.max_iterations, s.damping, s.gate_end_m, *points, *ends, *directions, s.rematch_m, s.lever_m])


@dataclass(frozen=True, slots=True)
class _Fit:
    matched: int
    inliers: int
    squares: float

    @classmethod
    def of(cls, state: Array) -> _Fit:
        """As the last equations had it."""
        matched, inliers, squares = state[descent.MATCHED : descent.SQUARES + 1].tolist()
        return cls(int(matched), int(inliers), squares)

    @property
    def error(self) -> float:
        """RMS of the inliers' residuals in sigmas."""
        return math.sqrt(self.squares / max(self.inliers, 1))


class _Scratch:
    """Arrays for the points of one class; they grow with the largest scan."""

    def __init__(self) -> None:
        self._points = np.empty((2, 0, 3))
        self._fits = np.empty((0, GEOMETRY))

    def of(self, voxels: VoxelMap, points_lidar: NDArray[np.float32], offsets_s: Array) -> tuple[NDArray, ...]:
        """The class as _descent_kernels.py has it: what is to be matched with what, and room for it."""
        count = len(points_lidar)
        if count > len(self._fits):
            self._points, self._fits = np.empty((2, count, 3)), np.empty((count, GEOMETRY))
        original, shifted = self._points[:, :count]
        original[:] = points_lidar
        return *voxels.arrays, original, shifted, offsets_s, self._fits[:count]


def deskew_again(points_lidar: NDArray[Real], offsets_s: Array, delta_twist: Array) -> NDArray[Real]:
    """The points (N, 3), first order, for a twist error (6,) constant over the scan: p' = p + (dv + dw x p) t."""
    moved = np.empty_like(points_lidar)
    kernels.deskew_again(points_lidar, offsets_s, delta_twist, moved)
    return moved


def _first_seen_by(corners: Array, surfs: Array) -> NDArray[np.int64]:
    """Quantiles of the keyframes that the matched voxels are from, by class (N, 16); empty without a match."""
    first = np.empty(len(corners) + len(surfs), np.int64)
    first = first[: kernels.first_seen(corners, surfs, first)]
    if not len(first):
        return first
    first.sort()
    return first[np.rint(_QUANTILES * (len(first) - 1)).astype(np.int64)]
