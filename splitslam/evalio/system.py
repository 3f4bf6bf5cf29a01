"""Edge and map in one process, fed a measurement at a time: what `splitslam run` does, without its programs.

Scan k sees the answers to scans up to k - 2, and a loop is verified before the next scan: the same input gives the
same poses.
"""

from __future__ import annotations

from concurrent.futures import Future
from typing import cast

import numpy as np
from numpy.typing import NDArray

from edge_agent.imu import make_imu_node
from edge_agent.imu.settings import ImuSettings
from edge_agent.loop import AgentLoop, Imu, Parts
from edge_agent.metrics import EdgeMetrics
from edge_agent.odometry.outage import Correction, Outages
from edge_agent.odometry.settings import OdometrySettings
from edge_agent.pipeline import EdgePipeline
from edge_agent.settings import PipelineSettings as EdgeSettings
from edge_agent.sources import Sequencer
from edge_agent.types import EncodedFrame, OdomPoses
from edge_agent.wire import Answer, answer, frame_message
from map_service import messages
from map_service.loops import LoopJob, LoopResult, verify
from map_service.pipeline import MapPipeline
from map_service.settings import PipelineSettings as MapSettings
from map_service.types import MapAnswer
from splitslam import codec
from splitslam.robot import Robot
from splitslam.scan import ImuSamples, Scan
from splitslam.wire import session_pb2 as pb

Array = NDArray[np.float64]


class System:
    """One drive. `take_answers` after each `push`."""

    def __init__(
        self,
        robot: Robot,
        beam_elevations_rad: NDArray[np.float32],
        *,
        loops: bool = True,
        max_kbps: float | None = None,
    ) -> None:
        """beam_elevations_rad: (rings,). max_kbps: budget of the uplink that frames are made for; None: no limit."""
        node = make_imu_node(robot, ImuSettings())
        edge = EdgePipeline(robot, EdgeSettings(), beam_elevations_rad, node)
        disable = frozenset() if loops else frozenset({"loops"})
        self.map = MapPipeline(robot, MapSettings(), _AtOnce(), disable, edge.image_node.name)
        self._uplink = _Direct(self.map, beam_elevations_rad, max_kbps)
        self.metrics, sequencer = EdgeMetrics(), Sequencer(robot)
        self.metrics.drop_sources.append(sequencer.dropped)
        outages = Outages(OdometrySettings(), True, None)
        parts = Parts(sequencer, node, edge, self._uplink, _Nobody(), self.metrics, outages=outages)
        self._loop = AgentLoop(parts, lockstep=True)

    def push(self, measurement: Scan | ImuSamples) -> None:
        """The next one in order of time. A scan is mapped once the IMU covers it."""
        stamp_ns = measurement.stamp_ns if isinstance(measurement, Scan) else int(measurement.stamps_ns[-1])
        self._loop.run([[(stamp_ns, measurement)]])

    def finish(self) -> None:
        """There are no more: the last scan, and the loops that are still being looked at."""
        self._loop.finish()
        self.map.finish()

    def take_answers(self) -> list[MapAnswer]:
        """The new ones, in order."""
        taken, self._uplink.mapped = self._uplink.mapped, []
        return taken


class _Direct:
    """An uplink that is the map itself; every frame goes through its encoding."""

    anchored, backlog = True, False

    def __init__(self, map_: MapPipeline, beams: NDArray[np.float32], limit_kbps: float | None) -> None:
        self._map, self._beams, self.limit_kbps = map_, beams, limit_kbps
        self._answers: list[Answer] = []
        self.mapped: list[MapAnswer] = []

    def send(self, frame: pb.Frame, arrived_s: float | None = None) -> None:
        features = codec.decode(frame.payload, frame.seq, frame.stamp_ns, frame.dense, self._beams)
        mapped = self._map.process(features)
        self.mapped.append(mapped)
        self._answers.append(answer(messages.odometry(mapped), 0.0))

    def take_answers(self) -> list[Answer]:
        taken, self._answers = self._answers, []
        return taken

    def take_want_dense(self) -> bool:
        return False

    def wait_answered(self, seq: int) -> bool:
        return True


class _AtOnce:
    """Verifies loops where they are submitted."""

    def submit(self, job: LoopJob) -> Future[LoopResult]:
        future: Future[LoopResult] = Future()
        future.set_result(verify(job))
        return future


class _Nobody:
    """Poses at IMU rate are for planners."""

    def on_scan_begun(self) -> None: ...

    def on_frame(self, frame: EncodedFrame, T_odom_lidar: Array) -> pb.Frame:
        return cast(pb.Frame, frame_message(frame, codec.CODEC_VERSION))

    def on_answer(self, answer: Answer) -> None: ...

    def on_correction(self, correction: Correction) -> None: ...

    def on_poses(self, poses: OdomPoses, imu: Imu, state: int) -> None: ...
