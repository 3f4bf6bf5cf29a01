"""Configuration of the map service: YAML, environment (SPLITSLAM_MAP__...), options; defaults run as they are."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from map_service.settings import PipelineSettings
from splitslam.config import Model
from splitslam.security.settings import ServerTls

ENV_PREFIX = "SPLITSLAM_MAP"
SESSIONS_A_WORKER = 16


def _address(listen: str) -> str:
    host, _, port = listen.rpartition(":")
    if not host or not port.isdecimal() or int(port) > 65535:
        raise ValueError("expected HOST:PORT, e.g. 0.0.0.0:50051")
    return listen


class MetricsConfig(Model):
    """Where /metrics is served, and whether it has gauges for each robot (docs/metrics.md)."""

    host: str = "127.0.0.1"
    port: int | None = Field(default=9465, ge=0, le=65535, description="0: a free port; null: no metrics")
    per_robot: bool = Field(default=False, description="gauges by robot id, while it has a session here")
    robots: int = Field(default=100, ge=1, le=10_000, description="so many robots have series; others are counted")


class LogConfig(Model):
    """Log lines on stderr."""

    format: Literal["console", "json"] = "console"
    level: Literal["debug", "info", "warning", "error"] = "info"


class ClientLimitsConfig(Model):
    """What one robot may take (map_service/client_limits.py)."""

    streams: int = Field(default=16, ge=1, description="open at a time: its run, one of before, those that broke")
    opens_per_s: float = Field(default=5.0, gt=0)
    opens_burst: int = Field(default=50, ge=1)
    messages_per_s: float = Field(default=500.0, gt=0, description="read of a stream; more wait in the network")
    messages_burst: int = Field(default=2000, ge=1)


class LimitsConfig(Model):
    """Everything that waits is bounded."""

    window_frames: int = Field(default=16, ge=2, le=1024, description="frames a robot may have unanswered")
    worker_queue_messages: int = Field(default=256, ge=4)
    max_message_bytes: int = Field(default=4 << 20, ge=1 << 16)
    max_sessions: int = Field(default=0, ge=0, description="robots served at once; more are refused; 0: by workers")
    max_delay_s: float = Field(default=1.0, gt=0, description="no new robot while a frame has waited longer than this")
    held_sessions: int = Field(default=64, ge=1, description="sessions a worker keeps in memory without a stream")
    idle_s: float = Field(default=600.0, gt=0, description="how long a worker keeps a session without a stream")
    hello_s: float = Field(default=5.0, gt=0, description="how long a new stream may take to say Hello")
    silent_s: float = Field(default=5.0, gt=0, description="a worker without a sign of life is killed and restarted")
    client: ClientLimitsConfig = ClientLimitsConfig()
    stall_s: float = Field(default=30.0, gt=0, description="the same for one that works on a single job this long")


class WatchConfig(Model):
    """Calls that follow sessions, WatchPoses and Events (docs/api.md)."""

    most: int = Field(default=32, ge=1, description="at a time, of all callers")
    every_s: float = Field(default=0.5, gt=0, le=1.0, description="how often each asks the store for what is new")
    backlog_scans: int = Field(
        default=3000, ge=100, description="scans of a session that wait for a slow reader; older ones are left out"
    )


class ReplicaConfig(Model):
    """How this service lives with others on the same store (map_service/membership.py)."""

    shared: bool | None = Field(default=None, description="others use the store too; null: unless it is SQLite")
    address: str = Field(default="", description="HOST:PORT the proxy knows this one by; empty: what it listens on")
    beat_s: float = Field(default=1.0, gt=0, description="period of its sign of life in the store")
    lost_beats: int = Field(default=3, ge=2, description="so many of our beats without one of a replica: it is gone")
    rest_s: float = Field(default=2.0, ge=0, description="shortest time between two sessions that are given away")


class AdviceConfig(Model):
    """Wishes sent to every robot."""

    max_kbps: int = Field(default=0, ge=0, description="uplink limit; 0: none")


class CommitConfig(Model):
    """When a session is committed, and what happens while the store takes none."""

    every_s: float = Field(default=1.0, gt=0)
    every_frames: int = Field(default=20, ge=1)
    backlog_frames: int = Field(
        default=2000, ge=100, description="frames applied and not yet durable; at so many a session waits for its store"
    )
    drain_s: float = Field(default=5.0, ge=0, description="how long a failing store is tried when the service ends")


class QuotaConfig(Model):
    """How much a site may store (map_service/quota.py)."""

    site_bytes: int = Field(default=0, ge=0, description="of each site; 0: no quota")
    sites: dict[str, int] = Field(default={}, description="of sites by name, instead; 0: no quota")
    every_s: float = Field(default=5.0, gt=0, description="how often the store is asked what there is")
    retry_after_s: float = Field(default=30.0, gt=0, description="when a robot that was refused may ask again")


class RetentionConfig(Model):
    """How long finished sessions are kept (map_service/housekeeping.py)."""

    finished_days: float = Field(default=0.0, ge=0, description="0: for ever")
    sites: dict[str, float] = Field(default={}, description="of sites by name, instead; 0: for ever")


class PosesConfig(Model):
    """How long poses of scans are kept as they are (map_service/block_keeping.py)."""

    full_rate_h: float = Field(default=0.5, ge=0, description="hours of the session; older ones are thinned; 0: never")
    within_m: float = Field(default=0.003, ge=0.0005, le=0.1, description="so near are thinned poses to what they were")
    within_deg: float = Field(default=0.05, ge=0.01, le=2.0, description="the same, of rotations")
    upgrade_h: float = Field(
        default=24.0, ge=0, description="so long replicas of before blocks may run beside this one"
    )


class ServiceConfig(Model):
    """`map-service serve`."""

    listen: Annotated[str, AfterValidator(_address)] = "127.0.0.1:50051"
    store: str = Field(
        default="sqlite:///splitslam-map.db", description="sqlite:///FILE or postgresql://USER@HOST/DATABASE"
    )
    store_wait_s: float = Field(default=30.0, ge=0, description="how long a start waits for a store that is away")
    workers: int = Field(default=0, ge=0, le=256, description="worker processes; 0: one a core, less one")
    loop_workers: int = Field(default=1, ge=1, le=64, description="processes a worker verifies loops with")
    drain_s: float = Field(default=8.0, gt=0, le=9.0, description="longest graceful drain; the process is gone in 10 s")
    tls: ServerTls = ServerTls()
    health_socket: Path | None = Field(
        default=None, description="Unix socket that answers health checks, which behind TLS nobody else can ask"
    )
    metrics: MetricsConfig = MetricsConfig()
    log: LogConfig = LogConfig()
    limits: LimitsConfig = LimitsConfig()
    watch: WatchConfig = WatchConfig()
    commit: CommitConfig = CommitConfig()
    replica: ReplicaConfig = ReplicaConfig()
    advice: AdviceConfig = AdviceConfig()
    quota: QuotaConfig = QuotaConfig()
    retention: RetentionConfig = RetentionConfig()
    poses: PosesConfig = PosesConfig()
    housekeeping_s: float = Field(
        default=60.0, gt=0, description="how often retention and old poses are seen to, the store measured"
    )
    pipeline: PipelineSettings = PipelineSettings()

    @model_validator(mode="after")
    def _not_in_the_clear(self) -> Self:
        self.tls.check(self.listen)
        return self

    @property
    def name(self) -> str:
        """This replica, in log lines."""
        return self.replica.address or self.listen

    @property
    def worker_count(self) -> int:
        return self.workers or max(1, (os.cpu_count() or 2) - 1)

    @property
    def session_limit(self) -> int:
        """A robot at 10 Hz keeps a core busy for 3 to 4 % of the time; the rest is for loops and for catching up."""
        return self.limits.max_sessions or SESSIONS_A_WORKER * self.worker_count
