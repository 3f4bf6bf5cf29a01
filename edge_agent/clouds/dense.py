"""The parts of `uplink.dense: idle` put together, for the daemon."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable
from typing import Any

from edge_agent.clouds.keeper import CloudKeeper
from edge_agent.clouds.sender import CloudSender
from edge_agent.clouds.shelf import CloudShelf
from edge_agent.config import AgentConfig
from edge_agent.metrics import EdgeMetrics
from edge_agent.pipeline import EdgePipeline
from edge_agent.tcp_meter import TcpBytes
from edge_agent.uplink import Uplink
from splitslam.security.client import Connector
from splitslam.wire import dense_pb2
from splitslam.wire import session_pb2 as pb

FOLDER = "dense"  # in the spool's directory, whose lock keeps other agents out
_PATIENCE_S = 30.0  # at the end of a run, without an answer
_TICK_S = 0.2
NEVER: dict[str, Any] = {"sent": 0, "waiting": 0, "dropped": {}, "bytes": 0}  # `dense` of report.json without any


class DenseClouds:
    """What the agent keeps besides frames, and sends when it has nothing better to send."""

    def __init__(
        self, config: AgentConfig, hello: pb.Hello, pipeline: EdgePipeline, uplink: Uplink, metrics: EdgeMetrics
    ) -> None:
        """hello: of the own run. From now on the pipeline's dense frames come with their whole scans."""
        assert config.spool_dir is not None  # the configuration sees to it
        own = dense_pb2.UploadOpen(robot_id=hello.robot_id, run_id=hello.run_id, site_id=hello.site_id)
        size = int(config.uplink.dense_max_mb * 1e6)
        self._shelf = CloudShelf(config.spool_dir / FOLDER, size, own)
        self.keeper = CloudKeeper(self._shelf, config.pipeline.step_m, hello.lockstep)
        connector = Connector(config.server, config.tls)
        booked = pipeline.rate.also_sent
        self._sender = CloudSender(self._shelf, uplink, config.server, connector, metrics, booked)
        self._uplink = uplink
        metrics.dense_from(self._shelf, lambda: self._sender.sent)
        metrics.tcp_bytes_from(lambda: self.tcp_bytes().sent, lambda: self.tcp_bytes().received)
        pipeline.keeps_scans = True

    def start(self) -> None:
        """Begins to send."""
        self._sender.start()

    def finish(self, stop: threading.Event, tell: Callable[[int, int], None]) -> None:
        """The run is over: until all is sent, `stop` is set, or nothing moves any more. tell: sent, waiting."""
        self.keeper.flush()
        self._sender.moved_s = time.monotonic()
        while self._uplink.takes_dense and self._shelf.waiting and not stop.wait(_TICK_S):
            tell(self._sender.sent, self._shelf.waiting)
            if time.monotonic() - self._sender.moved_s > _PATIENCE_S:
                break
        if waiting := self._shelf.waiting:
            print(f"{waiting} dense keyframes are not sent: they go up at the agent's next start", file=sys.stderr)

    def close(self) -> None:
        """What is not sent stays on the disk."""
        self.keeper.close()
        self._sender.close()

    def tcp_bytes(self) -> TcpBytes:
        """TCP payload of their own connections so far."""
        return self._sender.tcp_bytes()

    def report(self) -> dict[str, Any]:
        """`dense` of report.json."""
        return {
            "sent": self._sender.sent,
            "waiting": self._shelf.waiting,
            "dropped": dict(self._shelf.dropped),
            "bytes": self.tcp_bytes().sent,
        }


def open_clouds(
    config: AgentConfig, hello: pb.Hello, pipeline: EdgePipeline, uplink: Uplink, metrics: EdgeMetrics
) -> DenseClouds | None:
    """None: `uplink.dense: never`."""
    if config.uplink.dense == "never":
        return None
    return DenseClouds(config, hello, pipeline, uplink, metrics)
