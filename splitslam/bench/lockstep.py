"""Both pipelines in one process and in lockstep, with a look at every scan and a choice of what goes over the wire."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edge_agent.features.integer import FeatureMarks
from edge_agent.features.projection import Image
from edge_agent.image_node import ImageNode
from edge_agent.imu import make_imu_node
from edge_agent.imu.settings import ImuSettings
from edge_agent.loop import AgentLoop, Imu, Parts
from edge_agent.metrics import EdgeMetrics
from edge_agent.pipeline import EdgePipeline
from edge_agent.settings import PipelineSettings as EdgeSettings
from edge_agent.sources import Event, Sequencer, open_recording
from edge_agent.sources.recording import Counts
from edge_agent.types import EncodedFrame, MotionSource, OdomPoses
from edge_agent.warm_up import warm_up
from edge_agent.wire import Answer, answer, frame_message
from map_service import messages
from map_service.loops import LoopVerifier
from map_service.pipeline import MapPipeline
from map_service.settings import PipelineSettings as MapSettings
from splitslam import codec, se3
from splitslam.features import FeatureFrame, Knots
from splitslam.robot import Robot, load_robot
from splitslam.scan import Scan, ScanPacket
from splitslam.tum import Trajectory
from splitslam.wire import session_pb2 as pb


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """One scan on its way through the edge. image: deskewed; its arrays are views that the next scan overwrites.

    columns: of the image. beam_elevations_rad: (rings,).
    """

    scan: Scan
    image: Image
    frame: EncodedFrame
    columns: int
    beam_elevations_rad: NDArray[np.float32]

    def decoded(self) -> FeatureFrame:
        """The frame as the map service reads it."""
        frame = self.frame
        return codec.decode(frame.payload, frame.seq, frame.stamp_ns, frame.dense, self.beam_elevations_rad)


Wire = Callable[[Seen], FeatureFrame]  # what arrives at the map service for what the edge has seen


@dataclass(frozen=True, slots=True, eq=False)
class Mapped:
    """How a recording came out. trajectory: final T_map_lidar. counts: what was read."""

    trajectory: Trajectory
    counts: Counts
    recording_s: float


class _SeeingNode:
    """The Image node, which remembers what it made last."""

    def __init__(self, node: ImageNode) -> None:
        self._node = node
        self.counts = node.counts
        self.last: Image | None = None

    @property
    def name(self) -> str:
        return self._node.name

    def effective(self, knots: Knots) -> Knots:
        return self._node.effective(knots)

    def image(self, scan: Scan, knots: Knots) -> Image:
        self.last = self._node.image(scan, knots)
        return self.last

    def marks(self, image: Image) -> FeatureMarks:
        return self._node.marks(image)

    def close(self) -> None:
        self._node.close()


class _SeeingPipeline(EdgePipeline):
    """The edge's pipeline, which remembers the scan that went through it last."""

    def __init__(
        self, robot: Robot, settings: EdgeSettings, beam_elevations_rad: NDArray[np.float32], imu: MotionSource
    ) -> None:
        super().__init__(robot, settings, beam_elevations_rad, imu)
        self.image_node = self._node = _SeeingNode(self.image_node)
        self.last: Seen | None = None

    def process(self, packet: ScanPacket) -> EncodedFrame:
        frame = super().process(packet)
        assert self._node.last is not None
        self.last = Seen(packet.scan, self._node.last, frame, self.columns, self.beam_elevations_rad)
        return frame


class _Service:
    """An uplink that is the map service itself."""

    anchored, backlog = True, False

    def __init__(self, pipeline: MapPipeline, edge: _SeeingPipeline, wire: Wire, limit_kbps: float | None) -> None:
        self._pipeline, self._edge, self._wire, self.limit_kbps = pipeline, edge, wire, limit_kbps
        self._answers: list[Answer] = []

    def send(self, frame: pb.Frame) -> None:
        fixes, _ = messages.fixes_from_wire(list(frame.fixes))
        assert self._edge.last is not None
        mapped = self._pipeline.process(self._wire(self._edge.last), fixes)
        self._answers.append(answer(messages.odometry(mapped), 0.0))

    def take_answers(self) -> list[Answer]:
        taken, self._answers = self._answers, []
        return taken

    def take_want_dense(self) -> bool:
        return False

    def wait_answered(self, seq: int) -> bool:
        return True


class _Sink:
    def on_scan_begun(self) -> None: ...

    def on_frame(self, frame: EncodedFrame, T_odom_lidar: NDArray[np.float64]) -> pb.Frame:
        return frame_message(frame, codec.CODEC_VERSION, "run")

    def on_answer(self, answer: Answer) -> None: ...
    def on_poses(self, poses: OdomPoses, imu: Imu, state: int) -> None: ...


class _NoLoops(LoopVerifier):
    def submit(self, job: object) -> None:
        raise AssertionError("loops are off")


def lockstep(
    recording: Path,
    robot_path: Path,
    wire: Wire,
    *,
    max_scans: int | None = None,
    disable: tuple[str, ...] = (),
    edge_settings: EdgeSettings | None = None,
    max_kbps: float | None = None,
    deskew_again: bool = True,
    every: int = 1,
) -> Mapped:
    """Odometry of a recording with `wire` between edge and map; loops are off.

    disable: of gnss, imu, wheels. max_kbps: the uplink's budget. deskew_again: False when the wire carries no times of
    points. every: 2 takes each second scan, and so on. Raises InputError for a recording or a robot file that cannot be
    used.
    """
    off = {part: None for part in ("imu", "gnss", "wheels") if part in disable}
    robot = load_robot(robot_path).model_copy(update=off)
    settings = edge_settings or EdgeSettings()
    with open_recording(recording, robot, max_scans=max_scans) as read:
        beams = read.beam_elevations_rad
        warm_up(read.robot, settings, ImuSettings(), beams)
        imu, metrics, sequencer = make_imu_node(read.robot, ImuSettings()), EdgeMetrics(), Sequencer(read.robot)
        edge = _SeeingPipeline(read.robot, settings, beams, imu)
        deskew = edge.image_node.name if deskew_again else "off"
        service = MapPipeline(read.robot, MapSettings(), _NoLoops(), frozenset({*disable, "loops"}), deskew)
        parts = Parts(sequencer, imu, edge, _Service(service, edge, wire, max_kbps), _Sink(), metrics)
        loop = AgentLoop(parts, lockstep=True)
        loop.run([event] for event in _thinned(read.events(), every))
        loop.finish()
        service.finish()
        edge.image_node.close()
        return Mapped(_trajectory(service), read.counts, (read.end_ns - read.start_ns) * 1e-9)


def _thinned(events: Iterator[tuple[int, Event]], every: int) -> Iterator[tuple[int, Event]]:
    """Without the scans between each `every`th."""
    scans = 0
    for at_ns, event in events:
        if isinstance(event, Scan):
            scans += 1
            if scans % every:
                continue
        yield at_ns, event


def _trajectory(service: MapPipeline) -> Trajectory:
    rows = service.trajectory()
    poses = np.array([T for _, _, T in rows]).reshape(-1, 4, 4)
    quats = np.array([se3.quat_from_matrix(T[:3, :3]) for T in poses]).reshape(-1, 4)
    return Trajectory(np.array([ns for _, ns, _ in rows], np.int64), poses[:, :3, 3].copy(), quats)
