"""What counting costs, in CPU time of the thread that counts; `python -m tests.metrics.test_cost` prints it."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from edge_agent.metric_list import STAGES
from edge_agent.metrics import EdgeMetrics
from map_service.channel import Beat, pack, unpack
from map_service.config import ServiceConfig
from map_service.metrics import ServiceMetrics
from map_service.tally import Tally
from map_service.types import Effort, MapAnswer, State
from tests import tolerances

_SCANS, _ROUNDS = 500, 7
_TIMES_MS = {stage: 1.0 + k for k, stage in enumerate(STAGES)}


def cpu_s_a_scan(scan: Callable[[], object]) -> float:
    """Thread CPU time of one call; the least of some rounds, as others have the machine too."""
    rounds = []
    for _ in range(_ROUNDS):
        start_ns = time.thread_time_ns()
        for _ in range(_SCANS):
            scan()
        rounds.append((time.thread_time_ns() - start_ns) * 1e-9 / _SCANS)
    return min(rounds)


def on_the_edge() -> Callable[[], None]:
    """All that EdgeMetrics is told for one scan, its answer and a credit."""
    metrics = EdgeMetrics(keep=False)
    batch = ["imu"] * 50 + ["lidar"]

    def scan() -> None:
        metrics.queue_events.set(51)
        metrics.heard(set(batch))
        metrics.limit_kbps(250.0)
        metrics.stages(_TIMES_MS, _TIMES_MS)
        metrics.frame(False, 1300, 1000)
        metrics.scan_age.observe(0.07)
        metrics.sent("frame", 1350)
        for kind in ("odometry", "credit"):
            metrics.received(kind, 400)
        metrics.answered(0.03)
        metrics.state.set(2)

    return scan


def in_the_worker() -> tuple[Callable[[], None], Tally]:
    """All that a worker's thread counts for one mapped frame."""
    tally, none = Tally(), np.zeros((0, 6))
    effort = Effort(0.004, True, 5, 900, 1000)
    poses = np.eye(4), np.eye(4), np.eye(6)
    answer = MapAnswer(1, 1, *poses, State.TRACKING, none, None, False, 4.0, effort)
    return lambda: tally.mapped(answer), tally


def in_the_front() -> Callable[[], None]:
    """What a worker has counted for ten frames, taken over with its beat, and the answers' times: a tenth of it."""
    metrics = ServiceMetrics(ServiceConfig(workers=1))
    mapped, tally = in_the_worker()
    for _ in range(10):
        mapped()
    counts, observations = tally.take()
    body = pack(Beat(counts, observations, 0.0, {1: 10}, {"tracking": 1}))[4:]
    frames = iter(range(10**9))

    def scan() -> None:
        metrics.answer_seconds.observe(0.01)
        metrics.received_bytes.inc(by=1350)
        metrics.sent_bytes.inc(by=400)
        if next(frames) % 10 == 0:
            metrics.absorb(0, unpack(body), 1, 0.01)

    return scan


def test_counting_is_nothing_beside_a_scans_own_milliseconds() -> None:
    for scan in (on_the_edge(), in_the_worker()[0], in_the_front()):
        assert cpu_s_a_scan(scan) < tolerances.METRICS_CPU_S


if __name__ == "__main__":
    for name, scan in (("edge", on_the_edge()), ("worker", in_the_worker()[0]), ("front", in_the_front())):
        print(f"{name}: {cpu_s_a_scan(scan) * 1e6:.1f} us a scan")
