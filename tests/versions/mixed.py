"""Services and agents of either release as processes, and the way between them."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import grpc
import numpy as np
import yaml

from splitslam.tum import tum_line
from splitslam.wire import session_pb2 as pb
from splitslam.wire import session_pb2_grpc as rpc
from tests.edge_agent.relay import CountingRelay

NEW_SERVICE, NEW_AGENT = (sys.executable, "-m", "map_service"), (sys.executable, "-m", "edge_agent")
READY_S, RUN_S = 240.0, 120.0  # a first start compiles


def wait_until(condition: Callable[[], bool], what: str, within_s: float) -> None:
    deadline_s = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < deadline_s, what
        time.sleep(0.05)


class Service:
    """A map service of either release on the shared store, SQLite: 0.1.0 knew nothing else."""

    def __init__(self, program: Sequence[str], store: Path, log: Path) -> None:
        options = ("--listen", "127.0.0.1:0", "--store", f"sqlite:///{store}", "--workers", "1", "--metrics-port", "0")
        self._log, self._out = log, log.with_suffix(".out")
        with log.open("w") as err, self._out.open("w") as out:
            command = (*program, "serve", *options)
            self.process = subprocess.Popen(command, stdout=out, stderr=err, start_new_session=True)

    def wait_ready(self) -> None:
        wait_until(lambda: "listening" in self._out.read_text() or self.ended, f"{self._log}: no start", READY_S)
        assert not self.ended, self._log.read_text()
        self.target = ("127.0.0.1", int(json.loads(self._out.read_text())["grpc"].rpartition(":")[2]))

    @property
    def ended(self) -> bool:
        return self.process.poll() is not None

    @property
    def log(self) -> str:
        return self._log.read_text()

    def close(self) -> None:
        if not self.ended:
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()


class Switch(CountingRelay):
    """The way to the service. Slow, so that a run lasts for seconds: some 20 scans a second."""

    def _pump(self, source: socket.socket, sink: socket.socket, way: str) -> None:
        with Slow(source) as slow:
            super()._pump(slow if way == "up" else source, sink, way)

    def to(self, service: Service | None) -> None:
        """None: to nobody."""
        self.away = service is None
        self._target = self._target if service is None else service.target
        self.cut()


class Slow(socket.socket):
    """A socket that gives what it has a little later."""

    def __init__(self, of: socket.socket) -> None:
        super().__init__(fileno=os.dup(of.fileno()))

    def recv(self, *arguments: int) -> bytes:
        time.sleep(0.05)
        return super().recv(*arguments)


@dataclass
class Robot:
    """An agent of either release, in lockstep on the beginning of a recording: while nobody answers it waits."""

    name: str
    process: subprocess.Popen[bytes]
    log: Path

    def wait_end(self, within_s: float = RUN_S) -> str:
        assert self.process.wait(within_s) == 0, self.log.read_text()
        return self.log.read_text()


def robot(
    name: str,
    program: Sequence[str],
    recording: Path,
    server: str,
    folder: Path,
    max_scans: int | None = None,
    **uplink: Any,
) -> Robot:
    """It is called `name` and leaves its files in `folder`. uplink: settings of that section besides."""
    file = folder / f"{name}-robot.yaml"
    sensors = yaml.safe_load(recording.with_suffix(".yaml").read_text())
    file.write_text(yaml.safe_dump({**sensors, "robot": {"id": name}}))
    values: dict[str, Any] = {
        "robot": str(file),
        "server": server,
        "source": {"recording": str(recording), "max_scans": max_scans},
        "uplink": {"connect_timeout_s": RUN_S, "reconnect_timeout_s": RUN_S, **uplink},
        "output": {"dir": str(folder / name)},
        "metrics": {"port": None},
        "state_dir": str(folder / f"{name}-state"),
    }
    config = folder / f"{name}.yaml"
    config.write_text(json.dumps(values))
    log = folder / f"{name}.log"
    with log.open("w") as err:
        command = (*program, "run", "--config", str(config))
        return Robot(name, subprocess.Popen(command, stderr=err, stdout=subprocess.DEVNULL), log)


def sessions_of(target: tuple[str, int]) -> dict[str, pb.SessionInfo]:
    with grpc.insecure_channel(f"{target[0]}:{target[1]}") as channel:
        listed = rpc.SessionServiceStub(channel).List(pb.ListRequest(), timeout=30).sessions
    return {session.robot_id: session for session in listed}


def trajectory_of(target: tuple[str, int], session: pb.SessionInfo, file: Path) -> list[int]:
    """Writes it and returns the seq of every pose."""
    with grpc.insecure_channel(f"{target[0]}:{target[1]}") as channel:
        request = pb.TrajectoryRequest(session_id=session.session_id)
        chunks = rpc.SessionServiceStub(channel).Trajectory(request, timeout=60)
        poses = [pose for chunk in chunks for pose in chunk.poses]
    lines = []
    for stored in poses:
        p = stored.pose
        lines.append(tum_line(stored.stamp_ns, np.array([p.tx_m, p.ty_m, p.tz_m]), np.array([p.qx, p.qy, p.qz, p.qw])))
    file.write_text("".join(lines))
    return [stored.seq for stored in poses]
