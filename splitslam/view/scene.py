"""Everything that is shown, as entities of one Rerun recording on one time line, the sensors' own time.

world/ROBOT/map/n            points of a block of keyframes, in the frame of its first one, under T_map_lidar of that
world/ROBOT/map/newest/n     points of a keyframe whose block is not complete, in its own frame
world/ROBOT/trajectory/n     the way of the scans that hang on a block's keyframes: it moves with them
world/ROBOT/online/n         the way as it was answered at the time, in `map`
world/ROBOT/lidar            T_map_lidar of the newest scan; under it corners, surfs, matches, covariance
world/ROBOT/loops            a line for each loop closure
world/ROBOT/gnss             fixes, and a line from each to its keyframe
latency, uplink, doubt       /ROBOT/...: plots
events/ROBOT                 text
"""

from __future__ import annotations

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from splitslam.view.colours import colours_of
from splitslam.view.robot_scene import RobotScene

TIMELINE = "stamp"


class Scene:
    """Robots appear as they are first asked for. One thread at a time."""

    def __init__(self, recording: rr.RecordingStream, voxel_m: float, most_points: int = 0) -> None:
        """voxel_m: of maps, 0: every point. most_points: of all maps together, 0: no bound."""
        self._recording, self._voxel_m, self._most_points = recording, voxel_m, most_points
        self._robots: dict[str, RobotScene] = {}
        self.latest_ns = 0
        recording.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)

    def robot(self, name: str) -> RobotScene:
        if name not in self._robots:
            colours, most = colours_of(len(self._robots)), self._share if self._most_points else None
            self._robots[name] = RobotScene(self._log, name, colours, self._voxel_m, most)
        return self._robots[name]

    def _share(self) -> int:
        """Of the points, each robot's."""
        return self._most_points // len(self._robots)

    @property
    def positions_map(self) -> NDArray[np.float64]:
        """(K, 3) m: where the keyframes of all robots are."""
        return np.concatenate([np.zeros((0, 3)), *(robot.positions_map for robot in self._robots.values())])

    @property
    def robots(self) -> tuple[str, ...]:
        return tuple(self._robots)

    def _log(self, stamp_ns: int | None, path: str, what: rr.AsComponents) -> None:
        """stamp_ns None: it holds at all times."""
        if stamp_ns is None:
            self._recording.log(path, what, static=True)
            return
        self.latest_ns = max(self.latest_ns, stamp_ns)
        self._recording.set_time(TIMELINE, timestamp=np.datetime64(stamp_ns, "ns"))
        self._recording.log(path, what)
