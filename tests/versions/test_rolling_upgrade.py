"""An upgrade under way: services and agents of both releases, one store, runs that are handed from one to the other."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import grpc
import numpy as np
import pytest

from edge_agent.outputs import tum_line
from splitslam.evaluate import evaluate
from splitslam.tum import read_tum
from splitslam.wire import session_pb2 as pb
from splitslam.wire import session_pb2_grpc as rpc
from tests import tolerances as bars
from tests.edge_agent.relay import CountingRelay
from tests.versions import previous

SCANS = 200
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

    def wait_end(self) -> str:
        assert self.process.wait(RUN_S) == 0, self.log.read_text()
        return self.log.read_text()


def robot(name: str, program: Sequence[str], recording: Path, server: str, folder: Path) -> Robot:
    file = folder / f"{name}-robot.yaml"
    file.write_text(recording.with_suffix(".yaml").read_text().replace("id: yard1", f"id: {name}"))
    values = {
        "robot": str(file),
        "server": server,
        "source": {"recording": str(recording), "max_scans": SCANS},
        "uplink": {"connect_timeout_s": RUN_S, "reconnect_timeout_s": RUN_S},
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


@pytest.fixture
def ends() -> Iterator[list]:
    """What is to be closed at the end, whatever happens."""
    things: list = []
    yield things
    for thing in reversed(things):
        if isinstance(thing, Robot):
            thing.process.kill()
            thing.process.wait()
        else:
            thing.close()


def sessions_of(target: tuple[str, int]) -> dict[str, pb.SessionInfo]:
    with grpc.insecure_channel(f"{target[0]}:{target[1]}") as channel:
        listed = rpc.SessionServiceStub(channel).List(pb.ListRequest(), timeout=10).sessions
    return {session.robot_id: session for session in listed}


def trajectory_of(target: tuple[str, int], session: pb.SessionInfo, file: Path) -> list[int]:
    """Writes it and returns the seq of every pose."""
    with grpc.insecure_channel(f"{target[0]}:{target[1]}") as channel:
        request = pb.TrajectoryRequest(session_id=session.session_id)
        chunks = rpc.SessionServiceStub(channel).Trajectory(request, timeout=20)
        poses = [pose for chunk in chunks for pose in chunk.poses]
    lines = []
    for stored in poses:
        p = stored.pose
        lines.append(tum_line(stored.stamp_ns, np.array([p.tx_m, p.ty_m, p.tz_m]), np.array([p.qx, p.qy, p.qz, p.qw])))
    file.write_text("".join(lines))
    return [stored.seq for stored in poses]


def test_runs_go_on_while_the_services_are_upgraded_one_after_the_other(
    shared_data: Path, tmp_path: Path, ends: list
) -> None:
    """Old service, then the new one on the same store; an old and a new robot, both handed over in the middle."""
    recording, store = shared_data / "yard1" / "yard1.bag", tmp_path / "map.db"
    old = Service(previous.command("map_service"), store, tmp_path / "old.log")
    ends.append(old)
    old.wait_ready()
    way = Switch(old.target)
    ends.append(way)
    agents = {"old-robot": previous.command("edge_agent"), "new-robot": NEW_AGENT}
    robots = [robot(name, program, recording, way.address, tmp_path) for name, program in agents.items()]
    ends.extend(robots)

    def stored(service: Service, scans: int) -> bool:
        found = sessions_of(service.target)
        return len(found) == 2 and all(session.durable_seq >= scans for session in found.values())

    wait_until(lambda: stored(old, 20), "the runs never began", READY_S)
    way.to(None)  # both robots wait
    new = Service(NEW_SERVICE, store, tmp_path / "new.log")  # migrates the store under the old one
    ends.append(new)
    new.wait_ready()
    assert "store migrated" in new.log
    way.to(old)
    wait_until(lambda: stored(old, 50), "the old service does not go on with the new store", RUN_S)
    way.to(new)
    at_old = sessions_of(old.target)
    assert max(session.durable_seq for session in at_old.values()) < SCANS - 20, "too late to hand anything over"
    wait_until(lambda: stored(new, 110), "the new service does not take the runs over", RUN_S)
    way.to(old)  # a proxy may: the old one says no, and nothing comes to harm
    wait_until(lambda: old.log.count("tracker state of version 2, expected 1") >= 2, "the old one tries", RUN_S)
    way.to(new)
    for each in robots:
        each.wait_end()

    found = sessions_of(new.target)
    truth = read_tum(recording.with_suffix(".tum"))
    for name, session in found.items():
        assert session.finished
        file = tmp_path / f"{name}.tum"
        assert trajectory_of(new.target, session, file) == list(range(1, SCANS + 1)), "each scan once"
        error = evaluate(read_tum(file), truth)
        print(f"{name}: handed over after scan {at_old[name].durable_seq}, ATE {error.ate_m * 1e3:.1f} mm")
        assert error.ate_m <= bars.YARD1_ATE_M
    assert "frames are recoded" in (tmp_path / "new-robot.log").read_text()
