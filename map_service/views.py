"""A worker's sessions for those who watch them: each scan with its features and matches, and what moved in the map.

Nothing is made for a session that nobody watches, and nothing that goes wrong here touches the session.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from map_service.channel import Seen, Watch
from map_service.seen import MapSeen, ScanSeen
from map_service.session import Session
from splitslam.logs import fields
from splitslam.wire import session_pb2 as pb
from splitslam.wire import view_pb2

NEWEST_FIXES = 1000
_MOVED_M, _MOVED = 0.005, 0.001  # what nobody sees: of a position; of an entry of the rotation matrix

_log = logging.getLogger(__name__)
Array = NDArray[np.float64]


class SessionViews:
    """Views go out by `send`, one a scan, after its answer."""

    def __init__(self, send: Callable[[Any], None]) -> None:
        self._send = send
        self._watch = Watch()
        self._told: dict[str, MapTold] = {}

    def watch(self, message: Watch) -> None:
        """Those who look on are others than before: whoever is new among them is to be told everything."""
        self._watch = message
        self._told.clear()

    def scan(self, session: Session, frame: pb.Frame, answer: pb.Odometry) -> None:
        """After the answer is on its way, before the frame is taken into the map: its own points are not there yet."""
        if not self._watch.wants(session.request.session_id) or answer.duplicate or answer.rejected:
            return
        response = view_pb2.WatchScansResponse()
        try:
            scan, map_ = session.seen(NEWEST_FIXES)
            if scan is not None:
                fill_scan(response.scan, scan, frame, answer)
            self._fill_map(response.map, session, map_)
        except Exception:  # whatever it is, the robot's session is worth more than what a person sees of it
            self._failed(session)
            return
        self._show(session, response)

    def end(self, session: Session) -> None:
        """The map once more: the end of a run corrects it for the last time."""
        name = session.request.session_id
        if self._watch.wants(name):
            response = view_pb2.WatchScansResponse()
            try:
                self._fill_map(response.map, session, session.seen(NEWEST_FIXES)[1])
            except Exception:
                self._failed(session)
                return
            self._show(session, response)
        self._told.pop(name, None)

    def _fill_map(self, message: view_pb2.MapSeen, session: Session, map_: MapSeen) -> None:
        self._told.setdefault(session.request.session_id, MapTold()).fill(message, map_)

    def _show(self, session: Session, response: view_pb2.WatchScansResponse) -> None:
        response.session_id, response.site_id = session.request.session_id, session.request.opening.site_id
        self._send(Seen(session.stream, response.session_id, response.site_id, response.SerializeToString()))

    def _failed(self, session: Session) -> None:
        _log.exception("view failed", extra=fields(session_id=session.request.session_id))


class MapTold:
    """What a session's watchers know of its map."""

    def __init__(self) -> None:
        self._poses = np.zeros((0, 3, 4))
        self._loops = 0
        self._fixes_map = np.zeros((0, 3))

    def fill(self, message: view_pb2.MapSeen, now: MapSeen) -> None:
        """With what has changed."""
        poses = now.T_map_keyframes[:, :3]
        if len(poses) < len(self._poses):  # the session was made again from its store, which had not all of them
            self._poses, self._loops, self._fixes_map = np.zeros((0, 3, 4)), 0, np.zeros((0, 3))
        known = len(self._poses)
        off = np.abs(poses[:known] - self._poses)
        moved = (off[:, :, 3] > _MOVED_M).any(axis=1) | (off[:, :, :3] > _MOVED).any(axis=(1, 2))
        changed = np.concatenate([np.flatnonzero(moved), np.arange(known, len(poses))])
        if len(changed):
            message.keyframes.extend(changed.tolist())
            message.poses_map_lidar = poses[changed].astype("<f4").tobytes()
            self._poses = np.concatenate([self._poses, poses[known:]])
            self._poses[changed] = poses[changed]
        if len(now.loops) != self._loops:
            message.loops.extend(keyframe for pair in now.loops for keyframe in pair)
            self._loops = len(now.loops)
        if _differ(now.fixes_map, self._fixes_map):
            message.fix_keyframes.extend(now.fix_keyframes.tolist())
            message.fixes_map = now.fixes_map.astype("<f4").tobytes()
            self._fixes_map = now.fixes_map


def _differ(a: Array, b: Array) -> bool:
    return a.shape != b.shape or bool(len(a) and np.abs(a - b).max() > _MOVED_M)


def fill_scan(message: view_pb2.ScanSeen, scan: ScanSeen, frame: pb.Frame, answer: pb.Odometry) -> None:
    """The wire's form of a scan, its frame and its answer."""
    message.answer.CopyFrom(answer)
    message.frame_bytes, message.dense = len(frame.payload), frame.dense
    message.keyframe, message.registration_ms = scan.keyframe, scan.registration_ms
    message.corners_lidar = scan.corners_lidar.astype("<f4").tobytes()
    message.surfs_lidar = scan.surfs_lidar.astype("<f4").tobytes()
    message.corner_matches_lidar = scan.corner_matches_lidar.astype("<f4").tobytes()
    message.surf_matches_lidar = scan.surf_matches_lidar.astype("<f4").tobytes()
