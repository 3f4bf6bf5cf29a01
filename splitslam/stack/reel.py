"""Encoded frames of a drive, made once and played by any number of light robots."""

from __future__ import annotations

import uuid
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from splitslam.wire import session_pb2 as pb

if TYPE_CHECKING:
    from map_service.loops import LoopVerifier


@dataclass(frozen=True, slots=True)
class Reel:
    """hello: without ids. frames: seq from 1, stamps as recorded, ns. T_map_lidar: of each frame, (4, 4), as the map
    pipeline answered it, and `final_T_map_lidar` as it had it at the end.
    """

    hello: pb.Hello
    frames: list[pb.Frame]
    T_map_lidar: list[NDArray[np.float64]] = field(default_factory=list)
    final_T_map_lidar: list[NDArray[np.float64]] = field(default_factory=list)

    def hello_of(self, robot_id: str, run_id: str = "") -> pb.Hello:
        """For a run of its own."""
        hello = pb.Hello()
        hello.CopyFrom(self.hello)
        hello.robot_id, hello.run_id = robot_id, run_id or str(uuid.uuid4())
        return hello


def record(
    recording: Path, robot_file: Path, max_scans: int | None = None, verifier: LoopVerifier | None = None
) -> Reel:
    """The recording through the edge's pipeline, with a map pipeline in this process as the service.

    GNSS and wheels are off; so are loops without a `verifier`. Raises InputError for files that cannot be used.
    """
    from edge_agent.imu import ImuSettings, make_imu_node
    from edge_agent.pipeline import EdgePipeline
    from edge_agent.settings import PipelineSettings as EdgeSettings
    from edge_agent.sources import Sequencer, open_recording
    from edge_agent.types import OdometryReply
    from edge_agent.wire import WIRE_VERSION, frame_message
    from map_service.pipeline import MapPipeline
    from map_service.settings import PipelineSettings as MapSettings
    from splitslam import codec
    from splitslam.check.odometry import NoLoops
    from splitslam.errors import DataError
    from splitslam.robot import load_robot, robot_for_service
    from splitslam.scan import ImuSamples, ScanPacket

    off = frozenset({"gnss", "wheels"} if verifier else {"gnss", "loops", "wheels"})
    robot = load_robot(robot_file).model_copy(update={"gnss": None, "wheels": None})
    frames: list[pb.Frame] = []
    answers: list[NDArray[np.float64]] = []
    with open_recording(recording, robot, max_scans=max_scans) as read:
        beams = read.beam_elevations_rad
        imu = make_imu_node(read.robot, ImuSettings())
        edge = EdgePipeline(read.robot, EdgeSettings(), beams, imu)
        service = MapPipeline(read.robot, MapSettings(), verifier or NoLoops(), off, edge.image_node.name)
        sequencer = Sequencer(read.robot)
        items = (item for _, event in read.events() for item in sequencer.push(event))
        for item in (*items, *sequencer.finish()):
            if isinstance(item, ImuSamples):
                imu.add_imu(item)
            if not isinstance(item, ScanPacket):
                continue
            try:
                sent = edge.process(item)
            except DataError:
                continue
            frames.append(frame_message(sent, codec.CODEC_VERSION, "reel"))
            a = service.process(codec.decode(sent.payload, sent.seq, sent.stamp_ns, sent.dense, beams))
            answers.append(a.T_map_lidar)
            pose = (a.T_map_lidar, a.T_map_odom, a.covariance)
            imu.on_odometry(OdometryReply(a.seq, a.stamp_ns, *pose, int(a.state), a.degenerate_axes))
        service.finish()
        final = [T for _, _, T in service.trajectory()]
        hello = pb.Hello(
            robot_file_yaml=robot_for_service(read.robot),
            beam_elevations_rad=beams.tolist(),
            wire_version=WIRE_VERSION,
            codec_version=codec.CODEC_VERSION,
            deskew=edge.image_node.name,
            disable=sorted(off),
        )
    return Reel(hello, frames, answers, final)
