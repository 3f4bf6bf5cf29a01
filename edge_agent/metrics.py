"""What the edge counts. One recorder feeds /metrics and the report, so the two cannot disagree."""

from __future__ import annotations

from array import array
from collections import Counter as Tally
from typing import TYPE_CHECKING
from wsgiref.simple_server import WSGIServer

import numpy as np
from numpy.typing import NDArray
from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, start_http_server
from prometheus_client.metrics_core import CounterMetricFamily, GaugeMetricFamily
from prometheus_client.registry import Collector

from splitslam.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from edge_agent.odometry.outage import OutageReport

_BUCKETS_S = (0.0005, 0.001, 0.002, 0.004, 0.008, 0.016, 0.032, 0.064, 0.128, 0.256, 0.512, 1.024, 4.096)


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
    """A histogram that also keeps its observations while a report is wanted (`keep`)."""

    def __init__(self, histogram: Histogram, keep: bool) -> None:
        self._histogram, self._keep = histogram, keep
        self.values_s: array[float] = array("d")

    def observe_s(self, seconds: float) -> None:
        self._histogram.observe(seconds)
        if self._keep:
            self.values_s.append(seconds)

    def summary_ms(self) -> dict[str, float] | None:
        return summary(np.asarray(self.values_s) * 1e3)


class _Counts(Collector):
    """splitslam_edge_NAME_total{LABEL}: sums of what others count for themselves, made when they are asked for."""

    def __init__(self, name: str, text: str, label: str) -> None:
        self._name, self._text, self._label = name, text, label
        self.sources: list[Tally[str]] = []

    def sum(self) -> dict[str, int]:
        total: Tally[str] = Tally()
        for source in self.sources:
            total += Tally(source)  # a copy first: another thread goes on counting
        return dict(total)

    def collect(self) -> Iterator[CounterMetricFamily]:
        family = CounterMetricFamily(f"splitslam_edge_{self._name}", self._text, labels=[self._label])
        for key, count in sorted(self.sum().items()):
            family.add_metric([key], count)
        yield family


class _BackEnd(Collector):
    """Which deskew back end is in force, and what it could not do, as its Image node counts it."""

    def __init__(self, name: str, counts: Tally[str]) -> None:
        self._name, self._counts = name, counts

    def collect(self) -> Iterator[CounterMetricFamily | GaugeMetricFamily]:
        back_end = GaugeMetricFamily("splitslam_edge_deskew_back_end", "1 for the one in force", labels=["name"])
        back_end.add_metric([self._name], 1.0)
        yield back_end
        text = "Scans done on the CPU for want of an answer, and points that no deskew can move, by cause"
        troubles = CounterMetricFamily("splitslam_edge_deskew_troubles", text, labels=["cause"])
        for cause, count in sorted(dict(self._counts).items()):
            troubles.add_metric([cause], count)
        yield troubles


class _Outages(Collector):
    """What the edge's own odometry does, as edge_agent.odometry.outage counts it."""

    def __init__(self, report: Callable[[], OutageReport]) -> None:
        self._report = report

    def collect(self) -> Iterator[CounterMetricFamily | GaugeMetricFamily]:
        report = self._report()
        text = "Scans placed by the edge's own odometry, by how that went"
        scans = CounterMetricFamily("splitslam_edge_odometry_scans", text, labels=["result"])
        for result, count in report.scans.items():
            scans.add_metric([result], count)
        yield scans
        yield CounterMetricFamily("splitslam_edge_outages", "Times without answers of the map service", report.count)
        yield CounterMetricFamily("splitslam_edge_outage_seconds", "How long they were", report.seconds)
        text = "1 while the edge goes by its own odometry"
        yield GaugeMetricFamily("splitslam_edge_alone", text, float(report.alone))


