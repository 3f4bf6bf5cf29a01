"""GNSS fixes put on the trajectory: where the antenna was, by scan matching, when a fix was taken."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from map_service.gnss import GnssGate, GnssMeasurement, Place
from map_service.graph import PoseGraph
from map_service.tracker import Track
from map_service.tracker_state import TrackerState
from map_service.types import State
from splitslam import se3
from splitslam.scan import GnssFix

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Passage:
    """From one scan to the next: where the tracker stood (None before the first one), its track and that scan's stamp.

    T_map_local, T_map_odom: (4, 4) as they were then.
    """

    before: TrackerState | None
    track: Track
    stamp_ns: int
    T_map_local: Array
    T_map_odom: Array


class FixPlacer:
    """Offers each fix to the gate with its place; what cannot be placed is counted there."""

    def __init__(self, gate: GnssGate, antenna_lidar_m: Sequence[float], spacing_m: float) -> None:
        """antenna_lidar_m: (3,) in frame `lidar`; spacing_m: so far apart fixes on old ground are taken."""
        self._gate, self._spacing_m = gate, spacing_m
        self._antenna_lidar_m = np.asarray(antenna_lidar_m, float)

    def add(self, fixes: Sequence[GnssFix], passage: Passage, graph: PoseGraph, reference: int) -> int:
        """Adds a factor for each fix that is believed; returns how many. reference: keyframe that they are told by."""
        before, track = passage.before, passage.track
        if before is None:
            self._gate.reject("early", len(fixes))
            return 0
        if track.state in (State.LOST, State.LOCALISING) or track.T_found_carried is not None:
            self._gate.reject("lost", len(fixes))
            return 0
        if not fixes:
            return 0
        T_keyframe_map, T_odom_map = se3.inv(graph.poses[reference]), se3.inv(passage.T_map_odom)
        added = 0
        for fix in fixes:
            ratio = (fix.stamp_ns - before.stamp_ns) / (passage.stamp_ns - before.stamp_ns)
            if not -2.0 <= ratio <= 3.0:  # further off than the motion of one scan can carry a pose
                self._gate.reject("late")
                continue
            T_map_lidar = passage.T_map_local @ se3.interpolate(before.T_local_lidar, track.T_local_lidar, ratio)
            antenna_map = _at(T_map_lidar, self._antenna_lidar_m)
            in_keyframe, in_odom = _at(T_keyframe_map, antenna_map), _at(T_odom_map, antenna_map)
            for measurement in self._gate.offer(fix, Place(reference, in_keyframe, in_odom, passage.T_map_odom)):
                if reference != len(graph.poses) - 1 and self._fixed_before(measurement, graph):
                    self._gate.reject("spacing")
                    continue
                graph.add_gnss(measurement)
                added += 1
        return added

    def _fixed_before(self, measurement: GnssMeasurement, graph: PoseGraph) -> bool:
        """Does the ground around a fix have one? Else old ground collects them for as long as one stays."""
        fixed = graph.poses.positions_m[sorted(graph.fixed)]
        away_m = np.linalg.norm(fixed - graph.poses[measurement.fix.keyframe][:3, 3], axis=1)
        return bool((away_m < self._spacing_m).any())


def _at(T: Array, point: Array) -> Array:
    return T[:3, :3] @ point + T[:3, 3]
