"""Both pipelines in one process and in lockstep, between a recording whose stream a test may harm and the truth."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edge_agent.imu import make_imu_node
from edge_agent.imu.settings import ImuSettings
from edge_agent.loop import AgentLoop, Imu, Parts
from edge_agent.metrics import EdgeMetrics
from edge_agent.pipeline import EdgePipeline
from edge_agent.settings import PipelineSettings as EdgeSettings
from edge_agent.sources import Event, Sequencer, open_recording
from edge_agent.types import EncodedFrame, OdomPoses
from edge_agent.wire import Answer, answer, frame_message
from map_service import messages
from map_service.loops import LoopVerifier
from map_service.pipeline import MapPipeline
from map_service.settings import PipelineSettings as MapSettings
from map_service.types import State
from splitslam import codec, se3
from splitslam.evaluate import Evaluation, evaluate
from splitslam.robot import Robot, load_robot
from splitslam.tum import Trajectory, read_tum
from splitslam.wire import session_pb2 as pb

TimedEvent = tuple[int, Event]
Harm = Callable[[Iterator[TimedEvent]], Iterable[TimedEvent]]
Arrives = Callable[[int], bool]


@dataclass
class Replayed:
    """What came out: by scan the answered state and poses; the node, and everything that was dropped, by reason."""

    stamps_ns: list[int] = field(default_factory=list)
    states: list[State] = field(default_factory=list)
    degenerate_axes: list[NDArray[np.float64]] = field(default_factory=list)
    covariances: list[NDArray[np.float64]] = field(default_factory=list)
    T_map_lidar: list[NDArray[np.float64]] = field(default_factory=list)
    T_odom_lidar: list[NDArray[np.float64]] = field(default_factory=list)
    dropped: Counter[str] = field(default_factory=Counter)
    read: int = 0
    uncovered: int = 0
    node: Imu | None = None
    pipeline: MapPipeline | None = None

    @property
    def jumps(self) -> dict[str, float]:
        return self.node.jumps  # type: ignore[union-attr]

    def evaluation(self, truth: Path, final: bool = True) -> Evaluation:
        """Of the optimised trajectory, or of the answers as they came."""
        poses = [T for _, _, T in self.pipeline.trajectory()] if final and self.pipeline else self.T_map_lidar
        return evaluate(trajectory(self.stamps_ns, poses), read_tum(truth))


def trajectory(stamps_ns: list[int], poses: list[NDArray[np.float64]]) -> Trajectory:
    stacked = np.array(poses)
    quats = np.array([se3.quat_from_matrix(T[:3, :3]) for T in poses])
    return Trajectory(np.array(stamps_ns, np.int64), stacked[:, :3, 3].copy(), quats)


class _Service:
    """An uplink that is the map service itself."""

    anchored, limit_kbps, backlog = True, None, False

    def __init__(self, pipeline: MapPipeline, beams: NDArray[np.float32], arrives: Arrives, out: Replayed) -> None:
        self._pipeline, self._beams, self._arrives, self._out = pipeline, beams, arrives, out
        self._answers: list[Answer] = []

    def send(self, frame: pb.Frame) -> None:
        decoded = codec.decode(frame.payload, frame.seq, frame.stamp_ns, frame.dense, self._beams)
        fixes, _ = messages.fixes_from_wire(list(frame.fixes))
        mapped, out = self._pipeline.process(decoded, fixes), self._out
        out.stamps_ns.append(mapped.stamp_ns)
        out.states.append(mapped.state)
        out.degenerate_axes.append(mapped.degenerate_axes)
        out.covariances.append(mapped.covariance)
        out.T_map_lidar.append(mapped.T_map_lidar)
        if self._arrives(mapped.seq):
            self._answers.append(answer(messages.odometry(mapped), 0.0))

    def take_answers(self) -> list[Answer]:
        taken, self._answers = self._answers, []
        return taken

    def take_want_dense(self) -> bool:
        return False

    def wait_answered(self, seq: int) -> bool:
        return True


class _Sink:
    def __init__(self, out: Replayed) -> None:
        self._out = out

    def on_scan_begun(self) -> None: ...

    def on_frame(self, frame: EncodedFrame, T_odom_lidar: NDArray[np.float64]) -> pb.Frame:
        self._out.T_odom_lidar.append(T_odom_lidar)
        return frame_message(frame, codec.CODEC_VERSION, "run")

    def on_answer(self, answer: Answer) -> None: ...
    def on_poses(self, poses: OdomPoses, imu: Imu, state: int) -> None: ...


class _NoLoops(LoopVerifier):
    def submit(self, job):
        raise AssertionError("loops are off")


def replay(
    recording: Path,
    harm: Harm = lambda events: events,
    *,
    max_scans: int | None = None,
    disable: tuple[str, ...] = ("loops",),
    robot: Robot | None = None,
    arrives: Arrives = lambda seq: True,
) -> Replayed:
    """Runs the recording through `harm` and both pipelines; robot: None for the robot file beside it.

    arrives: which answers reach the robot.
    """
    off = {part: None for part in ("imu", "gnss", "wheels") if part in disable}
    robot = (robot or load_robot(recording.with_suffix(".yaml"))).model_copy(update=off)
    out, metrics = Replayed(), EdgeMetrics()
    with open_recording(recording, robot, max_scans=max_scans) as read:
        node = make_imu_node(read.robot, ImuSettings())
        sequencer = Sequencer(read.robot)
        edge = EdgePipeline(read.robot, EdgeSettings(), read.beam_elevations_rad, node)
        service = MapPipeline(read.robot, MapSettings(), _NoLoops(), frozenset(disable), edge.image_node.name)
        metrics.drop_sources += [read.dropped, sequencer.dropped]
        parts = Parts(
            sequencer, node, edge, _Service(service, read.beam_elevations_rad, arrives, out), _Sink(out), metrics
        )
        loop = AgentLoop(parts, lockstep=True)
        loop.run([event] for event in harm(read.events()))
        assert loop.finish()
        service.finish()
        out.node, out.pipeline, out.uncovered = node, service, sequencer.uncovered
        out.read = read.counts.scans_read
    out.dropped = Counter(metrics.all_dropped())
    return out
