"""Prometheus metrics of the service: kept by the front, fed by its own events and by the workers' beats."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from prometheus_client import CollectorRegistry, ProcessCollector

from map_service import metric_list as m
from map_service.channel import Beat
from map_service.config import ServiceConfig
from map_service.robot_gauges import RobotGauges
from splitslam.metrics import OTHER, Family, Metric, Page, collect, show_build


class ServiceMetrics:
    """One registry. Label sets are bounded: nothing a robot says becomes a label, but in `robots`, switched on."""

    def __init__(self, config: ServiceConfig) -> None:
        self.registry = CollectorRegistry()
        self._workers = [str(index) for index in range(config.worker_count)]
        self.sites = {*config.quota.sites, *config.retention.sites}  # those that have series of their own
        self.answer_seconds, self.commit_seconds = self._family(m.ANSWER_SECONDS), self._family(m.COMMIT_SECONDS)
        self.sessions, self.streams = self._family(m.SESSIONS), self._family(m.STREAMS)
        self.stream_ends = self._family(m.STREAM_ENDS)
        self.received_bytes, self.sent_bytes = self._family(m.RECEIVED_BYTES), self._family(m.SENT_BYTES)
        self._family(m.SESSION_LIMIT).set(config.session_limit)
        self.restarts, self.workers_ready = self._family(m.WORKER_RESTARTS), self._family(m.WORKERS_READY)
        self._queue_frames, self._queue_messages = self._family(m.QUEUE_FRAMES), self._family(m.QUEUE_MESSAGES)
        self._busy = self._family(m.WORKER_BUSY)
        self._memory = self._family(m.WORKER_MEMORY)
        self._undurable, self._oldest_frame = self._family(m.UNDURABLE), self._family(m.OLDEST_FRAME)
        self.refused, self.denied = self._family(m.REFUSED), self._family(m.DENIED)
        self.handshakes, self.throttled = self._family(m.HANDSHAKES), self._family(m.THROTTLED)
        self._expires_s: Callable[[], float] = lambda: math.nan
        collect(m.CERTIFICATE_EXPIRY, self.registry, lambda: self._expires_s())
        self.store_bytes, self.database_bytes = self._family(m.STORE_BYTES), self._family(m.DATABASE_BYTES)
        self.retention, self.retention_bytes = self._family(m.RETENTION), self._family(m.RETENTION_BYTES)
        self.dense_clouds, self.dense_bytes = self._family(m.DENSE_CLOUDS), self._family(m.DENSE_BYTES)
        self.drained, self.draining = self._family(m.DRAINED), self._family(m.DRAINING)
        self.replicas = self._family(m.REPLICAS)
        self.watchers, self.watch_dropped = self._family(m.WATCHERS), self._family(m.WATCH_DROPPED)
        self.viewers, self.views_missed = self._family(m.VIEWERS), self._family(m.VIEWS_MISSED)
        self._by_name = {
            "frames": self._family(m.FRAMES),
            "rejected": self._family(m.REJECTED),
            "corrections": self._family(m.CORRECTIONS),
            "correction_metres": self._family(m.CORRECTION_METRES),
            "registrations": self._family(m.REGISTRATIONS),
            "iterations": self._family(m.ITERATIONS),
            "inliers": self._family(m.INLIERS),
            "stage_seconds": self._family(m.STAGE_SECONDS),
            "gnss": self._family(m.GNSS),
            "loops": self._family(m.LOOPS),
            "loop_candidates": self._family(m.LOOP_CANDIDATES),
            "commits": self._family(m.COMMITS),
            "commit_seconds": self.commit_seconds,
            "commit_bytes": self._family(m.COMMIT_BYTES),
            "refused": self.refused,
            "fenced": self._family(m.FENCED),
            "keyframes": self._family(m.KEYFRAMES),
        }
        self._beats: dict[int, Beat] = {}
        self._delays_s: dict[int, float] = {}
        self._cpu_before_s = dict.fromkeys(range(config.worker_count), 0.0)  # of workers that have died
        collect(m.WORKER_CPU, self.registry, self._cpu_s, worker=self._workers)
        self.robots = RobotGauges(config.metrics.robots, self.registry) if config.metrics.per_robot else None
        show_build(self.registry)
        ProcessCollector(registry=self.registry)
        self._show_sums()

    def _family(self, metric: Metric) -> Family:
        return Family(metric, self.registry, worker=self._workers, site=[*sorted(self.sites), OTHER])

    def certificate_from(self, expires_s: Callable[[], float]) -> None:
        """Shows when the certificate in force, or an authority, expires; Unix time."""
        self._expires_s = expires_s

    def absorb(self, worker: int, beat: Beat, unanswered: int, delay_s: float) -> None:
        """Takes over what a worker has counted, and how it stands. unanswered, delay_s: of the frames it was given."""
        for (name, *labels), increment in beat.counts.items():
            self._by_name[name].inc(*labels, by=increment)
        for (name, *labels), value in beat.observations:
            self._by_name[name].observe(value, *labels)
        self._beats[worker], self._delays_s[worker] = beat, delay_s
        self._show_worker(str(worker), unanswered, beat.queue_messages, beat.busy_s, beat.resident_bytes)
        self._show_sums()

    def forget_worker(self, worker: int) -> None:
        """It has died: its sessions are in no memory any more."""
        if (beat := self._beats.pop(worker, None)) is not None:
            self._cpu_before_s[worker] += beat.cpu_s
        self._delays_s.pop(worker, None)
        self._show_worker(str(worker), 0, 0, 0.0, 0)
        self._show_sums()
        if self.robots is not None:
            self.robots.update(worker, [])

    def _show_worker(self, worker: str, unanswered: int, messages: int, busy_s: float, resident_bytes: int) -> None:
        self._queue_frames.set(unanswered, worker)
        self._queue_messages.set(messages, worker)
        self._busy.set(busy_s, worker)
        self._memory.set(resident_bytes, worker)

    def _show_sums(self) -> None:
        beats = list(self._beats.values())
        for state in m.STATES:
            self.sessions.set(sum(beat.sessions.get(state, 0) for beat in beats), state)
        self._undurable.set(sum(beat.undurable_frames for beat in beats))
        self._oldest_frame.set(max(self._delays_s.values(), default=0.0))

    def _cpu_s(self) -> Mapping[str, float]:
        beats = dict(self._beats)
        return {
            str(worker): before_s + (beats[worker].cpu_s if worker in beats else 0.0)
            for worker, before_s in self._cpu_before_s.items()
        }

    def serve(self, host: str, port: int | None) -> Page | None:
        """/metrics on its own thread; None when switched off. Raises InputError for a port that is taken."""
        return None if port is None else Page(self.registry, host, port)
