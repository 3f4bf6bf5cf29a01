"""What the edge counts. One recorder feeds /metrics and the report, so the two cannot disagree."""

from __future__ import annotations

import time
from array import array
from collections import Counter as Tally
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray
from prometheus_client import CollectorRegistry, ProcessCollector, generate_latest

from edge_agent import metric_list as m
from splitslam.metrics import Family, Metric, Page, collect, show_build

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from edge_agent.clouds.shelf import CloudShelf
    from edge_agent.odometry.outage import OutageReport
    from edge_agent.sources.live.clock import RunClock
    from edge_agent.sources.live.sensor_clock import SensorClock

NAN = float("nan")
_BYTES_PER_KBIT = 125.0


def summary(values: Sequence[float] | array[float] | NDArray[np.float64]) -> dict[str, float] | None:
    """{mean, std, p50, p99, max} of the values; None without any."""
    if len(values) == 0:
        return None
    data = np.asarray(values, dtype=np.float64)
    p50, p99 = np.percentile(data, [50, 99])
    return {
        "mean": float(data.mean()),
        "std": float(data.std()),
        "p50": float(p50),
        "p99": float(p99),
        "max": float(data.max()),
    }


class Series:
    """One series of a histogram that also keeps its observations while a report is wanted (`keep`)."""

    def __init__(self, family: Family, keep: bool, *labels: str) -> None:
        self._observe, self._keep = family.of(*labels).observe, keep
        self.values_s: array[float] = array("d")

    def observe_s(self, seconds: float) -> None:
        self._observe(seconds)
        if self._keep:
            self.values_s.append(seconds)

    def summary_ms(self) -> dict[str, float] | None:
        return summary(np.asarray(self.values_s) * 1e3)


class Sized(Protocol):
    """Holds so many things, and so many bytes."""

    @property
    def bytes(self) -> int: ...
    def __len__(self) -> int: ...


class Sums:
    """Counts by label that several parts keep for themselves, added up when they are asked for."""

    def __init__(self) -> None:
        self.sources: list[Tally[str]] = []

    def __call__(self) -> dict[str, int]:
        total: dict[str, int] = {}
        for source in self.sources:
            for label, count in dict(source).items():  # a copy: another thread goes on counting
                total[label] = total.get(label, 0) + count
        return {label: count for label, count in total.items() if count}


