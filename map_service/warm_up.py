"""Every kernel compiled (or read from its cache) before the first robot comes: a made room seen a few times."""

from __future__ import annotations

import numpy as np

from map_service.engine import SlamEngine
from map_service.hello import SessionRequest
from map_service.places import PlaceIndex
from map_service.scan_alignment import deskewed_again
from map_service.settings import PlaceSettings, TrackerSettings
from map_service.store import Opening
from map_service.wide_search import WideSearch
from splitslam import codec
from splitslam.features import FeatureFrame, FeatureSet, Knots, Motion
from splitslam.registration.align import Registration
from splitslam.registration.local_map import LocalMap
from splitslam.robot import Robot
from splitslam.wire import session_pb2 as pb

_FRAMES = 3
_COLUMNS = 360
_SCAN_NS = 100_000_000


def warm_up(engine: SlamEngine) -> None:
    """Maps a few frames of a session that is kept nowhere."""
    robot = Robot(imu=None, gnss=None)
    beams = np.deg2rad(np.linspace(-15.0, 15.0, robot.lidar.rings)).astype(np.float32)
    opening = Opening("warm-up", "warm-up", "", "", "", "")
    request = SessionRequest(opening, robot, beams, codec.CODEC_VERSION, "cpu", frozenset({"loops", "gnss"}), True)
    pipeline = engine.create(request, None)
    for seq in range(1, _FRAMES + 1):
        made = _frame(seq, beams)
        payload = codec.encode(made, beams, _COLUMNS)
        frame = pb.Frame(seq=seq, stamp_ns=made.stamp_ns, dense=made.dense, payload=payload)
        pipeline.answer(engine.decode(frame, request), [])
        pipeline.settle()
    settings = TrackerSettings()
    search = WideSearch(settings.search, Registration(settings.registration))
    search.places(LocalMap(settings.local_map), _frame(1, beams), np.eye(4))  # a lost robot waits for no compiler
    surfs = _frame(1, beams).surfs
    PlaceIndex(PlaceSettings()).add(surfs.points_lidar)  # nor does the first keyframe's
    deskewed_again(surfs, np.ones(6))


def _frame(seq: int, beams_rad: np.ndarray) -> FeatureFrame:
    """A room of 20 x 20 x 4 m around the sensor; each fifth column is a corner."""
    ring, column = np.divmod(np.arange(len(beams_rad) * _COLUMNS), _COLUMNS)
    azimuth = 2 * np.pi * column / _COLUMNS
    elevation = beams_rad[ring].astype(float)
    directions = np.column_stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    )
    range_m = (np.array([10.0, 10.0, 2.0]) / np.maximum(np.abs(directions), 1e-9)).min(axis=1)
    points = (directions * range_m[:, None]).astype(np.float32)
    offsets_ns = (column * (_SCAN_NS // _COLUMNS)).astype(np.int32)
    corner = column % 5 == 0

    def features(chosen: np.ndarray) -> FeatureSet:
        return FeatureSet(
            np.ascontiguousarray(points[chosen]),
            ring[chosen].astype(np.uint8),
            column[chosen].astype(np.uint16),
            offsets_ns[chosen],
            np.full(int(chosen.sum()), 100, np.uint8),
        )

    knots = Knots(np.array([0, _SCAN_NS], np.int64), np.zeros((2, 3)), np.zeros((2, 3)))
    down = np.array([0.0, 0.0, -1.0])
    motion = Motion(np.eye(4), np.eye(6) * 1e-4, np.zeros(3), knots, down, 0.01, seq > 1)
    return FeatureFrame(seq, seq * _SCAN_NS, True, motion, features(corner), features(~corner))
