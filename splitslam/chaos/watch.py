"""What robots and replicas say of themselves while they run: pose feed and /metrics, read a few times a second."""

from __future__ import annotations

import contextlib
import http.client
import threading
import time
import urllib.request
from dataclasses import dataclass, field
from typing import Any

import grpc
import numpy as np
from numpy.typing import NDArray

from splitslam import se3
from splitslam.chaos.agent import Agent
from splitslam.stack import Replica
from splitslam.wire import local_pb2, local_pb2_grpc
from splitslam.wire.types_pb2 import Transform

_POSE_HZ = 5.0
_AGENT_S, _REPLICA_S = 0.2, 0.4
_ASK_S = 1.0
ANSWERS = "splitslam_edge_round_trip_seconds_count"
STATE = "splitslam_edge_state"
KEPT = "splitslam_edge_buffer_frames"


@dataclass(frozen=True, slots=True)
class AgentStatus:
    """T_map_body as the robot has it now; answered: frames of this life; spool: frames kept for the service."""

    up: bool = False
    state: int = 0
    T_map_body: NDArray[np.float64] | None = None
    answered: int = 0
    spool: int = 0
    gap_s: float = 0.0
    longest_gap_s: float = 0.0
    lives: int = 1


@dataclass(frozen=True, slots=True)
class ReplicaStatus:
    """word: up, starting, frozen, draining or dead; streams: robots that it serves."""

    word: str = "starting"
    streams: int = 0
    frames: int = 0
    fenced: int = 0


@dataclass(slots=True)
class AgentWatch:
    """Follows one agent over its lives."""

    agent: Agent
    status: AgentStatus = field(default_factory=AgentStatus)
    _pose: local_pb2.WatchResponse | None = None
    _call: Any = None  # that waits for the next pose
    _answered_s: float | None = None
    _stop: threading.Event = field(default_factory=threading.Event)
    _threads: list[threading.Thread] = field(default_factory=list)

    def start(self) -> None:
        for target in (self._follow_pose, self._follow_metrics):
            thread = threading.Thread(target=target, name=f"watch-{self.agent.name}", daemon=True)
            self._threads.append(thread)
            thread.start()

    def stop(self) -> None:
        """Does not wait for a pose: an agent may have none to tell."""
        self._stop.set()
        if self._call is not None:
            self._call.cancel()
        for thread in self._threads:
            thread.join()

    def _follow_pose(self) -> None:
        while not self._stop.is_set():
            with grpc.insecure_channel(f"unix:{self.agent.socket}") as channel:
                call = self._call = local_pb2_grpc.LocalPoseServiceStub(channel).Watch(
                    local_pb2.WatchRequest(max_rate_hz=_POSE_HZ), wait_for_ready=False
                )
                if self._stop.is_set():  # `stop` may not have seen the call
                    call.cancel()
                with contextlib.suppress(grpc.RpcError):
                    for self._pose in call:
                        pass
            self._stop.wait(0.1)

    def _follow_metrics(self) -> None:
        seen, lives, longest_s = 0, 1, 0.0
        while not self._stop.wait(_AGENT_S):
            values = read_metrics(self.agent.metrics_port)
            now_s = time.monotonic()
            if len(self.agent.lives) != lives:  # the counters begin anew
                lives, seen = len(self.agent.lives), 0
            answered = int(values.get(ANSWERS, 0)) if values else seen
            if answered > seen:
                if self._answered_s is not None:
                    longest_s = max(longest_s, now_s - self._answered_s - _AGENT_S)
                seen, self._answered_s = answered, now_s
            gap_s = 0.0 if self._answered_s is None or self.agent.done else now_s - self._answered_s
            self.status = AgentStatus(
                up=self.agent.process.alive and bool(values),
                state=int(values.get(STATE, 0)) if values else 0,
                T_map_body=self._T_map_body(),
                answered=answered,
                spool=int(values.get(KEPT, 0)) if values else self.status.spool,
                gap_s=gap_s if gap_s > 2 * _AGENT_S else 0.0,
                longest_gap_s=max(longest_s, gap_s if gap_s > 2 * _AGENT_S else 0.0),
                lives=lives,
            )

    def _T_map_body(self) -> NDArray[np.float64] | None:
        pose = self._pose
        return None if pose is None else _matrix(pose.pose_map_odom) @ _matrix(pose.pose_odom_body)


@dataclass(slots=True)
class ReplicaWatch:
    """Follows one replica over its restarts. frozen, draining: what was done to it, which it cannot say itself."""

    replica: Replica
    status: ReplicaStatus = field(default_factory=ReplicaStatus)
    frozen: bool = False
    draining: bool = False
    _stop: threading.Event = field(default_factory=threading.Event)
    _thread: threading.Thread | None = None

    def start(self) -> None:
        self._thread = threading.Thread(target=self._follow, name=f"watch-{self.replica.name}", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        self._stop.set()
        if self._thread is not None:
            self._thread.join()

    def _follow(self) -> None:
        while True:
            values = None if self.frozen else read_metrics(self.replica.metrics_port)
            values = values or {}
            self.status = ReplicaStatus(
                word=self._word(bool(values)),
                streams=int(values.get("splitslam_map_streams", 0)),
                frames=int(values.get('splitslam_map_frames_total{result="mapped"}', 0)),
                fenced=int(values.get("splitslam_map_fenced_total", 0)),
            )
            if self._stop.wait(_REPLICA_S):
                return

    def _word(self, answers: bool) -> str:
        if not self.replica.alive:
            return "dead"
        if self.frozen:
            return "frozen"
        if self.draining:
            return "draining"
        return "up" if answers and self.replica.ready else "starting"


def read_metrics(port: int | None) -> dict[str, float]:
    """Every sample by name and labels; empty when nobody answers, or is killed while it does."""
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=_ASK_S) as page:
            lines = page.read().decode().splitlines()
        samples = (line.rsplit(" ", 1) for line in lines if not line.startswith("#"))
        return {name: float(value) for name, value in samples}
    except (OSError, http.client.HTTPException, ValueError):
        return {}


def _matrix(message: Transform) -> NDArray[np.float64]:
    quat_xyzw = np.array([message.qx, message.qy, message.qz, message.qw])
    if not np.linalg.norm(quat_xyzw) > 0.0:
        return np.eye(4)
    return se3.from_quat(np.array([message.tx_m, message.ty_m, message.tz_m]), quat_xyzw)
