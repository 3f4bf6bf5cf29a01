"""The factor graph of one session: keyframe poses under LiDAR odometry, GNSS, gravity and loop closures (iSAM2).

Keys: x(i) = T_map_lidar of keyframe i; z(d) = T_enu_map of datum d (gnss.py). Every factor is kept in its own versioned
encoding, so that the store can hold it and a restart can build the graph again.
"""

from __future__ import annotations

import json
from collections import Counter, deque
from collections.abc import Callable, Sequence

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X, Z
from numpy.typing import NDArray

from map_service.gnss import GnssMeasurement
from map_service.growing import GrowingArray, Poses
from map_service.levelling import DOWN
from map_service.settings import GraphSettings
from map_service.types import FactorRecord
from splitslam import se3

Array = NDArray[np.float64]
_VERSION = 1
_OFFSET_FIXES = 4
_TOGETHER = 20  # odometry factors taken in at once: an update looks at every pose, whatever is new
_FIXED = 1e-4  # rad and m: what defines `map`
_STILL = 1e-6  # less than that is the optimiser's rounding


class PoseGraph:
    """Adds factors, optimises, and says where the keyframes are."""

    def __init__(self, settings: GraphSettings) -> None:
        self.settings = settings
        parameters = gtsam.ISAM2Params()
        thresholds = gtsam.ISAM2ThresholdMap()
        thresholds.insert(("x", np.full(6, settings.relinearise_threshold)))
        # T_enu_map is part of every clique: relinearised for its translation, in which the error is linear, it would
        # have the whole graph eliminated anew with each fix
        thresholds.insert(("z", np.repeat([settings.relinearise_enu_rad, np.inf], 3)))
        parameters.setRelinearizeThreshold(thresholds)
        parameters.relinearizeSkip = 1
        # what a tunnel leaves open meets factors of 0.1 mrad: beyond what Cholesky's squared condition number bears
        parameters.setFactorization("QR")
        self._isam = gtsam.ISAM2(parameters)
        self._graph, self._values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        self._alive: list[Callable[..., Array]] = []  # gtsam keeps no reference to a Python error function
        self.records: list[FactorRecord] = []  # those that somebody may still ask for
        self._records_let_go = 0
        self.poses = Poses()
        self.T_map_first = np.eye(4)  # of keyframe 0, as it was answered
        self.drifts: list[Array] = []  # covariance (6, 6) of the local map at each keyframe, see drift.py
        self.loops: list[tuple[int, int]] = []  # (older, newer) keyframes
        self.follows: dict[int, int] = {}  # keyframe -> the one its odometry starts from, where that is not the last
        self.data: dict[int, Array] = {}  # datum -> T_enu_map
        self._fixes: dict[int, deque[tuple[int, Array, Array]]] = {}  # datum -> the newest: keyframe, antenna, enu
        self._fixes_of: Counter[int] = Counter()  # datum -> how many
        self._all_fixes = GrowingArray((5,))  # keyframe, datum, enu: for people who look on
        self.fixed: set[int] = set()  # keyframes that have a fix

    # --- what the session adds --------------------------------------------------------------------------------

    def add_first(self, T_map_lidar: Array, tilt_sigma_rad: float = 0.0) -> None:
        """Keyframe 0 (4, 4) defines `map`, but for what is level: that it knows to `tilt_sigma_rad`."""
        tilt = float(np.clip(tilt_sigma_rad, *self.settings.first_tilt_rad))
        self._record("prior", {"pose": _flat(T_map_lidar), "tilt": tilt}, T_map_lidar)

    def add_odometry(
        self,
        T_map_lidar: Array,
        T_previous_lidar: Array,
        covariance: Array,
        drift: Array | None = None,
        follows: int | None = None,
    ) -> None:
        """Keyframe n with its motion since `follows` (None: n - 1), covariance (6, 6), right tangent, rotation first.

        drift (6, 6): of the local map there; it is kept for the answers, not used in the graph.
        """
        motion, covariances = _flat(T_previous_lidar), covariance.reshape(-1).tolist()
        payload: dict[str, object] = {"motion": motion, "covariance": covariances}
        if drift is not None:
            payload["drift"] = drift.reshape(-1).tolist()
        if follows is not None and follows != len(self.poses) - 1:
            payload["from"] = follows
        self._record("odometry", {"to": len(self.poses), **payload}, T_map_lidar)

    def add_loop(
        self, older: int, newer: int, T_older_newer: Array, covariance: Array, robust_sigmas: float = 1.0
    ) -> None:
        """A verified revisit; covariance (6, 6), right tangent, rotation first.

        robust_sigmas: scale of the Cauchy kernel. It must cover what the drive may have drifted, or a true loop that
        closes a large gap is outvoted by the odometry it is to correct.
        """
        payload = {"motion": _flat(T_older_newer), "covariance": covariance.reshape(-1).tolist()}
        self._record("loop", {"older": older, "newer": newer, **payload, "robust": float(robust_sigmas)})

    def add_gnss(self, measurement: GnssMeasurement) -> None:
        """An antenna position, with the guess of T_enu_map in case it is the first of its datum."""
        fix, weight = measurement.fix, measurement.weight.against(self.gnss_offset_m(measurement.datum))
        payload = {
            "keyframe": fix.keyframe,
            "antenna": fix.antenna_keyframe.tolist(),
            "enu": fix.enu_m.tolist(),
            "sigmas": weight.sigmas_m.tolist(),
            "robust": weight.robust_sigmas,
            "datum": measurement.datum,
            "guess": _flat(measurement.T_enu_map),
            "tilt": float(np.clip(self.settings.enu_tilt_rad_per_m * weight.noise_m[2], 0.01, 0.3)),
        }
        self._record("gnss", payload)

    def add_gravity(self, keyframe: int, down_lidar: Array, sigma_rad: float) -> None:
        """Where down is, (3,) unit vector in the keyframe's frame."""
        self._record("gravity", {"keyframe": keyframe, "down": down_lidar.tolist(), "sigma": float(sigma_rad)})

    def _record(self, kind: str, payload: dict, T_new: Array | None = None) -> None:
        data = json.dumps({"v": _VERSION, **payload}).encode()
        record = FactorRecord(self.record_count, kind, data)
        self.records.append(record)
        self._add(kind, payload, T_new)

    @property
    def record_count(self) -> int:
        """Records there have been."""
        return self._records_let_go + len(self.records)

    def records_from(self, index: int) -> list[FactorRecord]:
        """Those from number `index` on, none of which may have been let go."""
        return self.records[index - self._records_let_go :]

    def let_go_records(self, before: int) -> None:
        """The store has them."""
        del self.records[: max(before - self._records_let_go, 0)]
        self._records_let_go = max(self._records_let_go, before)

    # --- encoding -> factors ----------------------------------------------------------------------------------

    def _add(self, kind: str, p: dict, T_new: Array | None) -> None:
        if T_new is not None:
            self._values.insert(X(len(self.poses)), gtsam.Pose3(T_new))
            self.poses.append(T_new)
            self.drifts.append(np.reshape(p["drift"], (6, 6)) if "drift" in p else np.eye(6) * _FIXED**2)
        if kind == "prior":
            pose, tilt = _square(p["pose"]), p.get("tilt", _FIXED)
            self.T_map_first = pose
            covariance = np.eye(6) * _FIXED**2
            # tangents are the robot's axes, tilt is about those of `map`
            covariance[:3, :3] = pose[:3, :3].T @ np.diag([tilt**2, tilt**2, _FIXED**2]) @ pose[:3, :3]
            noise = gtsam.noiseModel.Gaussian.Covariance(covariance)
            self._graph.add(gtsam.PriorFactorPose3(X(0), gtsam.Pose3(pose), noise))
        elif kind == "odometry":
            noise = gtsam.noiseModel.Gaussian.Covariance(np.reshape(p["covariance"], (6, 6)))
            motion = gtsam.Pose3(_square(p["motion"]))
            follows = p.get("from", p["to"] - 1)
            if follows != p["to"] - 1:
                self.follows[p["to"]] = follows
            self._graph.add(gtsam.BetweenFactorPose3(X(follows), X(p["to"]), motion, noise))
        elif kind == "loop":
            self.loops.append((p["older"], p["newer"]))
            # loops of the first release had two sigmas: rotation rad, translation m
            covariance = p.get("covariance") or np.diag(np.repeat(np.square(p.get("sigmas", [1.0, 1.0])), 3))
            noise = gtsam.noiseModel.Gaussian.Covariance(np.reshape(covariance, (6, 6)))
            motion = gtsam.Pose3(_square(p["motion"]))
            self._graph.add(gtsam.BetweenFactorPose3(X(p["older"]), X(p["newer"]), motion, _cauchy(noise, p["robust"])))
        elif kind == "gnss":
            self._add_gnss_factor(p)
        elif kind == "gravity":
            noise = gtsam.noiseModel.Isotropic.Sigma(2, p["sigma"])
            down = gtsam.Unit3(np.array(p["down"]))
            self._graph.add(gtsam.AttitudeFactorPose3(X(p["keyframe"]), gtsam.Unit3(DOWN), noise, down))
        else:
            raise ValueError(f"factor kind {kind!r} is none of prior, odometry, loop, gnss, gravity")

    def _add_gnss_factor(self, p: dict) -> None:
        datum = p.get("datum", 0)
        if datum not in self.data:
            guess = _square(p["guess"])
            self.data[datum] = guess
            # yaw and translation are free; the tilt of `map` is known from gravity, but not so well that the noise of
            # altitudes may turn `map` rather than this
            tilt = p.get("tilt", 0.01)
            noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([tilt, tilt, 3.0, 1e3, 1e3, 1e3]))
            self._values.insert(Z(datum), gtsam.Pose3(guess))
            self._graph.add(gtsam.PriorFactorPose3(Z(datum), gtsam.Pose3(guess), noise))
        antenna, enu = np.array(p["antenna"]), np.array(p["enu"])
        self._fixes.setdefault(datum, deque(maxlen=_OFFSET_FIXES)).append((p["keyframe"], antenna, enu))
        self._fixes_of[datum] += 1
        self._all_fixes.append([p["keyframe"], datum, *enu])
        self.fixed.add(p["keyframe"])
        error = _gnss_error(antenna, enu)
        noise = _cauchy(gtsam.noiseModel.Diagonal.Sigmas(np.array(p["sigmas"])), p.get("robust", 3.0))
        self._alive.append(error)
        self._graph.add(gtsam.CustomFactor(noise, [Z(datum), X(p["keyframe"])], error))

    @property
    def T_enu_map(self) -> Array | None:
        """(4, 4) of the datum with the most fixes; None before there is one."""
        if not self.data:
            return None
        return self.data[max(self._fixes_of, key=self._fixes_of.__getitem__)]

    def gnss_offset_m(self, datum: int) -> Array:
        """(3,) m: by how much the trajectory misses the newest fixes of a datum (median); zero while they are few."""
        newest = self._fixes.get(datum, ())
        if len(newest) < _OFFSET_FIXES:
            return np.zeros(3)
        T = self.data[datum]
        in_map = [self.poses[i][:3, :3] @ antenna + self.poses[i][:3, 3] for i, antenna, _ in newest]
        return np.median(np.array(in_map) @ T[:3, :3].T + T[:3, 3] - np.array([enu for *_, enu in newest]), axis=0)

    def fixes(self, newest: int) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
        """Of the newest so many GNSS factors: keyframes (m,), data (m,), antenna positions (m, 3) in `enu`, m."""
        rows = self._all_fixes.rows[-newest:].copy()
        return rows[:, 0].astype(np.int64), rows[:, 1].astype(np.int64), rows[:, 2:]

    # --- estimate ---------------------------------------------------------------------------------------------

    def optimise(self, corrected: bool, far: bool = True) -> None:
        """Takes the new factors in; with `corrected` (not odometry alone) reads all poses again.

        far: poses may move so far that one linearisation will not do, as loops move them and fixes do not.
        """
        if not corrected:  # a chain of odometry alone: nothing before the new keyframe can have moved
            if self._graph.size() >= _TOGETHER:
                self._take_in()
            return
        self._take_in()
        for _ in range(self.settings.extra_updates if far else 0):
            self._isam.update()
        estimate = self._isam.calculateEstimate()
        rows = gtsam.utilities.extractPose3(estimate)
        count, T = len(self.poses), self.poses.matrices
        T[:, :3, :3], T[:, :3, 3] = rows[:count, :9].reshape(count, 3, 3), rows[:count, 9:12]
        for row, datum in zip(rows[len(self.poses) :], sorted(self.data), strict=True):  # rows come by key: x, z
            self.data[datum] = _from_row(row)

    def _take_in(self) -> None:
        self._isam.update(self._graph, self._values)
        self._graph, self._values = gtsam.NonlinearFactorGraph(), gtsam.Values()

    def turned(self, T_map_lidar: Array) -> Array:
        """(6, 6): what a pose (4, 4) is off by in the frame of the first one as it was answered, squared.

        Levelling and GNSS turn the map about its origin. That was an error before, and is one against all that was
        answered then: by how much is known, but whoever holds those answers does not know it.
        """
        if not len(self.poses) or np.abs(self.poses[0] - self.T_map_first).max() < _STILL:
            return np.zeros((6, 6))
        as_before = self.T_map_first @ se3.inv(self.poses[0]) @ T_map_lidar
        off = se3.log(se3.inv(T_map_lidar) @ as_before)
        return np.outer(off, off)

    def tilt_sigma_rad(self, keyframe: int) -> float:
        """How well the graph knows what is level at a keyframe."""
        self._take_in()
        R = self.poses[keyframe][:3, :3]
        covariance = R @ self._isam.marginalCovariance(X(keyframe))[:3, :3] @ R.T
        return float(np.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[-1]))

    @classmethod
    def restore(cls, settings: GraphSettings, records: list[FactorRecord], poses: Sequence[Array]) -> PoseGraph:
        """Builds the graph again from what the store holds."""
        graph = cls(settings)
        for record in records:
            new = record.kind in ("prior", "odometry")
            graph.records.append(record)
            graph._add(record.kind, json.loads(record.payload), poses[len(graph.poses)] if new else None)
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
