"""Both pipelines in one process, between a recording's stream and what comes out; deterministic, in recording time.

In lockstep, scan k sees the answers to scans <= k - 2, as `splitslam run` has it. With a `Network`, answers come when
it lets them, by the recording's clock, and nobody waits.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edge_agent.features.integer import FeatureMarks
from edge_agent.features.projection import Image
from edge_agent.image_node import ImageNode
from edge_agent.imu import ConstantVelocityNode, ImuNode, make_imu_node
from edge_agent.imu.settings import ImuSettings
from edge_agent.loop import AgentLoop, Imu, Parts
from edge_agent.metrics import EdgeMetrics
from edge_agent.odometry.outage import Correction, Outages
from edge_agent.odometry.settings import OdometrySettings
from edge_agent.pipeline import EdgePipeline
from edge_agent.settings import PipelineSettings as EdgeSettings
from edge_agent.sources import Counts, Event, Sequencer, open_recording
from edge_agent.types import EncodedFrame, MotionSource, OdomPoses
from edge_agent.warm_up import warm_up
from edge_agent.wire import Answer, answer, frame_message
from map_service import messages
from map_service.loops import LoopVerifier
from map_service.pipeline import MapPipeline
from map_service.settings import PipelineSettings as MapSettings
from map_service.types import MapAnswer
from splitslam import codec, se3
from splitslam.features import FeatureFrame, Knots
from splitslam.robot import Robot, load_robot
from splitslam.scan import Scan, ScanPacket
from splitslam.tum import Trajectory
from splitslam.wire import session_pb2 as pb

Array = NDArray[np.float64]
TimedEvent = tuple[int, Event]
Harm = Callable[[Iterator[TimedEvent]], Iterable[TimedEvent]]
_FOR_EVER_NS = 1 << 62


@dataclass(frozen=True, slots=True)
class Network:
    """When answers come. An answer is there once the next frame is sent, and delay_s later; from silent_s[0] to
    silent_s[1], in seconds of the recording, none comes, and then all that have been held up."""

    delay_s: float = 0.0
    silent_s: tuple[float, float] | None = None

    def due_ns(self, ready_ns: int, start_ns: int) -> int:
        """When an answer that is ready at `ready_ns` is with the robot."""
        due_ns = ready_ns + int(self.delay_s * 1e9)
        if self.silent_s is not None:
            begin_ns, end_ns = (start_ns + int(s * 1e9) for s in self.silent_s)
            if begin_ns <= due_ns < end_ns:
                return end_ns
        return due_ns


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


MakeImageNode = Callable[[int, int], ImageNode]  # for rings and columns
Wire = Callable[[Seen], FeatureFrame]  # what arrives at the map service for what the edge has seen


@dataclass(slots=True, eq=False)
class Poses:
    """Poses as they came, T_a_b (4, 4) at their stamps."""

    stamps_ns: list[int] = field(default_factory=list)
    T: list[Array] = field(default_factory=list)

    def add(self, stamp_ns: int, T: Array) -> None:
        """One more; stamps increase."""
        self.stamps_ns.append(stamp_ns)
        self.T.append(T)

    def trajectory(self) -> Trajectory:
        """As a trajectory."""
        T = np.array(self.T).reshape(-1, 4, 4)
        quats = np.array([se3.quat_from_matrix(pose[:3, :3]) for pose in T]).reshape(-1, 4)
        return Trajectory(np.array(self.stamps_ns, np.int64), T[:, :3, 3].copy(), quats)


@dataclass(slots=True, eq=False)
class Outcome:
    """What came out.

    answers: the service's, in order. scans_odom: T_odom_lidar at each frame. scans_map: T_map_lidar at each frame, as
    the robot had it then. imu_map: T_map_lidar at IMU rate, as the robot had it then. states: at each IMU batch's end.
    """

    node: ImuNode | ConstantVelocityNode
    service: MapPipeline
    outages: Outages
    metrics: EdgeMetrics
    counts: Counts
    sequencer: Sequencer
    start_ns: int = 0
    recording_s: float = 0.0
    answers: list[MapAnswer] = field(default_factory=list)
    scans_odom: Poses = field(default_factory=Poses)
    scans_map: Poses = field(default_factory=Poses)
    imu_map: Poses = field(default_factory=Poses)
    states: list[tuple[int, int]] = field(default_factory=list)
    corrections: list[Correction] = field(default_factory=list)

    @property
    def dropped(self) -> Counter[str]:
        """All that was lost, by reason."""
        return Counter(self.metrics.all_dropped())

    def online(self) -> Trajectory:
        """T_map_lidar as answered."""
        poses = Poses()
        for mapped in self.answers:
            poses.add(mapped.stamp_ns, mapped.T_map_lidar)
        return poses.trajectory()

    def final(self) -> Trajectory:
        """Optimised T_map_lidar of every mapped frame."""
        poses = Poses()
        for _, stamp_ns, T in self.service.trajectory():
            poses.add(stamp_ns, T)
        return poses.trajectory()


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
        self,
        robot: Robot,
        settings: EdgeSettings,
        beam_elevations_rad: NDArray[np.float32],
        imu: MotionSource,
        image_node: MakeImageNode | None,
    ) -> None:
        super().__init__(robot, settings, beam_elevations_rad, imu)
        made = self.image_node if image_node is None else image_node(len(beam_elevations_rad), self.columns)
        self.image_node = self._node = _SeeingNode(made)
        self.last: Seen | None = None

    def process(self, packet: ScanPacket) -> EncodedFrame:
        frame = super().process(packet)
        assert self._node.last is not None
        self.last = Seen(packet.scan, self._node.last, frame, self.columns, self.beam_elevations_rad)
        return frame


class _Clock:
    """The recording's."""

    def __init__(self) -> None:
        self.start_ns = self.now_ns = 0

    def following(self, events: Iterable[TimedEvent]) -> Iterator[TimedEvent]:
        for at_ns, event in events:
            self.start_ns = self.start_ns or at_ns
            self.now_ns = max(self.now_ns, at_ns)
            yield at_ns, event