class EdgeMetrics:
    """Every metric of the agent, in a registry of its own (several agents may live in one process)."""

    def __init__(self, keep: bool = True) -> None:
        self.registry = CollectorRegistry()
        self._keep = keep
        self._stage_cpu = self._histogram("stage_seconds", "Thread CPU time per scan", ["stage"])
        self._stage_wall = self._histogram("stage_wall_seconds", "Wall time per scan", ["stage"])
        self.stage_cpu: dict[str, Series] = {}
        self.stage_wall: dict[str, Series] = {}
        self.round_trip = Series(self._histogram("round_trip_seconds", "Frame handed over to answer received"), keep)
        self.odometry = Series(self._histogram("odometry_seconds", "Thread CPU time of the edge's odometry"), keep)
        self._uplink = self._counter("uplink_bytes", "Serialized messages sent, by kind", ["kind"])
        self.dropped: Tally[str] = Tally()
        self._drops = self._counts("dropped", "What was dropped, by reason", "reason")
        self.drop_sources = self._drops.sources
        self.drop_sources.append(self.dropped)
        text = "What the disk did not do, what was damaged on it, and frames that the service refused, by kind"
        self.spool_error_sources = self._counts("spool_errors", text, "kind").sources
        text = "Steps of a sensor's clock that did not reach the run, by stream"
        self.clock_step_sources = self._counts("clock_steps", text, "stream").sources
        self.scans = self._counter("scans", "Scans by what became of them", ["result"])
        self.connects = self._counter("connects", "Streams that were answered with a Welcome")
        self.reconnects = self._counter("reconnects", "Streams that broke", ["cause"])
        self.ignored = self._counter("ignored_answers", "Answers not handed on", ["cause"])
        self.state = self._gauge("state", "Tracking state, the numbers of splitslam.v1.TrackingState")
        self.buffer_frames = self._gauge("buffer_frames", "Frames kept until they are durable and answered")
        self.buffer_bytes = self._gauge("buffer_bytes", "Bytes of the kept frames")
        self.spool_frames = self._gauge("spool_frames", "Of the kept frames, those on disk")
        self.spool_bytes = self._gauge("spool_bytes", "Bytes of the spool's files of this run")
        self.limit_kbps = self._gauge("uplink_limit_kbps", "Budget of the uplink; NaN: none")
        self.withheld_points = self._gauge("withheld_points", "Features that the budget left no room for, so far")
        self.limit_kbps.set(float("nan"))
        self.queue_events = self._gauge("queue_events", "Sensor messages read and not yet processed")
        self.feed_readers = self._gauge("feed_readers", "Readers of the local pose feed")
        self.check_problems = self._gauge("check_problems", "What the robot file and the first seconds do not agree on")
        self.check_rotation = self._gauge("check_rotation_degrees", "T_lidar_imu off by, by the motion; NaN: unknown")
        self.check_time_offset = self._gauge("check_time_offset_seconds", "The IMU's stamps likewise; NaN: unknown")
        for gauge in (self.check_rotation, self.check_time_offset):
            gauge.set(float("nan"))
        self._server: WSGIServer | None = None

    def _counts(self, name: str, text: str, label: str) -> _Counts:
        counts = _Counts(name, text, label)
        self.registry.register(counts)
        return counts

    def _histogram(self, name: str, text: str, labels: Sequence[str] = ()) -> Histogram:
        return Histogram(f"splitslam_edge_{name}", text, labels, buckets=_BUCKETS_S, registry=self.registry)

    def _counter(self, name: str, text: str, labels: Sequence[str] = ()) -> Counter:
        return Counter(f"splitslam_edge_{name}", text, labels, registry=self.registry)

    def _gauge(self, name: str, text: str) -> Gauge:
        return Gauge(f"splitslam_edge_{name}", text, registry=self.registry)

    def drop(self, reason: str, count: int = 1) -> None:
        """Counts something that is lost."""
        if count:
            self.dropped[reason] += count

    def all_dropped(self) -> dict[str, int]:
        """Everything lost so far by reason, also by those who count for themselves (`drop_sources`)."""
        return self._drops.sum()

    def sent(self, kind: str, size: int) -> None:
        """Counts one message on the uplink."""
        self._uplink.labels(kind).inc(size)

    def stages(self, cpu_ms: dict[str, float], wall_ms: dict[str, float]) -> None:
        """Records one scan's stages."""
        for times_ms, series, histogram in (
            (cpu_ms, self.stage_cpu, self._stage_cpu),
            (wall_ms, self.stage_wall, self._stage_wall),
        ):
            for stage, milliseconds in times_ms.items():
                if stage not in series:
                    series[stage] = Series(histogram.labels(stage), self._keep)
                series[stage].observe_s(milliseconds * 1e-3)

    def deskew_from(self, back_end: str, counts: Tally[str]) -> None:
        """Shows the deskew back end in force and its Image node's own counts."""
        self.registry.register(_BackEnd(back_end, counts))

    def outages_from(self, report: Callable[[], OutageReport]) -> None:
        """Shows what the edge's own odometry does."""
        self.registry.register(_Outages(report))

    def tcp_bytes_from(self, sent: Callable[[], float], received: Callable[[], float]) -> None:
        """Shows the kernel's byte counts at scrape time."""
        self._gauge("tcp_sent_bytes", "TCP payload sent, framing included").set_function(sent)
        self._gauge("tcp_received_bytes", "TCP payload received, framing included").set_function(received)

    @property
    def port(self) -> int | None:
        """Of /metrics, when it is open."""
        return None if self._server is None else self._server.server_port

    def serve(self, host: str, port: int) -> int:
        """Opens /metrics and returns its port (0: any free one). Raises InputError when it cannot."""
        try:
            self._server, _ = start_http_server(port, host, self.registry)
        except OSError as error:
            raise InputError(f"metrics.port {port}: expected a free port on {host} ({error.strerror})") from None
        return self._server.server_port

    def close(self) -> None:
        if self._server is not None:
            self._server.shutdown()
            self._server.server_close()
