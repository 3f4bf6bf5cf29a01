"""Scan-to-map registration: equation 3 of the paper on SE(3).

Corner-to-line and surf-to-plane distances, weighted by what is known of each fit, are minimised by
Levenberg-Marquardt from the motion that the edge's Imu node predicts. That prediction is also a measurement: with
its covariance it fills the directions that the features do not observe.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from map_service import _kernels as kernels
from map_service.local_map import LocalMap
from map_service.settings import RegistrationSettings
from splitslam import se3

Array = NDArray[np.float64]
_QUANTILES = (0.1, 0.3, 0.5, 0.7, 0.9)


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
        points follow the twist that the found motion implies: p' = p + (dv + dw x p) t.
        """
        s = self.settings
        classes = (
            _Class(local_map.corners, corners_lidar, offsets_s[0]),
            _Class(local_map.surfs, surfs_lidar, offsets_s[1]),
        )
        T = prediction.T_local_lidar.copy()
        delta = np.zeros(6)
        dt = prediction.interval_s
        known = np.concatenate([np.repeat(prediction.rate_sigma_radps**2, 3), prediction.velocity_sigmas_mps**2])
        seen = np.repeat([(s.rotation_sigma_rad / dt) ** 2, (s.position_sigma_m / dt) ** 2], 3)
        gain = known / (known + seen)
        reach_m = float(prediction.velocity_sigmas_mps.max()) * dt + s.lever_m * prediction.rate_sigma_radps * dt
        gate_m = min(s.gate_start_m + s.gate_sigmas * reach_m, s.gate_limit_m)
        converged, iterations, damping = False, 0, s.damping
        H, fit, axes = np.zeros((6, 6)), _Fit(0.0, 0, 0.0, 0), np.zeros((0, 6))
        noise, spurious = np.array([s.point_sigma_m, s.robust_sigmas]), None
        for iterations in range(1, s.max_iterations + 1):
            H_all, b, fit = _normal_equations(classes, T, gate_m, noise)
            if spurious is None:  # it hardly changes with the pose
                spurious = _spurious_information(classes, T, noise)
            H, b, axes = self._observed(H_all, spurious, b, fit)
            xi_prior = se3.log(se3.inv(prediction.T_local_lidar) @ T)
            H_total = H + prediction.information
            b_total = b - prediction.information @ xi_prior
            step = np.asarray(np.linalg.solve(H_total + damping * np.diag(np.diag(H_total)), b_total), np.float64)
            T = T @ se3.exp(step)
            moved_m, turned_rad = float(np.linalg.norm(step[3:])), float(np.linalg.norm(step[:3]))
            if deskew_again:
                previous = delta
                delta = gain * se3.log(se3.inv(prediction.T_local_lidar) @ T) / dt
                moved_m += 0.1 * float(np.linalg.norm((delta - previous) * s.scale))
                for features in classes:
                    features.shift(delta)
            if moved_m < s.converged_m and turned_rad < s.converged_rad:
                converged = True
                break
            gate_m = max(s.gate_end_m, 0.6 * gate_m)
        return self._result(T, H, axes, prediction, converged, iterations, fit, classes, delta)

    def _trust(self, fit: _Fit) -> float:
        """Neighbouring residuals are correlated (same plane, same laser): features count for less than they are."""
        return 1.0 / (self.settings.correlation * max(fit.error**2, 0.25))

    def _observed(self, H: Array, spurious: Array, b: Array, fit: _Fit) -> tuple[Array, Array, Array]:
        """H and b without the directions that the features do not observe, and those directions (A, 6).

        Solution remapping, Zhang et al., "On degeneracy of optimization-based state estimation problems", 2016, with
        the eigenvalues as information in metres at a lever arm, so that the threshold is a position's sigma. A
        direction is also unobserved when its information is of the size that noisy normals make out of nothing.
        """
        s = self.settings
        scale = np.outer(s.scale, s.scale) / self._trust(fit)
        values, vectors = np.linalg.eigh(H / scale)
        by_chance = np.einsum("ij,ik,kj->j", vectors, spurious / scale, vectors)
        weak = (values < s.degenerate_information) | (values < s.degenerate_ratio * by_chance)
        if not weak.any():
            return H, b, np.zeros((0, 6))
        # xi * scale = metres: keep only its components along the strong eigenvectors
        keep = np.diag(1 / s.scale) @ (np.eye(6) - vectors[:, weak] @ vectors[:, weak].T) @ np.diag(s.scale)
        axes = (vectors[:, weak] / s.scale[:, None]).T
        return keep.T @ H @ keep, keep.T @ b, axes / np.linalg.norm(axes, axis=1, keepdims=True)

    def _result(
        self,
        T: Array,
        H: Array,
        axes: Array,
        prediction: Prediction,
        converged: bool,
        iterations: int,
        fit: _Fit,
        classes: tuple[_Class, _Class],
        delta: Array,
    ) -> RegistrationResult:
        information = H * self._trust(fit)
        features = sum(len(c.points_lidar) for c in classes)
        return RegistrationResult(
            T_local_lidar=se3.orthonormalised(T),
            information=information,
            covariance=np.asarray(np.linalg.inv(information + prediction.information), np.float64),
            converged=converged,
            iterations=iterations,
            matched=fit.matched,
            inliers=fit.inliers,
            features=features,
            error=fit.error,
            degenerate_axes=axes,
            delta_twist=delta,
            keyframes=_first_seen_by(classes),
        )


