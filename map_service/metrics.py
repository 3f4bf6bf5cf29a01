"""Prometheus metrics of the service: kept by the front, fed by its own events and by the workers' beats."""

from __future__ import annotations

import threading
from typing import get_args
from wsgiref.simple_server import WSGIServer

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, start_http_server

from map_service.callers import Reason
from map_service.channel import Beat
from map_service.config import MetricsConfig
from map_service.types import State
from splitslam.errors import InputError

_ANSWER_BUCKETS_S = (0.002, 0.004, 0.006, 0.01, 0.015, 0.025, 0.04, 0.06, 0.1, 0.2, 0.5, 1, 2, 5)
_COMMIT_BUCKETS_S = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5)
STATES = (*(s.name.lower() for s in State), "detached")


class ServiceMetrics:
    """One registry. Label sets are bounded: nothing a robot says becomes a label."""

    def __init__(self) -> None:
        self.registry = r = CollectorRegistry()
        self.answer_seconds = Histogram(
            "splitslam_map_answer_seconds", "Frame received to answer sent", registry=r, buckets=_ANSWER_BUCKETS_S
        )
        self.commit_seconds = Histogram(
            "splitslam_map_commit_seconds", "One commit, tries included", registry=r, buckets=_COMMIT_BUCKETS_S
        )
        self.sessions = Gauge(
            "splitslam_map_sessions", "Sessions in memory; detached: no stream", ["state"], registry=r
        )
        self.streams = Gauge("splitslam_map_streams", "Streams open", registry=r)
        self.queue_depth = Gauge("splitslam_map_queue_frames", "Frames waiting for an answer", ["worker"], registry=r)
        self.restarts = Counter("splitslam_map_worker_restarts", "Workers that died", registry=r)
        self.refused = self._counter("splitslam_map_refused", "Streams refused", "reason")
        self.denied = self._counter("splitslam_map_auth_refused", "Calls of who may not, or too often", "reason")
        for reason in get_args(Reason):
            self.denied.labels(reason)
        self.handshakes = Counter("splitslam_map_tls_handshakes", "TLS handshakes begun", registry=r)
        self.throttled = Counter("splitslam_map_throttled_messages", "Messages that came too fast", registry=r)
        self.certificate_expiry = Gauge(
            "splitslam_map_certificate_expiry_timestamp_seconds", "The first to expire; NaN: no TLS", registry=r
        )
        self.certificate_expiry.set(float("nan"))
        self.store_bytes = Gauge(
            "splitslam_map_store_bytes", "What the sessions of a site have stored", ["site"], registry=r
        )
        self.database_bytes = Gauge("splitslam_map_database_bytes", "The store as it lies on disk", registry=r)
        self.retention = Counter("splitslam_map_retention_sessions", "Finished sessions deleted for age", registry=r)
        self.retention_bytes = Counter("splitslam_map_retention_bytes", "What they had stored", registry=r)
        self.drained = self._counter("splitslam_map_drained", "Robots sent to another replica", "reason")
        for reason in ("shutdown", "rebalance"):
            self.drained.labels(reason)
        self.replicas = Gauge("splitslam_map_replicas", "Replicas alive by the store; 0: not shared", registry=r)
        self._by_name = {
            "frames": self._counter("splitslam_map_frames", "Frames", "result"),
            "rejected": self._counter("splitslam_map_rejected", "Frames not mapped", "reason"),
            "corrections": self._counter("splitslam_map_corrections", "Jumps of T_map_odom", "cause"),
            "gnss": self._counter("splitslam_map_gnss", "GNSS fixes", "result"),
            "loops": self._counter("splitslam_map_loops", "Loop closures", "result"),
            "commits": self._counter("splitslam_map_commits", "Commits", "result"),
            "refused": self.refused,
            "fenced": Counter("splitslam_map_fenced", "Streams ended because another owner took over", registry=r),
            "keyframes": Counter("splitslam_map_keyframes", "Keyframes", registry=r),
        }
        for result in ("mapped", "duplicate", "rejected", "gap", "failed"):
            self._by_name["frames"].labels(result)
        self._states: dict[int, dict[str, int]] = {}
        self.forget_worker(0)

    def _counter(self, name: str, text: str, label: str) -> Counter:
        return Counter(name, text, [label], registry=self.registry)

    def absorb(self, worker: int, beat: Beat) -> None:
        """Take over what a worker has counted."""
        for (name, *labels), increment in beat.counts.items():
            metric = self._by_name[name]
            (metric.labels(*labels) if labels else metric).inc(increment)
        for _, value in beat.observations:
            self.commit_seconds.observe(value)
        self._states[worker] = beat.sessions
        self._show_states()

    def forget_worker(self, worker: int) -> None:
        """Its sessions are in no memory any more."""
        self._states.pop(worker, None)
        self._show_states()

    def _show_states(self) -> None:
        for state in STATES:
            self.sessions.labels(state).set(sum(s.get(state, 0) for s in self._states.values()))

    def serve(self, config: MetricsConfig) -> tuple[WSGIServer, threading.Thread] | None:
        """/metrics on its own thread; None when switched off. Raises InputError for a port that is taken."""
        if config.port is None:
            return None
        try:
            return start_http_server(config.port, config.host, self.registry)
        except OSError as error:
            raise InputError(f"metrics.port {config.host}:{config.port}: {error.strerror}") from error
