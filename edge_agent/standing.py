"""How a run stands, for all who ask: /metrics, /diagnostics of a ROS graph, systemd's status line, the run's report."""

from __future__ import annotations

from dataclasses import dataclass

from edge_agent.going_on import StartAfter
from edge_agent.imu.constant_velocity import ConstantVelocityNode
from edge_agent.imu.node import ImuNode
from edge_agent.loop import AgentLoop
from edge_agent.metrics import EdgeMetrics
from edge_agent.reader import Reader
from edge_agent.sources import Source
from edge_agent.tally import Tally
from edge_agent.uplink import Uplink
from edge_agent.wire import state_name


@dataclass(slots=True)
class Standing:
    """Counts are the parts' own. loop: None until the run's first scan may come."""

    source: Source
    after: StartAfter
    reader: Reader
    imu: ImuNode | ConstantVelocityNode
    uplink: Uplink
    tally: Tally
    metrics: EdgeMetrics
    loop: AgentLoop | None = None

    @property
    def scans_read(self) -> int:
        """Of this agent: without those that one before has had, or that came before it listened."""
        return self.source.counts.scans_read - self.after.skipped - self.reader.passed_scans

    def scans(self) -> dict[str, int]:
        """What became of them, by the words of the metric."""
        return {
            "read": self.scans_read,
            "sent": self.tally.sent,
            "mapped": self.tally.mapped,
            "rejected": self.tally.rejected,
            "replayed": self.tally.replayed,
        }

    @property
    def state(self) -> int:
        """The number of a splitslam.v1.TrackingState."""
        return self.imu.state if self.loop is None else self.loop.state

    def imu_gaps(self) -> tuple[int, float]:
        """How often the IMU was silent, and how long together, s."""
        return (self.imu.gaps.count, self.imu.gaps.seconds) if isinstance(self.imu, ImuNode) else (0, 0.0)

    def dropped(self) -> dict[str, int]:
        """Scans and samples that were dropped, by reason, since the run began."""
        return self.metrics.all_dropped()

    def line(self) -> str:
        """In words, for people."""
        link = "connected" if self.uplink.anchored else "not connected"
        said = f"{state_name(self.state)}; {link}, {self.uplink.kept} frames kept"
        return "; ".join(filter(None, (said, self.source.status())))

    def diagnostics(self) -> dict[str, object]:
        """The values of /diagnostics."""
        return {
            "connected": self.uplink.anchored,
            "frames_kept": self.uplink.kept,
            "scans_read": self.scans_read,
            "scans_mapped": self.tally.mapped,
            "dropped": sum(self.dropped().values()),
            "sensors": self.source.status() or "ok",
        }
