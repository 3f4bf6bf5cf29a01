"""Whole scans and clouds for the tests, and a link that says what it is told to say."""

from __future__ import annotations

import numpy as np

from splitslam import dense_cloud
from splitslam.codec import STEP_M
from splitslam.dense_cloud import WholeScan
from splitslam.features import FeatureSet
from splitslam.wire import dense_pb2 as pb
from tests.codec.frames import COLUMNS, ELEVATIONS_RAD, feature_set, motion
from tests.map_service.harness import STAMP_0_NS, new_run


def whole_scan(seq: int = 1, points: int = 300) -> WholeScan:
    """Of frame `seq` of tests.map_service.harness."""
    some = feature_set(np.random.default_rng(seq), points)
    return WholeScan(seq, STAMP_0_NS + seq * 100_000_000, motion(), some, ELEVATIONS_RAD, COLUMNS)


def large_scan(rings: int = 128, columns: int = 2048) -> WholeScan:
    """One of a large sensor: every cell of its image is full."""
    elevations_rad = np.linspace(-0.4, 0.4, rings).astype(np.float32)
    ring, column = (a.ravel() for a in np.indices((rings, columns)))
    azimuth = (column - columns // 2) * 2 * np.pi / columns
    e = elevations_rad[ring].astype(np.float64)
    directions = np.stack([np.cos(e) * np.cos(azimuth), np.cos(e) * np.sin(azimuth), np.sin(e)], axis=1)
    points = FeatureSet(
        points_lidar=(directions * (20.0 + 5.0 * np.sin(3 * azimuth))[:, None]).astype(np.float32),
        ring=ring.astype(np.uint8),
        column=column.astype(np.uint16),
        t_offset_ns=(column * 48_000).astype(np.int32),
        intensity=(ring * 2).astype(np.uint8),
    )
    return WholeScan(1, STAMP_0_NS, motion(), points, elevations_rad, columns)


def cloud(seq: int = 1, points: int = 300) -> bytes:
    return dense_cloud.encode(whole_scan(seq, points), STEP_M)


def opening(run_id: str = "", robot_id: str = "rover-7", site_id: str = "") -> pb.UploadOpen:
    return pb.UploadOpen(robot_id=robot_id, run_id=run_id or new_run(), site_id=site_id)


class OpenLink:
    """A link that is idle, or not, also for so many bytes only (`most`): edge_agent.clouds.sender.Link."""

    def __init__(self, limit_kbps: float | None = None) -> None:
        self.takes_dense, self.limit_kbps = True, limit_kbps
        self.idle, self.most = True, float("inf")
        self.sent: list[int] = []

    def spare_s(self, size: int) -> float:
        return 0.0 if self.idle and sum(self.sent) < self.most else 0.01

    def spare_sent(self, size: int) -> None:
        self.sent.append(size)
