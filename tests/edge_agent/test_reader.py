from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import pytest

from edge_agent.metrics import EdgeMetrics
from edge_agent.reader import EventQueue, Reader, TimedEvent
from splitslam.errors import InputError
from splitslam.scan import Scan
from splitslam.stack.process import wait_until
from tests.edge_agent.test_loop import SCAN_NS, imu_at, scan


def events(count: int, imu_per_scan: int = 10, step_ns: int = 10_000_000) -> Iterator[TimedEvent]:
    stamp_ns = 0
    for k in range(count):
        for _ in range(imu_per_scan):
            yield stamp_ns, imu_at(stamp_ns)
            stamp_ns += step_ns
        yield stamp_ns, scan(k)


def flat(batches: list[list[TimedEvent]]) -> list[TimedEvent]:
    return [event for batch in batches for event in batch]


def scans_in(events: list[TimedEvent]) -> int:
    return sum(isinstance(event, Scan) for _, event in events)


def test_in_lockstep_nothing_is_lost_and_batches_end_at_scans():
    queue = EventQueue(2, may_drop=False, metrics=EdgeMetrics())
    reader = Reader(events(20), queue, realtime=False)
    reader.start()
    batches = []
    for batch in queue.batches():
        time.sleep(0.002)
        batches.append(batch)
    assert len(flat(batches)) == 20 * 11
    assert all(isinstance(batch[-1][1], Scan) for batch in batches if batch)
    assert reader.cpu_s > 0.0


def test_in_lockstep_no_more_scans_wait_than_the_queue_holds():
    queue = EventQueue(2, may_drop=False, metrics=EdgeMetrics())
    read: list[TimedEvent] = []

    def watched() -> Iterator[TimedEvent]:
        for event in events(20):
            read.append(event)
            yield event

    reader = Reader(watched(), queue, realtime=False)
    reader.start()
    wait_until(lambda: scans_in(read) >= 3, 10.0, "as many scans as fit")
    time.sleep(0.1)
    assert scans_in(read) == 3
    reader.stop()
    reader.join(10.0)
    assert not reader.is_alive()


def test_by_the_clock_events_come_no_sooner_than_in_the_recording():
    queue = EventQueue(50, may_drop=True, metrics=EdgeMetrics())
    started_s = time.monotonic()
    Reader(events(5), queue, realtime=True).start()
    late_s = []
    for batch in queue.batches():
        late_s += [time.monotonic() - started_s - arrival_ns * 1e-9 for arrival_ns, _ in batch]
    assert min(late_s) > -0.005
    assert len(late_s) == 55
    assert time.monotonic() - started_s >= 0.5


def test_by_the_clock_a_full_queue_drops_the_oldest_scan_and_counts_it_but_keeps_every_sample():
    metrics = EdgeMetrics()
    queue = EventQueue(2, may_drop=True, metrics=metrics)
    reader = Reader(events(10, step_ns=100_000), queue, realtime=True)
    reader.start()
    reader.join(30.0)
    left = flat(list(queue.batches()))
    assert metrics.dropped == {"queue_full": 8}
    assert [data.stamp_ns for _, data in left if isinstance(data, Scan)] == [scan(8).stamp_ns, scan(9).stamp_ns]
    assert sum(not isinstance(data, Scan) for _, data in left) == 100


def test_an_agent_that_starts_late_has_missed_what_was_due_before_and_goes_on_with_what_comes():
    queue = EventQueue(50, may_drop=True, metrics=EdgeMetrics())
    began_s, all_of_them = time.monotonic() - 0.25, list(events(10))
    reader = Reader(all_of_them, queue, realtime=True, began_s=began_s)
    reader.start()
    left = flat(list(queue.batches()))
    late_s = reader._start_s - began_s  # 0.25, and what a busy machine adds
    assert late_s - 0.01 <= left[0][0] * 1e-9 <= late_s + 0.15
    assert left == all_of_them[-len(left) :]
    assert reader.passed_scans == scans_in(all_of_them[: -len(left)]) >= 2
    assert time.monotonic() - began_s >= 1.0


def test_agents_with_the_same_beginning_see_an_event_at_the_same_time():
    began_s = time.monotonic() + 0.3
    queue = EventQueue(50, may_drop=True, metrics=EdgeMetrics())
    Reader(events(2), queue, realtime=True, began_s=began_s).start()
    next(queue.batches())
    assert time.monotonic() >= began_s


