"""The factor graph of one session: keyframe poses under LiDAR odometry, GNSS and loop closures (iSAM2).

Keys: x(i) = T_map_lidar of keyframe i; z0 = T_enu_map. Every factor is kept in its own versioned encoding, so that
the store can hold it and a restart can build the graph again.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X
from numpy.typing import NDArray

from map_service.settings import GraphSettings
from map_service.types import FactorRecord
from splitslam import se3

Array = NDArray[np.float64]
ENU_KEY = gtsam.symbol("z", 0)
_VERSION = 1


class PoseGraph:
    """Adds factors, optimises, and says where the keyframes are."""

    def __init__(self, settings: GraphSettings) -> None:
        self.settings = settings
        parameters = gtsam.ISAM2Params()
        parameters.setRelinearizeThreshold(settings.relinearise_threshold)
        parameters.relinearizeSkip = 1
        self._isam = gtsam.ISAM2(parameters)
        self._graph, self._values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        self._alive: list[Callable[..., Array]] = []  # gtsam keeps no reference to a Python error function
        self.records: list[FactorRecord] = []
        self.poses: list[Array] = []
        self.loops: list[tuple[int, int]] = []  # (older, newer) keyframes
        self.T_enu_map: Array | None = None

    # --- what the session adds --------------------------------------------------------------------------------

    def add_first(self, T_map_lidar: Array) -> None:
        """Keyframe 0 defines `map`."""
        self._record("prior", {"pose": _flat(T_map_lidar)}, T_map_lidar)

    def add_odometry(self, T_map_lidar: Array, T_previous_lidar: Array, covariance: Array) -> None:
        """Keyframe n with its motion since keyframe n - 1, covariance (6, 6), right tangent, rotation first."""
        payload = {"motion": _flat(T_previous_lidar), "covariance": covariance.reshape(-1).tolist()}
        self._record("odometry", {"to": len(self.poses), **payload}, T_map_lidar)

    def add_loop(
        self, older: int, newer: int, T_older_newer: Array, sigmas: Sequence[float], robust_sigmas: float = 1.0
    ) -> None:
        """A verified revisit; sigmas: rotation rad, translation m.

        robust_sigmas: scale of the Cauchy kernel. It must cover what the drive may have drifted, or a true loop that
        closes a large gap is outvoted by the odometry it is to correct.
        """
        payload = {"motion": _flat(T_older_newer), "sigmas": [float(s) for s in sigmas], "robust": float(robust_sigmas)}
        self._record("loop", {"older": older, "newer": newer, **payload})

    def add_gnss(self, keyframe: int, antenna_lidar: Array, enu_m: Array, sigmas_m: Array, T_enu_map: Array) -> None:
        """An antenna position: antenna_lidar (3,) in the keyframe's frame, enu_m (3,); T_enu_map is the first guess."""
        payload = {"antenna": antenna_lidar.tolist(), "enu": enu_m.tolist(), "sigmas": sigmas_m.tolist()}
        self._record("gnss", {"keyframe": keyframe, **payload, "guess": _flat(T_enu_map)})

    def _record(self, kind: str, payload: dict, T_new: Array | None = None) -> None:
        data = json.dumps({"v": _VERSION, **payload}).encode()
        record = FactorRecord(len(self.records), kind, data)
        self.records.append(record)
        self._add(record, T_new)

    # --- encoding -> factors ----------------------------------------------------------------------------------

    def _add(self, record: FactorRecord, T_new: Array | None) -> None:
        p = json.loads(record.payload)
        if T_new is not None:
            self._values.insert(X(len(self.poses)), gtsam.Pose3(T_new))
            self.poses.append(T_new)
        if record.kind == "prior":
            noise = gtsam.noiseModel.Isotropic.Sigma(6, 1e-4)
            self._graph.add(gtsam.PriorFactorPose3(X(0), gtsam.Pose3(_square(p["pose"])), noise))
        elif record.kind == "odometry":
            noise = gtsam.noiseModel.Gaussian.Covariance(np.reshape(p["covariance"], (6, 6)))
            motion = gtsam.Pose3(_square(p["motion"]))
            self._graph.add(gtsam.BetweenFactorPose3(X(p["to"] - 1), X(p["to"]), motion, noise))
        elif record.kind == "loop":
            self.loops.append((p["older"], p["newer"]))
            noise = gtsam.noiseModel.Diagonal.Sigmas(np.repeat(p["sigmas"], 3))
            motion = gtsam.Pose3(_square(p["motion"]))
            self._graph.add(gtsam.BetweenFactorPose3(X(p["older"]), X(p["newer"]), motion, _cauchy(noise, p["robust"])))
        elif record.kind == "gnss":
            self._add_gnss_factor(p)
        else:
            raise ValueError(f"factor kind {record.kind!r} is none of prior, odometry, loop, gnss")

    def _add_gnss_factor(self, p: dict) -> None:
        if self.T_enu_map is None:
            guess = _square(p["guess"])
            self.T_enu_map = guess
            # yaw and translation are free; the tilt of `map` is known from gravity
            noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([0.01, 0.01, 3.0, 1e3, 1e3, 1e3]))
            self._values.insert(ENU_KEY, gtsam.Pose3(guess))
            self._graph.add(gtsam.PriorFactorPose3(ENU_KEY, gtsam.Pose3(guess), noise))
        error = _gnss_error(np.array(p["antenna"]), np.array(p["enu"]))
        kernel = gtsam.noiseModel.mEstimator.Huber.Create(self.settings.gnss_robust_sigmas)
        noise = gtsam.noiseModel.Robust.Create(kernel, gtsam.noiseModel.Diagonal.Sigmas(np.array(p["sigmas"])))
        self._alive.append(error)
        self._graph.add(gtsam.CustomFactor(noise, [ENU_KEY, X(p["keyframe"])], error))

    # --- estimate ---------------------------------------------------------------------------------------------

    def optimise(self, corrected: bool) -> None:
        """Takes the new factors in; with `corrected` (a loop or GNSS came) iterates and reads all poses again."""
        self._isam.update(self._graph, self._values)
        self._graph, self._values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        if not corrected:
            return  # a chain of odometry alone: nothing before the new keyframe can have moved
        for _ in range(self.settings.extra_updates):
            self._isam.update()
        estimate = self._isam.calculateEstimate()
        rows = gtsam.utilities.extractPose3(estimate)
        for i in range(len(self.poses)):
            self.poses[i] = _from_row(rows[i])
        if self.T_enu_map is not None:
            self.T_enu_map = _from_row(rows[len(self.poses)])

    @classmethod
    def restore(cls, settings: GraphSettings, records: list[FactorRecord], poses: list[Array]) -> PoseGraph:
        """Builds the graph again from what the store holds."""
        graph = cls(settings)
        for record in records:
            new = record.kind in ("prior", "odometry")
            graph.records.append(record)
            graph._add(record, poses[len(graph.poses)] if new else None)
        graph.optimise(corrected=True)
        return graph


