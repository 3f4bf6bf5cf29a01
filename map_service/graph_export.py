"""A stored factor graph for those who are not the service: typed factors, and where `map` lies on Earth."""

from __future__ import annotations

import json
from collections import Counter

import gtsam
import numpy as np
from gtsam.symbol_shorthand import Z
from numpy.typing import NDArray

from map_service.catalog import StoredGraph
from splitslam import se3
from splitslam.errors import DataError
from splitslam.maps import AntennaFix, Between, MapGraph

Array = NDArray[np.float64]


def map_graph(stored: StoredGraph) -> MapGraph:
    """Typed factors of a session. Raises DataError for rows that do not hold together."""
    if [index for index, _, _ in stored.keyframes] != list(range(len(stored.keyframes))):
        raise DataError("corrupt", "a keyframe is missing")
    try:
        return _map_graph(stored)
    except (KeyError, IndexError, ValueError, TypeError) as error:
        raise DataError("corrupt", f"graph: {type(error).__name__}: {error}") from error


def _map_graph(stored: StoredGraph) -> MapGraph:
    poses = np.array([T for _, _, T in stored.keyframes]).reshape(-1, 4, 4)
    betweens: list[Between] = []
    fixes: list[AntennaFix] = []
    robust: list[float] = []
    priors: dict[int, tuple[Array, float]] = {}  # of the data: guess and tilt
    others: Counter[str] = Counter()
    for record in stored.factors:
        p = json.loads(record.payload)
        if record.kind == "odometry":
            covariance = np.reshape(p["covariance"], (6, 6))
            older = p.get("from", p["to"] - 1)
            betweens.append(Between("odometry", older, p["to"], _square(p["motion"]), covariance))
        elif record.kind == "loop":
            # loops of the first release had two sigmas: rotation rad, translation m
            covariance = p.get("covariance") or np.diag(np.repeat(np.square(p.get("sigmas", [1.0, 1.0])), 3))
            covariance = np.reshape(covariance, (6, 6))
            betweens.append(Between("loop", p["older"], p["newer"], _square(p["motion"]), covariance, robust=True))
        elif record.kind == "gnss":
            datum = p.get("datum", 0)
            priors.setdefault(datum, (_square(p["guess"]), p.get("tilt", 0.01)))
            antenna, enu_m, sigmas_m = (np.array(p[name], float) for name in ("antenna", "enu", "sigmas"))
            fixes.append(AntennaFix(p["keyframe"], antenna, enu_m, sigmas_m, datum))
            robust.append(p.get("robust", 3.0))
        else:
            others[record.kind] += 1
    if any(not 0 <= i < len(poses) for between in betweens for i in (between.older, between.newer)):
        raise DataError("corrupt", "graph: an edge to a keyframe that is not there")
    T_enu_map = {
        datum: _fitted(guess, tilt, [(f, r) for f, r in zip(fixes, robust, strict=True) if f.datum == datum], poses)
        for datum, (guess, tilt) in priors.items()
    }
    stamps_ns = np.array([stamp_ns for _, stamp_ns, _ in stored.keyframes], np.int64)
    return MapGraph(poses, stamps_ns, betweens, fixes, T_enu_map, _origin(stored.tracker), dict(others))


def _fitted(guess: Array, tilt_rad: float, fixes: list[tuple[AntennaFix, float]], poses: Array) -> Array:
    """T_enu_map of a datum (4, 4) that its fixes ask for where the keyframes are now.

    The graph keeps it as a variable and the store does not; the optimum over it alone, with the optimised poses held,
    is the optimum of the graph. The noise is graph.py's.
    """
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    prior = gtsam.noiseModel.Diagonal.Sigmas(np.array([tilt_rad, tilt_rad, 3.0, 1e3, 1e3, 1e3]))
    graph.add(gtsam.PriorFactorPose3(Z(0), gtsam.Pose3(guess), prior))
    values.insert(Z(0), gtsam.Pose3(guess))
    alive = []  # gtsam keeps no reference to a Python error function
    for fix, robust in fixes:
        T = poses[fix.keyframe]
        antenna_map = T[:3, :3] @ fix.antenna_keyframe + T[:3, 3]
        cauchy = gtsam.noiseModel.mEstimator.Cauchy.Create(robust)
        noise = gtsam.noiseModel.Robust.Create(cauchy, gtsam.noiseModel.Diagonal.Sigmas(fix.sigmas_m))
        alive.append(_misfit(antenna_map, fix.enu_m))
        graph.add(gtsam.CustomFactor(noise, [Z(0)], alive[-1]))
    return gtsam.LevenbergMarquardtOptimizer(graph, values).optimize().atPose3(Z(0)).matrix()


def _misfit(antenna_map: Array, enu_m: Array):
    def error(this: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        pose = values.atPose3(this.keys()[0])
        if jacobians is not None:
            R = pose.rotation().matrix()
            jacobians[0] = np.asfortranarray(np.hstack([-R @ se3.hat(antenna_map), R]))
        return pose.transformFrom(antenna_map) - enu_m

    return error


def _origin(tracker: bytes) -> tuple[float, float, float] | None:
    """latitude_deg, longitude_deg, altitude_m of `enu`; None before a fix was used."""
    state = json.loads(tracker) if tracker else {}
    gnss = state.get("gnss")
    if gnss is None:
        return None
    origin = gnss["datum"] if "datum" in gnss else gnss["origin"]  # as 0.1.0 called it
    return None if origin is None else (float(origin[0]), float(origin[1]), float(origin[2]))


def _square(values: list[float]) -> Array:
    T = np.eye(4)
    T[:3] = np.reshape(values, (3, 4))
    return T