@dataclass(frozen=True, slots=True)
class _Fit:
    cost: float
    inliers: int
    squares: float
    matched: int

    @property
    def error(self) -> float:
        """RMS of the inliers' residuals in sigmas."""
        return float(np.sqrt(self.squares / max(self.inliers, 1)))


class _Class:
    """One feature class with its scratch arrays."""

    def __init__(self, voxels, points_lidar: NDArray[np.float32], offsets_s: Array) -> None:
        self.voxels = voxels
        self.original = np.ascontiguousarray(points_lidar, np.float64)
        self.points_lidar = self.original
        self.offsets_s = offsets_s
        self.points_local = np.empty_like(self.original)
        self.slots = np.empty(len(points_lidar), np.int64)

    def shift(self, delta_twist: Array) -> None:
        self.points_lidar = deskew_again(self.original, self.offsets_s, delta_twist)


def deskew_again(points_lidar: Array, offsets_s: Array, delta_twist: Array) -> Array:
    """First order, for a twist error (6,) constant over the scan: p' = p + (dv + dw x p) t."""
    return points_lidar + offsets_s[:, None] * (delta_twist[3:] + np.cross(delta_twist[:3], points_lidar))


def _normal_equations(
    classes: tuple[_Class, _Class], T: Array, gate_m: float, noise: Array
) -> tuple[Array, Array, _Fit]:
    H, b = np.zeros((6, 6)), np.zeros(6)
    cost, inliers, squares, matched = 0.0, 0, 0.0, 0
    for c in classes:
        if not len(c.points_lidar):
            continue
        kernels.transform(T, c.points_lidar, c.points_local)
        matched += c.voxels.match(c.points_local, gate_m, c.slots)
        part = kernels.linearise(c.voxels.geometry, c.voxels.moments, c.points_lidar, T, c.slots, noise, H, b)
        cost, inliers, squares = cost + part[0], inliers + part[1], squares + part[2]
    return np.triu(H) + np.triu(H, 1).T, b, _Fit(cost, inliers, squares, matched)


def _spurious_information(classes: tuple[_Class, _Class], T: Array, noise: Array) -> Array:
    """(6, 6): what the fits' uncertain axes add to the normal equations of the last match, in the mean."""
    H = np.zeros((6, 6))
    for c in classes:
        if len(c.points_lidar):
            kernels.spurious(c.voxels.geometry, c.voxels.moments, c.points_lidar, T, c.slots, noise, H)
    return np.triu(H) + np.triu(H, 1).T


def _first_seen_by(classes: tuple[_Class, _Class]) -> NDArray[np.int64]:
    """Quantiles of the keyframes that the matched voxels are from; empty without a match."""
    first = np.concatenate([c.voxels.moments[c.slots[c.slots >= 0], 10] for c in classes])
    if not len(first):
        return np.zeros(0, np.int64)
    return np.quantile(first, _QUANTILES, method="nearest").astype(np.int64)