def _cauchy(noise: gtsam.noiseModel.Base, sigmas: float) -> gtsam.noiseModel.Base:
    return gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Cauchy.Create(sigmas), noise)


def _gnss_error(antenna_lidar: Array, enu_m: Array) -> Callable[..., Array]:
    """r = T_enu_map * T_map_lidar * antenna - enu, with its derivatives in the right tangents of both poses."""

    def error(this: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        E = values.atPose3(this.keys()[0]).matrix()
        T = values.atPose3(this.keys()[1]).matrix()
        antenna_map = T[:3, :3] @ antenna_lidar + T[:3, 3]
        if jacobians is not None:
            jacobians[0] = np.asfortranarray(np.hstack([-E[:3, :3] @ se3.hat(antenna_map), E[:3, :3]]))
            R = E[:3, :3] @ T[:3, :3]
            jacobians[1] = np.asfortranarray(np.hstack([-R @ se3.hat(antenna_lidar), R]))
        return E[:3, :3] @ antenna_map + E[:3, 3] - enu_m

    return error


def _flat(T: Array) -> list[float]:
    return T[:3].reshape(-1).tolist()


def _square(values: list[float]) -> Array:
    T = np.eye(4)
    T[:3] = np.reshape(values, (3, 4))
    return T


def _from_row(row: Array) -> Array:
    """gtsam's extractPose3 row: R row-major (9), t (3)."""
    return se3.compose(row[:9].reshape(3, 3), row[9:12])
