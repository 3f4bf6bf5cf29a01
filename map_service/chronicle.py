"""What happens to a session's map, noted by its pipeline for the next commit: versions, loops, GNSS data."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from map_service.gnss import GnssGate
from map_service.graph import PoseGraph
from map_service.growing import Poses
from map_service.happenings import DatumFound, Happened, Happening, LoopAccepted
from map_service.loop_gate import Admitted
from map_service.map_versions import MapVersions
from map_service.settings import GraphSettings
from map_service.types import Cause, CorrectionRecord
from splitslam import se3

Array = NDArray[np.float64]


class Chronicle:
    """Kept in memory until a commit takes it; nothing in the pipeline depends on what is in it."""

    def __init__(self, settings: GraphSettings) -> None:
        self._versions = MapVersions(settings)
        self._data = 0  # of GNSS, noted so far
        self._noted: list[Happened] = []
        self.seq = self.stamp_ns = 0  # of the frame at hand

    @property
    def map_version(self) -> int:
        """Of now."""
        return self._versions.number

    def resume(self, map_version: int, poses: Poses, data: int) -> None:
        """Goes on with a stored session that has `data` GNSS data."""
        self._versions.resume(map_version, poses)
        self._data = data

    def frame(self, seq: int, stamp_ns: int) -> None:
        """Whatever is noted from here on is of this frame."""
        self.seq, self.stamp_ns = seq, stamp_ns

    def keyframe(self, T_map_lidar: Array) -> None:
        """A new one, (4, 4)."""
        self._versions.added(T_map_lidar)

    def corrected(self, before: Array, after: Array, cause: Cause) -> None:
        """The keyframes (n, 4, 4) were moved, after the frame at hand was answered."""
        if (move := self._versions.corrected(before, after, cause, self.seq + 1)) is not None:
            self._note(move)

    def relocalised(self, poses: Array, correction: CorrectionRecord) -> None:
        """The frame at hand is answered from where the robot was found. poses: of the keyframes (n, 4, 4)."""
        size = correction.translation_m, correction.rotation_rad
        self._note(self._versions.relocalised(poses, size, self.seq))

    def loops(self, admitted: Sequence[Admitted], poses: Sequence[Array]) -> None:
        """Loops on their way into the graph, whose keyframes are at `poses` so far."""
        for loop in (a.loop for a in admitted):
            gap = se3.inv(poses[loop.newer]) @ poses[loop.older] @ loop.T_older_newer
            self._note(LoopAccepted(loop.older, loop.newer, float(np.linalg.norm(gap[:3, 3])), se3.angle(gap)))

    def data(self, graph: PoseGraph, gate: GnssGate) -> None:
        """Those of the graph that are new."""
        for datum in sorted(graph.data)[self._data :]:
            assert gate.origin is not None
            self._note(DatumFound(datum, gate.origin, graph.data[datum].copy()))
        self._data = len(graph.data)

    def _note(self, what: Happening) -> None:
        self._noted.append(Happened(self.seq, self.stamp_ns, what))

    def take(self) -> list[Happened]:
        """What is new since the last call, in order."""
        taken, self._noted = self._noted, []
        return taken
