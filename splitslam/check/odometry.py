"""LiDAR odometry that knows nothing of the IMU: both pipelines in this process, constant velocity between scans."""

from __future__ import annotations

from collections import Counter
from concurrent.futures import Future

import numpy as np
from numpy.typing import NDArray

from edge_agent.imu import ImuSettings
from edge_agent.imu.constant_velocity import ConstantVelocityNode
from edge_agent.pipeline import EdgePipeline
from edge_agent.settings import PipelineSettings as EdgeSettings
from edge_agent.types import OdometryReply
from map_service.loops import LoopJob, LoopResult
from map_service.pipeline import MapPipeline
from map_service.settings import PipelineSettings as MapSettings
from map_service.types import State
from splitslam import codec, se3
from splitslam.check.motion import LidarMotion, at_mid_scan
from splitslam.errors import DataError
from splitslam.robot import Robot
from splitslam.scan import Scan, ScanPacket

_OFF = frozenset({"loops", "gnss", "imu"})


class NoLoops:
    """A LoopVerifier that nobody asks."""

    def submit(self, job: LoopJob) -> Future[LoopResult]:
        raise AssertionError("loops are switched off")


class LidarOdometry:
    """Takes scans in order; `motion` is where the LiDAR was. dropped: scans left out by reason; lost: not tracked."""

    def __init__(self, robot: Robot, beam_elevations_rad: NDArray[np.float32]) -> None:
        alone = robot.model_copy(update={"imu": None, "gnss": None, "wheels": None})
        self._beams = beam_elevations_rad
        self._node = ConstantVelocityNode(alone, ImuSettings())
        self._edge = EdgePipeline(alone, EdgeSettings(), beam_elevations_rad, self._node)
        self._map = MapPipeline(alone, MapSettings(), NoLoops(), _OFF)
        self._starts_ns: list[int] = []
        self._ends_ns: list[int] = []
        self._poses: list[NDArray[np.float64]] = []
        self.dropped: Counter[str] = Counter()
        self.lost = 0

    def add(self, scan: Scan) -> None:
        """One scan; stamps must rise, others are dropped."""
        if self._starts_ns and scan.stamp_ns <= self._starts_ns[-1]:
            self.dropped["time_backwards"] += 1
            return
        try:
            sent = self._edge.process(ScanPacket(scan))
        except DataError as error:
            self.dropped[error.reason] += 1
            return
        frame = codec.decode(sent.payload, sent.seq, sent.stamp_ns, sent.dense, self._beams)
        a = self._map.process(frame)
        self._node.on_odometry(
            OdometryReply(a.seq, a.stamp_ns, a.T_map_lidar, a.T_map_odom, a.covariance, int(a.state), a.degenerate_axes)
        )
        self.lost += a.state is State.LOST
        self._starts_ns.append(scan.stamp_ns)
        self._ends_ns.append(scan.end_ns)
        self._poses.append(se3.inv(a.T_map_odom) @ a.T_map_lidar)

    def motion(self) -> LidarMotion | None:
        """Poses at the middles of the scans; None when there are too few."""
        if len(self._poses) < 3:
            return None
        return at_mid_scan(np.array(self._starts_ns), np.array(self._ends_ns), np.array(self._poses))