def test_an_agent_that_goes_on_with_a_run_keeps_the_clock_of_the_recordings_first_message():
    queue, later = EventQueue(50, may_drop=True, metrics=EdgeMetrics()), list(events(5))[-2:]
    began_s = time.monotonic()
    reader = Reader(iter(later), queue, realtime=True, began_s=began_s, first_ns=lambda: next(events(5))[0])
    reader.start()
    flat(list(queue.batches()))
    assert reader.passed_scans == 0
    assert time.monotonic() - began_s >= (later[-1][0] - next(events(5))[0]) * 1e-9 - 0.01


def test_an_error_while_reading_comes_out_of_the_loop_after_what_was_read():
    def broken() -> Iterator[TimedEvent]:
        yield from events(3)
        raise InputError("x.bag: truncated")

    queue = EventQueue(50, may_drop=False, metrics=EdgeMetrics())
    Reader(broken(), queue, realtime=False).start()
    seen: list[TimedEvent] = []

    def loop() -> None:
        for batch in queue.batches():
            seen.extend(batch)

    with pytest.raises(InputError, match="truncated"):
        loop()
    assert len(seen) == 33


def test_stop_ends_the_loop_and_the_reader_at_once():
    queue = EventQueue(2, may_drop=True, metrics=EdgeMetrics())
    reader = Reader(events(1000), queue, realtime=True)
    reader.start()
    threading.Timer(0.1, reader.stop).start()
    started_s = time.monotonic()
    assert len(list(queue.batches())) < 5000
    reader.join(30.0)
    assert time.monotonic() - started_s < 30.0  # of the 100 s that it lasts


def test_of_a_live_source_what_has_come_is_handed_on_at_once_and_while_nothing_comes_the_loop_is_woken():
    queue = EventQueue(2, may_drop=True, metrics=EdgeMetrics())
    now_ns = time.monotonic_ns()

    def live() -> Iterator[TimedEvent | None]:
        yield now_ns + 7, imu_at(1)
        yield now_ns + 8, imu_at(2)
        yield None
        while True:
            time.sleep(0.02)
            yield None

    reader = Reader(live(), queue, realtime=True, live_offset_ns=7)
    reader.start()
    batches = queue.batches()
    assert [arrival_ns for arrival_ns, _ in next(batches)] == [now_ns + 7, now_ns + 8]
    assert next(batches) == []
    assert reader.due_s(now_ns + 7) == pytest.approx(now_ns * 1e-9, abs=1e-6)
    started_s = time.monotonic()
    reader.close()
    assert time.monotonic() - started_s < 30.0  # it would go on for ever


def live_scans(kept: int, then: int) -> Iterator[TimedEvent | None]:
    """Scans that have come during the last seconds, ten a second, and others that come as fast as they are taken."""
    now_ns = time.monotonic_ns()
    for k in range(kept):
        yield now_ns - (kept - k) * 100_000_000, scan(k)
    yield None
    for k in range(kept, kept + then):
        yield time.monotonic_ns(), scan(k)
    yield None


def test_what_came_while_the_agent_started_is_caught_up_with_and_not_dropped():
    metrics = EdgeMetrics()
    queue = EventQueue(5, may_drop=True, metrics=metrics)
    Reader(live_scans(40, 0), queue, realtime=True, live_offset_ns=0).start()
    numbers = []
    for batch in queue.batches():
        time.sleep(0.002)
        numbers += [event.stamp_ns // SCAN_NS for _, event in batch if isinstance(event, Scan)]
    assert numbers == list(range(40))
    assert metrics.dropped == {}


def test_once_it_has_caught_up_the_newest_scans_count():
    metrics = EdgeMetrics()
    queue = EventQueue(5, may_drop=True, metrics=metrics)
    reader = Reader(live_scans(10, 100), queue, realtime=True, live_offset_ns=0)
    reader.start()
    taken = 0
    for batch in queue.batches():
        if taken == 11:  # one that has just come, and nothing waits: caught up
            reader.join(10.0)
        taken += sum(isinstance(event, Scan) for _, event in batch)
    assert metrics.dropped["queue_full"] >= 80
    assert taken + metrics.dropped["queue_full"] == 110
