"""One session as it goes on: its messages become what is shown of its robot."""

from __future__ import annotations

import numpy as np

from splitslam.tum import Trajectory
from splitslam.view.decoding import keyframe_poses, points, scan_shown
from splitslam.view.fetcher import Wanted
from splitslam.view.history import KeyframeStamps, ShownKeyframe, show_way
from splitslam.view.records import Array
from splitslam.view.robot_scene import RobotScene
from splitslam.wire import view_pb2

_WAIT_SCANS = 20  # a keyframe is stored by then


class SessionView:
    """Duplicates are passed over: two replicas may tell of the same scan while a session moves."""

    def __init__(self, session_id: str, robot: RobotScene) -> None:
        self._session_id, self.robot = session_id, robot
        self._poses: dict[int, Array] = {}
        self._history: Trajectory | None = None
        self._stamps: KeyframeStamps | None = None
        self._taken_ns: dict[int, int] = {}  # of keyframes that were fetched
        self._loops: list[tuple[int, int]] = []
        self._last_seq = 0
        self._first_ns = self._stamp_ns = 0
        self._fetching = False
        self._asked_for_all = False
        self._scans_since_fetch = 0
        self.missed = 0
        self.scans = 0

    def take(self, response: view_pb2.WatchScansResponse) -> None:
        """Raises ValueError for a message that does not hold together; nothing of it is shown then."""
        poses = keyframe_poses(response.map)
        fixes_map = points(response.map.fixes_map)
        fresh = response.HasField("scan") and response.scan.answer.seq > self._last_seq
        scan = scan_shown(response.scan, response.answer_ms) if fresh else None
        if scan is not None:
            self._last_seq, self._stamp_ns = response.scan.answer.seq, scan.stamp_ns
            self._first_ns = self._first_ns or scan.stamp_ns
            self.scans += 1
            self._scans_since_fetch += 1
        if response.missed:
            self.missed += response.missed
            self.robot.event(self._stamp_ns, f"{response.missed} scans not shown: this viewer was too slow", "WARN")
        self._moved(poses)
        if scan is not None:
            if response.scan.answer.keyframe and scan.features is not None:
                self._poses[scan.keyframe] = scan.T_map_lidar
                self.robot.keyframe(scan.stamp_ns, scan.keyframe, scan.T_map_lidar, scan.features.points_lidar)
            self.robot.scan(scan)
        self._factors(response.map, bool(poses))
        if len(response.map.fix_keyframes):
            self.robot.fixes(self._stamp_ns, list(response.map.fix_keyframes), fixes_map)

    def _moved(self, poses: dict[int, Array]) -> None:
        if len(poses) > 1 and self._poses:
            moved_m = [np.linalg.norm(T[:3, 3] - self._poses[i][:3, 3]) for i, T in poses.items() if i in self._poses]
            if moved_m and max(moved_m) > 0.05:
                text = f"{len(moved_m)} keyframes moved, by {max(moved_m):.2f} m at most"
                self.robot.event(self._stamp_ns, text)
        self._poses.update(poses)
        if poses:
            self.robot.move(self._stamp_ns, poses)

    def _factors(self, message: view_pb2.MapSeen, moved: bool) -> None:
        if len(message.loops):
            pairs = list(zip(message.loops[::2], message.loops[1::2], strict=True))
            for older, newer in pairs[len(self._loops) :]:
                self.robot.event(self._stamp_ns, f"loop closed: keyframes {older} and {newer}")
            self._loops = pairs
        if self._loops and (moved or len(message.loops)):
            self.robot.loops(self._stamp_ns, self._loops)

    # -- what is stored ----------------------------------------------------------------------------------------

    def wanted(self) -> Wanted | None:
        """What is to be fetched now: everything at first, later keyframes whose scan was missed."""
        if self._fetching:
            return None
        if not self._asked_for_all:
            self._asked_for_all = self._fetching = True
            return Wanted(self._session_id, way=True)
        missing = self.robot.without_points
        if not missing or self._scans_since_fetch < _WAIT_SCANS:
            return None
        self._fetching = True
        return Wanted(self._session_id, missing[0])

    def take_way(self, trajectory: Trajectory) -> None:
        """The corrected trajectory as it is stored; it comes before the keyframes that belong to it."""
        self._history, self._stamps = trajectory, KeyframeStamps(trajectory)

    def take_keyframe(self, stored: ShownKeyframe) -> None:
        """Shown where the newest correction has put it, at the time when it was taken or its block was complete."""
        if self.robot.shows(stored.index):
            return
        T = self._poses.setdefault(stored.index, stored.T_map_lidar)
        stamp_ns = self._stamps.of(stored.T_map_lidar[:3, 3]) if self._stamps else self._stamp_ns
        self._taken_ns[stored.index] = stamp_ns
        self.robot.stored_keyframe(stamp_ns, stored.index, T, stored.points_lidar)

    def fetched(self) -> None:
        """All that was wanted is there: the way until the first scan that was seen here hangs on its keyframes."""
        self.robot.settle()
        if self._history is not None and self._taken_ns:
            before = self._history.stamps_ns < (self._first_ns or np.iinfo(np.int64).max)
            show_way(self.robot, self._history[before], self._taken_ns)
        self._history = self._stamps = None
        self._taken_ns.clear()
        self._fetching, self._scans_since_fetch = False, 0