class _Service:
    """An uplink that is the map service itself."""

    anchored, backlog = True, False

    def __init__(
        self,
        edge: _SeeingPipeline,
        wire: Wire,
        limit_kbps: float | None,
        arrives: Callable[[int], bool],
        network: Network | None,
        clock: _Clock,
        out: Outcome,
    ) -> None:
        self._edge, self._wire, self.limit_kbps, self._arrives = edge, wire, limit_kbps, arrives
        self._network, self._clock, self._out = network, clock, out
        self._ready: Answer | None = None  # waits for the next frame
        self._due: list[tuple[int, Answer]] = []

    def send(self, frame: pb.Frame, arrived_s: float | None = None) -> None:
        self._is_ready()
        fixes, _ = messages.fixes_from_wire(list(frame.fixes))
        assert self._edge.last is not None
        mapped = self._out.service.process(self._wire(self._edge.last), fixes)
        self._out.answers.append(mapped)
        if self._arrives(mapped.seq):
            self._ready = answer(messages.odometry(mapped), 0.0)
        if self._network is None:
            self._is_ready()

    def _is_ready(self) -> None:
        if self._ready is not None:
            network, now_ns = self._network, self._clock.now_ns
            self._due.append((0 if network is None else network.due_ns(now_ns, self._clock.start_ns), self._ready))
            self._ready = None

    def take_answers(self) -> list[Answer]:
        here = [reply for due_ns, reply in self._due if due_ns <= self._clock.now_ns]
        self._due = [(due_ns, reply) for due_ns, reply in self._due if due_ns > self._clock.now_ns]
        return here

    def take_want_dense(self) -> bool:
        return False

    def wait_answered(self, seq: int) -> bool:
        return True

    def end(self) -> None:
        """Whatever is on its way arrives."""
        self._is_ready()
        self._clock.now_ns = _FOR_EVER_NS


