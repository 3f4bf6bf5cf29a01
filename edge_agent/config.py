"""The agent's configuration: YAML by --config, every key also by environment (SPLITSLAM_EDGE__UPLINK__MAX_KBPS)."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, field_validator, model_validator

from edge_agent.imu.settings import ImuSettings
from edge_agent.live_settings import LiveConfig
from edge_agent.odometry.settings import OdometrySettings
from edge_agent.ros.settings import Ros1Settings, Ros2Settings, RosSettings
from edge_agent.settings import PipelineSettings
from splitslam.config import Model
from splitslam.security.settings import ClientTls

ENVIRONMENT_PREFIX = "SPLITSLAM_EDGE"
Part = Literal["loops", "gnss", "imu", "wheels"]
Port = Annotated[int, Field(ge=0, le=65535)]
Positive = Annotated[float, Field(gt=0)]


def split_server(server: str) -> tuple[str, int]:
    """`host:port` -> (host, port); `[::1]:50051` for IPv6. Raises ValueError."""
    host, _, port = server.rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    if not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise ValueError("expected host:port, e.g. 192.168.0.10:50051")
    return host, int(port)


def _server(server: str) -> str:
    split_server(server)
    return server


SOURCES = ("recording", "live", "ros1", "ros2")  # sections of `source`, of which a configuration has exactly one


class SourceConfig(Model):
    """Where scans and samples come from: a recording, or sensors.

    realtime: a recording paced by its clock; otherwise lockstep, as fast as it goes and reproducible. Sensors are
    always by the clock.
    queue_scans: scans that may wait to be processed; more are dropped (by the clock) or not read yet (lockstep).
    began_s: realtime only: when the recording's first message was (or will be) due, on the system's monotonic clock.
    What was due before the agent listens has passed, as with a sensor; null: the recording begins when the agent does.
    """

    recording: Path | None = None
    live: LiveConfig | None = None
    ros1: Ros1Settings | None = None
    ros2: Ros2Settings | None = None
    realtime: bool = False
    max_scans: Annotated[int, Field(ge=1)] | None = None
    queue_scans: Annotated[int, Field(ge=1)] = 20
    began_s: float | None = None

    @property
    def by_the_clock(self) -> bool:
        """Nobody waits for anybody: scans that come too fast are dropped."""
        return self.realtime or self.recording is None

    @property
    def ros(self) -> Ros1Settings | Ros2Settings | None:
        """The graph that the sensors are in, if they are in one."""
        return self.ros1 or self.ros2

    @property
    def name(self) -> str:
        """For people."""
        return str(self.recording) if self.recording is not None else next(k for k in SOURCES if getattr(self, k))

    @model_validator(mode="after")
    def _exactly_one(self) -> Self:
        there = [kind for kind in SOURCES if getattr(self, kind) is not None]
        if len(there) != 1:
            raise ValueError(f"expected exactly one of {', '.join(SOURCES)}, found {' and '.join(there) or 'none'}")
        if self.recording is None and (self.realtime or self.max_scans is not None or self.began_s is not None):
            raise ValueError("realtime, max_scans, began_s: expected only with recording")
        return self

    @model_validator(mode="after")
    def _only_by_the_clock(self) -> Self:
        if self.began_s is not None and not self.realtime:
            raise ValueError("began_s: expected realtime: true with it")
        return self


class OutputConfig(Model):
    """dir: online.tum, odom.tum, imu.tum, metrics.prom and edge.json. progress: JSON lines on stdout."""

    dir: Path | None = None
    progress: bool = False


class UplinkConfig(Model):
    """The link to the map service; docs/protocol.md says what the times mean.

    max_kbps: null: no limit. buffer_bytes: kept frames that are in memory only, for want of a spool or while its disk
    fails. copies_bytes: of those on disk, what is in memory as well. window: before the first Credit.
    connect_timeout_s: for the very first Welcome of a run; null: for ever, and with a spool the run begins without it
    (`splitslam run`: 10 s, as somebody waits).
    reconnect_timeout_s: for each later outage, null: for ever.
    answer_timeout_s: a stream that talks but leaves a frame unanswered for so long is given up.
    dense: idle: whole scans of keyframes stay on the robot's disk (`dense` in the spool's directory) and go up when the
    link is idle. dense_max_mb: of them that wait; the oldest go first.
    """

    max_kbps: Positive | None = None
    buffer_bytes: Annotated[int, Field(ge=1)] = 64 * 2**20
    copies_bytes: Annotated[int, Field(ge=0)] = 4 * 2**20
    window: Annotated[int, Field(ge=1)] = 4
    connect_timeout_s: Positive | None = None
    reconnect_timeout_s: Positive | None = None
    welcome_timeout_s: Positive = 0.5
    welcome_timeout_max_s: Positive = 4.0
    watchdog_s: Positive = 1.5
    answer_timeout_s: Positive = 30.0
    backoff_first_s: Positive = 0.1
    backoff_max_s: Positive = 2.0
    dense: Literal["idle", "never"] = "never"
    dense_max_mb: Positive = 1024.0


class SpoolConfig(Model):
    """The disk that keeps frames until they are durable at the map service.

    dir: null: `spool` in the state directory; without a state directory either, frames are kept in memory only.
    """

    dir: Path | None = None
    max_bytes: Annotated[int, Field(ge=2**16)] = 2 * 2**30


class RawRingConfig(Model):
    """The last seconds of raw sensor messages, for `splitslam diagnose`; whatever is reached first bounds them.

    dir: should be in memory: a memory card does not want 1 MB/s. null: `raw` in the service's runtime directory;
    without one none are kept. max_bytes: 60 s of a VLP-16 with an IMU; 0: none are kept.
    """

    dir: Path | None = None
    seconds: Positive = 60.0
    max_bytes: Annotated[int, Field(ge=0)] = 72 * 2**20

    @field_validator("max_bytes")
    @classmethod
    def _worth_it(cls, size: int) -> int:
        if 0 < size < 2**20:
            raise ValueError("expected 0 or at least 1048576")
        return size


class MetricsConfig(Model):
    """port: null: no /metrics; 0: any free port, which is printed."""

    port: Port | None = 9464
    host: str = "127.0.0.1"


class FeedConfig(Model):
    """The pose for programs on the robot. queue_samples: what a slow reader may fall behind before it loses samples."""

    socket: Path | None = None
    max_readers: Annotated[int, Field(ge=1)] = 8
    queue_samples: Annotated[int, Field(ge=1)] = 1000


class LogConfig(Model):
    """Log lines on stderr."""

    format: Literal["console", "json"] = "console"
    level: Literal["debug", "info", "warning", "error"] = "warning"


class AgentConfig(Model):
    """Everything `edge-agent run` reads."""

    robot: Path
    server: Annotated[str, AfterValidator(_server)] = "127.0.0.1:50051"
    tls: ClientTls = ClientTls()
    source: SourceConfig
    output: OutputConfig = OutputConfig()
    pipeline: PipelineSettings = PipelineSettings()
    imu: ImuSettings = ImuSettings()
    odometry: OdometrySettings = OdometrySettings()
    disable: tuple[Part, ...] = ()
    uplink: UplinkConfig = UplinkConfig()
    spool: SpoolConfig = SpoolConfig()
    raw_ring: RawRingConfig = RawRingConfig()
    metrics: MetricsConfig = MetricsConfig()
    feed: FeedConfig = FeedConfig()
    ros: RosSettings = RosSettings()
    log: LogConfig = LogConfig()
    state_dir: Path | None = None
    site_id: str = ""
    map_id: str = ""

    @property
    def spool_dir(self) -> Path | None:
        """The spool's directory; None: there is none."""
        return self.spool.dir or (self.state_dir / "spool" if self.state_dir else None)

    @property
    def spools(self) -> bool:
        """There is a directory for the spool."""
        return self.spool_dir is not None

    @model_validator(mode="after")
    def _dense_needs_a_disk(self) -> Self:
        if self.uplink.dense == "idle" and not self.spools:
            raise ValueError("uplink.dense: idle: expected state_dir or spool.dir with it")
        return self

    @model_validator(mode="after")
    def _one_graph(self) -> Self:
        if self.source.ros is not None and (self.ros.ros1 is not None or self.ros.ros2 is not None):
            raise ValueError("ros.ros1, ros.ros2: expected only when the source is not in a ROS graph itself")
        return self

    @model_validator(mode="after")
    def _not_in_the_clear(self) -> Self:
        self.tls.check(self.server)
        return self
