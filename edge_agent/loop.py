"""The agent's one working thread: sensor events in, frames out, answers back to the Imu node.

Lockstep: scan k is processed after exactly the answers to scans <= k - 2, so that a run can be repeated to the byte.
By the clock: answers are applied as they come and nobody waits.
"""

from __future__ import annotations

import itertools
import logging
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from edge_agent.dense import DensePolicy
from edge_agent.metrics import EdgeMetrics
from edge_agent.odometry.outage import Correction, Outages
from edge_agent.pulse import Pulse
from edge_agent.rate import RateControl
from edge_agent.reader import TimedEvent
from edge_agent.sources import Event
from edge_agent.stage_clock import StageClock
from edge_agent.types import EncodedFrame, OdometryReply, OdomPoses
from edge_agent.wire import Answer
from splitslam.errors import DataError
from splitslam.logs import fields
from splitslam.scan import GnssFix, ImuSamples, Scan, ScanPacket, WheelSamples
from splitslam.wire import session_pb2 as pb

_log = logging.getLogger(__name__)
UNANCHORED = 4
Item = ImuSamples | WheelSamples | ScanPacket
_SILENT_NS = 1_500_000_000  # without an answered scan, as when the LiDAR is unplugged, the pose is the edge's own
_STREAMS = {Scan: "lidar", ImuSamples: "imu", WheelSamples: "wheels", GnssFix: "gnss"}
_LAG = 2  # scan k sees the odometry of scans <= k - 2


class Pipeline(Protocol):
    """edge_agent.pipeline.EdgePipeline."""

    seq: int
    dense: DensePolicy
    rate: RateControl

    def process(self, packet: ScanPacket) -> EncodedFrame: ...


class Imu(Protocol):
    """edge_agent.imu.node.ImuNode."""

    T_map_odom: NDArray[np.float64]
    covariance: NDArray[np.float64]
    state: int

    @property
    def velocity_covariance(self) -> NDArray[np.float64]: ...

    def add_imu(self, samples: ImuSamples, later: bool = False) -> OdomPoses: ...
    def add_wheels(self, samples: WheelSamples) -> None: ...
    def T_odom_lidar_at(self, stamp_ns: int) -> NDArray[np.float64]: ...
    def on_odometry(self, reply: OdometryReply) -> None: ...


class Sequencer(Protocol):
    """edge_agent.sources.sequencer.Sequencer."""

    def push(self, event: Event, arrival_ns: int | None = None) -> Sequence[Item]: ...
    def push_imu(self, samples: ImuSamples, arrivals_ns: Sequence[int]) -> Sequence[Item]: ...
    def finish(self) -> Sequence[Item]: ...


class Uplink(Protocol):
    """edge_agent.uplink.Uplink, what the loop uses of it."""

    @property
    def anchored(self) -> bool: ...
    @property
    def limit_kbps(self) -> float | None: ...
    @property
    def backlog(self) -> bool: ...
    def send(self, frame: pb.Frame, arrived_s: float | None = None) -> None: ...
    def take_answers(self) -> list[Answer]: ...
    def take_want_dense(self) -> bool: ...
    def wait_answered(self, seq: int) -> bool: ...


class Sink(Protocol):
    """Where results go: edge_agent.sink.AgentSink."""

    def on_scan_begun(self) -> None: ...
    def on_frame(self, frame: EncodedFrame, T_odom_lidar: NDArray[np.float64]) -> pb.Frame: ...
    def on_answer(self, answer: Answer) -> None: ...
    def on_correction(self, correction: Correction) -> None: ...
    def on_poses(self, poses: OdomPoses, imu: Imu, state: int) -> None: ...


class Check(Protocol):
    """edge_agent.check.LiveCheck."""

    def on_event(self, event: Event) -> None: ...
    def on_answer(self, answer: Answer) -> None: ...


@dataclass(frozen=True, slots=True)
class Parts:
    """What the loop drives. check: looks on. outages: None: without answers there is only the Imu node.

    pulse: of the thread that runs the loop.
    """

    sequencer: Sequencer
    imu: Imu
    pipeline: Pipeline
    uplink: Uplink
    sink: Sink
    metrics: EdgeMetrics
    check: Check | None = None
    outages: Outages | None = None
    pulse: Pulse = field(default_factory=lambda: Pulse("pipeline"))