class _Sink:
    def __init__(self, out: Outcome) -> None:
        self._out = out

    def on_scan_begun(self) -> None: ...

    def on_frame(self, frame: EncodedFrame, T_odom_lidar: Array) -> pb.Frame:
        self._out.scans_odom.add(frame.stamp_ns, T_odom_lidar)
        self._out.scans_map.add(frame.stamp_ns, self._out.node.T_map_odom @ T_odom_lidar)
        return frame_message(frame, codec.CODEC_VERSION)

    def on_answer(self, answer: Answer) -> None: ...

    def on_correction(self, correction: Correction) -> None:
        self._out.corrections.append(correction)

    def on_poses(self, poses: OdomPoses, imu: Imu, state: int) -> None:
        rows = zip(poses.stamps_ns.tolist(), poses.positions_m, poses.quats_xyzw, strict=True)
        for stamp_ns, position_m, quat in rows:
            self._out.imu_map.add(stamp_ns, imu.T_map_odom @ se3.from_quat(position_m, quat))
        self._out.states.append((int(poses.stamps_ns[-1]), state))


class _NoLoops(LoopVerifier):
    def submit(self, job: object) -> None:
        raise AssertionError("loops are off")


def run_both(
    recording: Path,
    robot: Robot | Path,
    *,
    wire: Wire = Seen.decoded,
    harm: Harm = lambda events: events,
    arrives: Callable[[int], bool] = lambda seq: True,
    network: Network | None = None,
    max_scans: int | None = None,
    disable: tuple[str, ...] = (),
    edge_settings: EdgeSettings | None = None,
    odometry: OdometrySettings | None = None,
    max_kbps: float | None = None,
    deskew_again: bool = True,
    image_node: MakeImageNode | None = None,
) -> Outcome:
    """Odometry and GNSS of a recording; loops are off. network: None for lockstep.

    wire: between edge and map. harm: between the recording and the edge. arrives: which answers (by seq) reach the
    robot at all. disable: of gnss, imu, wheels. odometry: the edge's own. max_kbps: the uplink's budget. deskew_again:
    False when the wire carries no times of points. image_node: in place of the settings' own.
    Raises InputError for a recording or robot file that cannot be used.
    """
    robot = load_robot(robot) if isinstance(robot, Path) else robot
    robot = robot.model_copy(update={part: None for part in ("imu", "gnss", "wheels") if part in disable})
    odometry = odometry or OdometrySettings()
    settings, clock, metrics = edge_settings or EdgeSettings(), _Clock(), EdgeMetrics()
    with open_recording(recording, robot, max_scans=max_scans) as read:
        beams = read.beam_elevations_rad
        warm_up(read.robot, settings, ImuSettings(), beams, odometry)
        node, sequencer = make_imu_node(read.robot, ImuSettings()), Sequencer(read.robot)
        edge = _SeeingPipeline(read.robot, settings, beams, node, image_node)
        deskew = edge.image_node.name if deskew_again else "off"
        service = MapPipeline(read.robot, MapSettings(), _NoLoops(), frozenset({*disable, "loops"}), deskew)
        clock_ns = None if network is None else lambda: clock.now_ns
        outages = Outages(odometry, deskew not in ("off", "rotation"), clock_ns)
        out = Outcome(node, service, outages, metrics, read.counts, sequencer)
        metrics.drop_sources += [read.dropped, sequencer.dropped]
        uplink = _Service(edge, wire, max_kbps, arrives, network, clock, out)
        loop = AgentLoop(
            Parts(sequencer, node, edge, uplink, _Sink(out), metrics, outages=outages), lockstep=network is None
        )
        loop.run([event] for event in clock.following(harm(read.events())))
        uplink.end()
        loop.finish()
        service.finish()
        edge.image_node.close()
        out.start_ns = clock.start_ns
        out.recording_s = (read.end_ns - read.start_ns) * 1e-9
        return out
