"""Who sees which answer when: the loop with parts that only write down what happens."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pytest

from edge_agent.dense import DensePolicy
from edge_agent.loop import UNANCHORED, AgentLoop, Parts
from edge_agent.metrics import EdgeMetrics
from edge_agent.rate import RateControl, RateSettings
from edge_agent.reader import TimedEvent
from edge_agent.settings import DenseSettings
from edge_agent.sources import Event
from edge_agent.types import EncodedFrame, OdometryReply, OdomPoses
from edge_agent.wire import Answer
from splitslam.errors import DataError
from splitslam.scan import ImuSamples, Scan, ScanPacket, WheelSamples
from splitslam.wire import session_pb2 as pb

SCAN_NS = 100_000_000


def scan(k: int) -> Scan:
    empty = np.empty(0, np.uint8)
    return Scan(k * SCAN_NS, (k + 1) * SCAN_NS - 1, np.zeros((0, 3), np.float32), np.empty(0, np.int32), empty, empty)


def imu_at(stamp_ns: int) -> ImuSamples:
    return ImuSamples(np.array([stamp_ns]), np.zeros((1, 3)), np.zeros((1, 3)))


class Log(list[str]):
    """What the parts were asked, in order."""


class PassThrough:
    def push(self, event: Event, arrival_ns: int | None = None) -> list[ImuSamples | ScanPacket]:
        return [ScanPacket(event)] if isinstance(event, Scan) else [event]  # type: ignore[list-item]

    def push_imu(self, samples: ImuSamples, arrivals_ns: Sequence[int]) -> list[ImuSamples | ScanPacket]:
        return [samples]

    def finish(self) -> list[ImuSamples | ScanPacket]:
        return []


class FakeImu:
    def __init__(self, log: Log) -> None:
        self.log, self.T_map_odom, self.covariance, self.state = log, np.eye(4), np.eye(6), 2

    def add_imu(self, samples: ImuSamples, later: bool = False) -> OdomPoses:
        self.log.append(f"imu {len(samples)}" + " later" * later)
        count = 0 if later else len(samples)
        return OdomPoses(
            samples.stamps_ns[:count], np.zeros((count, 3)), np.tile([0, 0, 0, 1.0], (count, 1)), np.zeros((count, 3))
        )

    def add_wheels(self, samples: WheelSamples) -> None:
        self.log.append(f"wheels {len(samples)}")

    def T_odom_lidar_at(self, stamp_ns: int) -> np.ndarray:
        return np.eye(4)

    def on_odometry(self, reply: OdometryReply) -> None:
        self.log.append(f"answer {reply.seq}")


class FakePipeline:
    def __init__(self, log: Log, bad_stamps_ns: set[int]) -> None:
        self.log, self.bad, self.seq = log, bad_stamps_ns, 0
        self.dense, self.rate = DensePolicy(DenseSettings()), RateControl(RateSettings())

    def process(self, packet: ScanPacket) -> EncodedFrame:
        if packet.scan.stamp_ns in self.bad:
            raise DataError("few_points")
        self.seq += 1
        self.log.append(f"scan {self.seq}")
        return EncodedFrame(self.seq, packet.scan.stamp_ns, False, b"x", (), {"total": 1.0}, {"total": 1.0})


class FakeUplink:
    """Answers every frame at once, unless told to wait for the next but one."""

    def __init__(self, log: Log) -> None:
        self.log, self.ready, self.anchored, self.stop_at = log, [], True, 10**9
        self.limit_kbps, self.backlog = 70.0, True

    def send(self, frame: pb.Frame, arrived_s: float | None = None) -> None:
        pose = np.eye(4)
        reply = OdometryReply(frame.seq, frame.stamp_ns, pose, pose, np.eye(6), 2, np.zeros((0, 6)))
        self.ready.append(Answer(reply, False, None, 0.01))

    def take_answers(self) -> list[Answer]:
        taken, self.ready = self.ready[::-1], []  # any order
        return taken

    def take_want_dense(self) -> bool:
        return True

    def wait_answered(self, seq: int) -> bool:
        return seq < self.stop_at


class FakeSink:
    def __init__(self) -> None:
        self.states: list[int] = []
        self.answered: list[int] = []

    def on_scan_begun(self) -> None: ...
    def on_frame(self, frame: EncodedFrame, T_odom_lidar: np.ndarray) -> pb.Frame:
        return pb.Frame(seq=frame.seq, stamp_ns=frame.stamp_ns)

    def on_answer(self, answer: Answer) -> None:
        self.answered.append(answer.reply.seq)

    def on_poses(self, poses: OdomPoses, imu: FakeImu, state: int) -> None:
        self.states.append(state)


def parts(bad_stamps_ns: set[int] | None = None) -> tuple[Parts, Log]:
    log = Log()
    imu, uplink, pipeline = FakeImu(log), FakeUplink(log), FakePipeline(log, bad_stamps_ns or set())
    return Parts(PassThrough(), imu, pipeline, uplink, FakeSink(), EdgeMetrics()), log  # type: ignore[arg-type]


def batches(scans: int) -> Iterator[list[TimedEvent]]:
    for k in range(1, scans + 1):
        samples: list[TimedEvent] = [(0, imu_at(k * SCAN_NS + i)) for i in range(3)]
        yield [*samples, (0, scan(k))]


def test_in_lockstep_scan_k_sees_exactly_the_answers_up_to_k_minus_two():
    p, log = parts()
    loop = AgentLoop(p, lockstep=True)
    loop.run(batches(4))
    assert loop.finish()
    assert log == [
        "imu 3", "scan 1", "imu 3", "scan 2", "imu 3", "answer 1", "scan 3", "imu 3", "answer 2", "scan 4",
        "answer 3", "answer 4",
    ]  # fmt: skip


def test_by_the_clock_an_answer_is_applied_as_soon_as_it_is_there():
    p, log = parts()
    AgentLoop(p, lockstep=False).run(batches(2))
    assert log == ["imu 3", "scan 1", "answer 1", "imu 3", "scan 2"]


@pytest.mark.parametrize("lockstep", [True, False])
def test_the_uplink_s_limit_reaches_the_rate_control_and_a_backlog_only_by_the_clock(lockstep: bool):
    p, _ = parts()
    AgentLoop(p, lockstep).run(batches(1))
    assert (p.pipeline.rate.limit_kbps, p.pipeline.rate.backlog) == (70.0, not lockstep)


def test_poses_of_the_samples_that_end_a_scan_come_with_those_after_it_once_those_of_its_start_are_there():
    made, log = parts()
    made.sequencer.push_imu = lambda samples, arrivals_ns: [  # type: ignore[method-assign]
        imu_at(3 * SCAN_NS),
        ScanPacket(scan(2)),
        imu_at(3 * SCAN_NS + 1),
        ScanPacket(scan(3)),
    ]
    loop = AgentLoop(made, lockstep=False)
    for _ in range(2):
        loop._take_batch([(0, imu_at(0))])
    calls = [line for line in log if line.startswith(("imu", "scan"))]
    assert calls[:4] == ["imu 1", "scan 1", "imu 1", "scan 2"], "none is there yet; none comes after it"
    assert calls[4:] == ["imu 1 later", "scan 3", "imu 1", "scan 4"]


@pytest.mark.parametrize("lockstep", [True, False])
def test_a_wish_for_a_dense_frame_is_met_only_by_the_clock(lockstep: bool):
    p, _ = parts()
    AgentLoop(p, lockstep).run(batches(1))
    assert p.pipeline.dense.wanted is not lockstep


def test_a_bad_scan_is_dropped_and_counted_and_uses_no_seq():
    p, log = parts(bad_stamps_ns={2 * SCAN_NS})
    loop = AgentLoop(p, lockstep=True)
    loop.run(batches(3))
    loop.finish()
    assert [line for line in log if line.startswith("scan")] == ["scan 1", "scan 2"]
    assert p.metrics.dropped == {"few_points": 1}


def test_a_programmer_s_error_is_not_swallowed():
    p, _ = parts()
    p.pipeline.process = lambda packet: 1 / 0  # type: ignore[assignment,method-assign]
    with pytest.raises(ZeroDivisionError):
        AgentLoop(p, lockstep=True).run(batches(1))


def test_when_the_uplink_is_stopped_the_loop_ends_without_processing_more():
    p, log = parts()
    p.uplink.stop_at = 1  # type: ignore[attr-defined]
    loop = AgentLoop(p, lockstep=True)
    loop.run(batches(9))
    assert loop.stopped
    assert "scan 3" not in log


def test_answers_to_frames_of_an_agent_before_do_not_reach_the_imu_node():
    p, log = parts()
    p.pipeline.seq = 3
    p.uplink.send(pb.Frame(seq=2))
    p.uplink.send(pb.Frame(seq=3))
    loop = AgentLoop(p, lockstep=True, first_seq=4)
    loop.run(batches(1))
    loop.finish()
    assert [line for line in log if line.startswith("answer")] == ["answer 4"]
    assert p.sink.answered == [2, 3, 4]  # type: ignore[attr-defined]


def test_while_the_service_does_not_follow_the_state_is_unanchored():
    p, _ = parts()
    loop = AgentLoop(p, lockstep=False)
    loop.run(batches(1))
    p.uplink.anchored = False  # type: ignore[misc]
    loop.run(batches(1))
    assert p.sink.states == [2, UNANCHORED]  # type: ignore[attr-defined]


@pytest.mark.parametrize("lockstep", [True, False])
def test_while_the_lidar_is_unplugged_the_state_is_unanchored(lockstep: bool):
    p, _ = parts()
    loop = AgentLoop(p, lockstep)
    loop.run(batches(5))
    loop.run([[(0, imu_at(5 * SCAN_NS + 10**9))]])
    loop.run([[(0, imu_at(5 * SCAN_NS + 2 * 10**9))]])
    loop.run([[(0, scan(30)), (0, imu_at(31 * SCAN_NS))], [(0, scan(31))], [(0, scan(32)), (0, imu_at(33 * SCAN_NS))]])
    assert p.sink.states == [*[2] * 6, UNANCHORED, UNANCHORED, 2]  # type: ignore[attr-defined]