class EdgeMetrics:
    """Every metric of the agent, in a registry of its own (several agents may live in one process)."""

    def __init__(self, keep: bool = True) -> None:
        self.registry = CollectorRegistry()
        self._keep = keep
        self._stage_cpu, self._stage_wall = self._family(m.STAGE_SECONDS), self._family(m.STAGE_WALL_SECONDS)
        self.stage_cpu: dict[str, Series] = {}
        self.stage_wall: dict[str, Series] = {}
        self.round_trip = Series(self._family(m.ROUND_TRIP_SECONDS), keep)
        self.odometry = Series(self._family(m.ODOMETRY_SECONDS), keep)
        self.scan_age = self._family(m.SCAN_AGE_SECONDS)
        self._point_bytes = self._family(m.POINT_BYTES)
        self._uplink, self._downlink = self._family(m.UPLINK_BYTES), self._family(m.DOWNLINK_BYTES)
        self.dropped: Tally[str] = Tally()
        drops, spool_errors, clock_steps = Sums(), Sums(), Sums()
        self.all_dropped = drops  # everything lost so far by reason, also by those who count for themselves
        self.drop_sources, self.spool_error_sources = drops.sources, spool_errors.sources
        self.clock_step_sources = clock_steps.sources
        self.drop_sources.append(self.dropped)
        for metric, sums in ((m.DROPPED, drops), (m.SPOOL_ERRORS, spool_errors), (m.CLOCK_STEPS, clock_steps)):
            self._collect(metric, sums)
        self.connects, self.reconnects = self._family(m.CONNECTS), self._family(m.RECONNECTS)
        self.ignored = self._family(m.IGNORED)
        self.connected = self._family(m.CONNECTED)
        self.state = self._family(m.STATE)
        self._outbox: Sized | None = None
        self._spool: Sized | None = None
        self._collect(m.BUFFER_FRAMES, lambda: 0 if self._outbox is None else len(self._outbox))
        self._collect(m.BUFFER_BYTES, lambda: 0 if self._outbox is None else self._outbox.bytes)
        self._collect(m.SPOOL_FRAMES, lambda: 0 if self._spool is None else len(self._spool))
        self._collect(m.SPOOL_BYTES, lambda: 0 if self._spool is None else self._spool.bytes)
        self.spool_limit = self._family(m.SPOOL_LIMIT)
        self._limit = self._family(m.LIMIT)
        self.withheld_points = 0
        self._collect(m.WITHHELD, lambda: self.withheld_points)
        self.queue_events = self._family(m.QUEUE_EVENTS)
        self.feed_readers = self._family(m.FEED_READERS)
        self.check_problems = self._family(m.CHECK_PROBLEMS)
        self.check_rotation, self.check_time_offset = self._family(m.CHECK_ROTATION), self._family(m.CHECK_TIME_OFFSET)
        for gauge in (self._limit, self.check_rotation, self.check_time_offset):
            gauge.set(NAN)
        self._heard_s: dict[str, float] = {}
        self._collect(m.SILENT_SECONDS, self._silent_s)
        self._answered_s = NAN
        self._collect(m.ANSWER_AGE, lambda: time.monotonic() - self._answered_s)
        self._live()
        self._tcp: list[tuple[Callable[[], float], Callable[[], float]]] = []
        self._collect(m.TCP_SENT, lambda: sum(sent() for sent, _ in self._tcp))
        self._collect(m.TCP_RECEIVED, lambda: sum(received() for _, received in self._tcp))
        self._dense()
        self._page: Page | None = None
        show_build(self.registry)
        ProcessCollector(registry=self.registry)

    def _family(self, metric: Metric) -> Family:
        return Family(metric, self.registry)

    def _collect(self, metric: Metric, read: Callable) -> None:
        collect(metric, self.registry, read)

    # --- as it happens ----------------------------------------------------------------------------------------

    def drop(self, reason: str, count: int = 1) -> None:
        """Counts something that is lost."""
        if count:
            self.dropped[reason] += count

    def sent(self, kind: str, size: int) -> None:
        """Counts one message on the uplink."""
        self._uplink.inc(kind, by=size)

    def received(self, kind: str, size: int) -> None:
        """Counts one message of the service."""
        self._downlink.inc(kind, by=size)

    def answered(self, round_trip_s: float) -> None:
        """An answer was handed on."""
        self._answered_s = time.monotonic()
        self.round_trip.observe_s(round_trip_s)

    def frame(self, dense: bool, payload_bytes: int, points: int) -> None:
        """A scan was encoded."""
        if points:
            self._point_bytes.observe(payload_bytes / points, "dense" if dense else "sparse")

    def heard(self, streams: Iterable[str]) -> None:
        """Messages of these sensors have come."""
        self._heard_s.update(dict.fromkeys(streams, time.monotonic()))

    def _silent_s(self) -> dict[str, float]:
        now_s = time.monotonic()
        return {stream: now_s - self._heard_s.get(stream, NAN) for stream in m.STREAMS}

    def limit_kbps(self, limit_kbps: float | None) -> None:
        """Notes the uplink's budget."""
        self._limit.set(NAN if limit_kbps is None else limit_kbps * _BYTES_PER_KBIT)

    def stages(self, cpu_ms: dict[str, float], wall_ms: dict[str, float]) -> None:
        """Records one scan's stages."""
        for times_ms, series, family in (
            (cpu_ms, self.stage_cpu, self._stage_cpu),
            (wall_ms, self.stage_wall, self._stage_wall),
        ):
            for stage, milliseconds in times_ms.items():
                if stage not in series:
                    series[stage] = Series(family, self._keep, stage)
                series[stage].observe_s(milliseconds * 1e-3)

    # --- kept by others, read when /metrics is asked ----------------------------------------------------------

    def scans_from(self, scans: Callable[[], Mapping[str, int]], corrections: Callable[[], Mapping[str, int]]) -> None:
        """Shows the run's own tally: scans by result, corrections by cause."""
        self._collect(m.SCANS, scans)
        self._collect(m.CORRECTIONS, corrections)

    def kept_from(self, outbox: Sized, spool: Sized | None) -> None:
        """Shows what the robot still owes the map service, and what of it is on disk."""
        self._outbox, self._spool = outbox, spool

    def deskew_from(self, back_end: str, counts: Tally[str]) -> None:
        """Shows the deskew back end in force and its Image node's own counts."""
        self._collect(m.BACK_END, lambda: {back_end: 1.0})
        self._collect(m.DESKEW_TROUBLES, lambda: dict(counts))

    def imu_from(self, gaps: Callable[[], tuple[int, float]], resets: Callable[[], int], uncovered: Callable) -> None:
        """Shows what the IMU was missed for. gaps: how many, and how long together, s."""
        self._collect(m.IMU_GAPS, lambda: gaps()[0])
        self._collect(m.IMU_GAP_SECONDS, lambda: gaps()[1])
        self._collect(m.IMU_RESETS, resets)
        self._collect(m.UNCOVERED, uncovered)

    def outages_from(self, report: Callable[[], OutageReport]) -> None:
        """Shows what the edge's own odometry does."""
        self._collect(m.ODOMETRY_SCANS, lambda: report().scans)
        self._collect(m.OUTAGES, lambda: report().count)
        self._collect(m.OUTAGE_SECONDS, lambda: report().seconds)
        self._collect(m.ALONE, lambda: float(report().alone))

    def live_from(
        self,
        packets: Callable[[], Mapping[tuple[str, str], float]],
        losses: Callable[[], Mapping[str, int]],
        clocks: RunClock,
    ) -> None:
        """Shows what came of live sensors, and whose time they are in."""
        self._live_packets, self._live_losses, self._live_clocks = packets, losses, clocks

    def _live(self) -> None:
        """Without live sensors all zero."""
        self._live_packets: Callable[[], Mapping[tuple[str, str], float]] = dict
        self._live_losses: Callable[[], Mapping[str, int]] = dict
        self._live_clocks: RunClock | None = None

        def clocks() -> Sequence[SensorClock]:
            return [] if self._live_clocks is None else self._live_clocks.all()

        def behind_s() -> dict[str, float]:
            return {} if self._live_clocks is None else self._live_clocks.behind_s()

        def problems() -> float:
            return 0.0 if self._live_clocks is None else float(len(self._live_clocks.problems))

        self._collect(m.SENSOR_PACKETS, lambda: self._live_packets())
        self._collect(m.SENSOR_LOSSES, lambda: self._live_losses())
        self._collect(m.CLOCK_CHOSEN, lambda: {(c.name, c.chosen): 1.0 for c in clocks() if c.chosen})
        self._collect(m.CLOCK_CHANGES, lambda: {c.name: float(c.changes) for c in clocks()})
        self._collect(m.CLOCK_BEHIND, lambda: dict.fromkeys(m.SENSORS, NAN) | behind_s())
        self._collect(m.CLOCK_PROBLEMS, problems)

    def certificate_from(self, expires_s: Callable[[], float]) -> None:
        """Shows when the agent's certificate or its authority's expires; Unix time."""
        self._collect(m.CERTIFICATE_EXPIRY, expires_s)

    def tcp_bytes_from(self, sent: Callable[[], float], received: Callable[[], float]) -> None:
        """Shows the kernel's byte counts, with those of others that have said theirs."""
        self._tcp.append((sent, received))

    def dense_from(self, shelf: CloudShelf, sent: Callable[[], int]) -> None:
        """Shows the whole scans on the disk, and how many have gone."""
        self._shelf, self._dense_sent = shelf, sent

    def _dense(self) -> None:
        """Where none are kept all zero."""
        self._shelf: CloudShelf | None = None
        self._dense_sent: Callable[[], int] = lambda: 0
        self._collect(m.DENSE_WAITING, lambda: self._shelf.waiting if self._shelf else 0)
        self._collect(m.DENSE_BYTES, lambda: self._shelf.bytes if self._shelf else 0)
        self._collect(m.DENSE_SENT, lambda: self._dense_sent())
        self._collect(m.DENSE_DROPPED, lambda: dict(self._shelf.dropped) if self._shelf else {})

    # --- /metrics ---------------------------------------------------------------------------------------------

    @property
    def port(self) -> int | None:
        """Of /metrics, when it is open."""
        return None if self._page is None else self._page.port

    def page(self) -> str:
        """What /metrics shows now."""
        return generate_latest(self.registry).decode()

    def serve(self, host: str, port: int) -> int:
        """Opens /metrics and returns its port (0: any free one). Raises InputError when it cannot."""
        self._page = Page(self.registry, host, port)
        return self._page.port

    def close(self) -> None:
        if self._page is not None:
            self._page.close()