class AgentLoop:
    """Runs one recording or one live run; single-threaded. first_seq: frames before it are those of another agent.

    came_s: an arrival time as the source says it, ns, to the system's monotonic clock, s; None in lockstep.
    """

    def __init__(
        self, parts: Parts, lockstep: bool, first_seq: int = 1, came_s: Callable[[int], float] | None = None
    ) -> None:
        self._parts, self._lockstep, self._first_seq, self._came_s = parts, lockstep, first_seq, came_s
        self._held_back: list[Answer] = []
        self._answered_ns: int | None = None
        self._now_ns = 0  # of the newest scan or IMU-rate pose
        self._given_ns = 0  # of the newest IMU-rate pose
        self.stopped = False
        self.pulse = parts.pulse

    def run(self, batches: Iterable[list[TimedEvent]]) -> None:
        """Until the batches end or the uplink is stopped. Then every frame is answered, unless stopped."""
        parts = self._parts
        for batch in batches:
            with parts.pulse.working():
                self._take_batch(batch)
            if self.stopped:
                return

    def _take_batch(self, batch: list[TimedEvent]) -> None:
        parts = self._parts
        if not self._lockstep:
            self._apply_answers(None)
        items: list[Item] = []
        heard: set[str] = set()
        for kind, run in itertools.groupby(batch, lambda timed: type(timed[1])):
            heard.add(_STREAMS[kind])
            if kind is ImuSamples:  # many, and one call costs far more than one sample
                samples, arrivals_ns = _together(run)
                self._show(samples)
                items += parts.sequencer.push_imu(samples, arrivals_ns)
                continue
            for arrival_ns, event in run:
                self._show(event)
                items += parts.sequencer.push(event, arrival_ns)
        parts.metrics.heard(heard)
        self._take(items)

    def _show(self, event: Event) -> None:
        if self._parts.check is not None:
            self._parts.check.on_event(event)

    def finish(self) -> bool:
        """End of input: the last scan, then all answers. False when the uplink was stopped meanwhile."""
        parts = self._parts
        with parts.pulse.working():
            self._take(list(parts.sequencer.finish()))
        if self.stopped or not parts.uplink.wait_answered(parts.pipeline.seq):
            return False
        self._apply_answers(None)
        return True

    def _take(self, items: list[Item]) -> None:
        """Neighbouring samples go to the Imu node together: one call costs far more than one sample.

        The poses of the few samples that end a scan may come with those after it: it needs those of its start alone.
        Not where several scans have waited for these samples.
        """
        samples: list[ImuSamples] = []
        for k, item in enumerate(items):
            if isinstance(item, ImuSamples):
                samples.append(item)
                continue
            if isinstance(item, WheelSamples):
                self._parts.imu.add_wheels(item)
                continue
            samples_next = isinstance(items[k + 1], ImuSamples) if k + 1 < len(items) else False
            self._take_samples(samples, later=samples_next and item.scan.stamp_ns <= self._given_ns)
            samples = []
            self._take_packet(item)
            if self.stopped:
                return
        self._take_samples(samples)

    def _take_samples(self, samples: list[ImuSamples], later: bool = False) -> None:
        if not samples:
            return
        imu = self._parts.imu
        poses = imu.add_imu(ImuSamples.joined(samples), later)
        if len(poses.stamps_ns):
            self._given_ns = int(poses.stamps_ns[-1])
            self._now_ns = max(self._now_ns, self._given_ns)
            self._parts.sink.on_poses(poses, imu, self.state)

    def _take_packet(self, packet: ScanPacket) -> None:
        parts = self._parts
        self._now_ns = max(self._now_ns, packet.scan.stamp_ns)
        if self._lockstep:
            seen_seq = parts.pipeline.seq + 1 - _LAG
            with parts.pulse.waiting():
                answered = parts.uplink.wait_answered(seen_seq)
            if not answered:
                self.stopped = True
                return
            self._apply_answers(seen_seq)
        else:
            self._apply_answers(None)
            # not in lockstep: when a wish arrives depends on the clock
            parts.pipeline.dense.wanted |= parts.uplink.take_want_dense()
            parts.pipeline.rate.backlog = parts.uplink.backlog
        limit_kbps = parts.pipeline.rate.limit_kbps = parts.uplink.limit_kbps
        parts.metrics.limit_kbps(limit_kbps)
        parts.metrics.withheld_points = parts.pipeline.rate.withheld_points
        parts.sink.on_scan_begun()
        try:
            frame = parts.pipeline.process(packet)
        except DataError as error:
            parts.metrics.drop(error.reason)
            said = fields(stamp_ns=packet.scan.stamp_ns, reason=error.reason, detail=error.detail)
            _log.log(logging.DEBUG if error.reason == "budget" else logging.WARNING, "scan dropped", extra=said)
            return
        parts.metrics.stages(frame.stage_cpu_ms, frame.stage_wall_ms)
        parts.metrics.frame(frame.dense, len(frame.payload), frame.corners + frame.surfs)
        message = parts.sink.on_frame(frame, parts.imu.T_odom_lidar_at(frame.stamp_ns))
        parts.uplink.send(message, self._arrived_s(packet))
        self._place(frame)

    def _arrived_s(self, packet: ScanPacket) -> float | None:
        """When the scan came, on the system's monotonic clock; None in lockstep, where nothing comes by the clock."""
        if self._came_s is None or packet.arrival_ns is None:
            return None
        return self._came_s(packet.arrival_ns)

    def _place(self, frame: EncodedFrame) -> None:
        """While no answers come, the edge's own odometry takes the service's place."""
        outages = self._parts.outages
        if outages is None or frame.features is None:
            return
        clock = StageClock()
        replies = outages.on_frame(frame.features)
        if not replies:
            return
        clock.lap("odometry")
        self._parts.metrics.odometry.observe_s(clock.cpu_ms["odometry"] * 1e-3)
        for reply in replies:
            self._parts.imu.on_odometry(reply)
        self._parts.metrics.state.set(self.state)

    def _apply_answers(self, up_to_seq: int | None) -> None:
        """Hands answers to the Imu node in seq order; later ones than `up_to_seq` are held back."""
        parts = self._parts
        self._held_back += parts.uplink.take_answers()
        self._held_back.sort(key=lambda answer: answer.reply.seq)
        while self._held_back and (up_to_seq is None or self._held_back[0].reply.seq <= up_to_seq):
            answer = self._held_back.pop(0)
            parts.metrics.answered(answer.round_trip_s)
            if answer.reply.rejected:
                parts.metrics.drop(f"rejected_{answer.reply.rejected}")
            own = answer.reply.seq >= self._first_seq
            if own:  # the node has not seen the scans of an agent before
                told = self._in_one_frame(answer.reply)
                if told is not None:
                    parts.imu.on_odometry(told)
                self._answered_ns = answer.reply.stamp_ns
            parts.sink.on_answer(answer)
            if own and parts.check is not None:
                parts.check.on_answer(answer)
        parts.metrics.state.set(self.state)

    def _in_one_frame(self, reply: OdometryReply) -> OdometryReply | None:
        """After an outage `odom` goes on from where the robot was: the difference is `map`'s. None: see Outages."""
        if self._parts.outages is None:
            return reply
        steady, correction = self._parts.outages.on_answer(reply)
        if correction is not None:
            self._parts.sink.on_correction(correction)
        return steady

    @property
    def state(self) -> int:
        """The number of a splitslam.v1.TrackingState."""
        silent = self._answered_ns is not None and self._now_ns - self._answered_ns > _SILENT_NS
        connected = self._lockstep or self._parts.uplink.anchored
        return self._parts.imu.state if connected and not silent else UNANCHORED


def _together(run: Iterable[TimedEvent]) -> tuple[ImuSamples, list[int]]:
    """Messages of the IMU as one, and when each of its samples came."""
    arrived, messages = zip(*run, strict=True)
    samples = ImuSamples.joined(messages)
    if len(samples) == len(messages):  # as most drivers have it
        return samples, list(arrived)
    counts = [len(message) for message in messages]
    return samples, [ns for ns, count in zip(arrived, counts, strict=True) for _ in range(count)]
