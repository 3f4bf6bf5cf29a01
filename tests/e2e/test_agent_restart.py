"""The agent is killed while the network is away, and starts again before it is back: every scan is mapped, once."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import grpc
import numpy as np
import pytest

from splitslam.evaluate import evaluate
from splitslam.tum import read_tum, tum_line
from splitslam.wire import session_pb2 as pb
from splitslam.wire import session_pb2_grpc as rpc
from tests import tolerances as bars
from tests.conftest import ROOT
from tests.e2e.test_restart import kill, start_service
from tests.edge_agent.relay import CountingRelay

SCANS = 120
IN_FLIGHT = 16  # frames that had left when the network went away


def agent(folder: Path, recording: Path, server: str, out: str) -> subprocess.Popen[str]:
    values = {
        "robot": str(recording.with_suffix(".yaml")),
        "server": server,
        "source": {"recording": str(recording), "realtime": True, "max_scans": SCANS, "queue_scans": 1000},
        "output": {"dir": str(folder / out)},
        "metrics": {"port": None},
        "state_dir": str(folder / "state"),
    }
    config = folder / f"{out}.yaml"
    config.write_text(json.dumps(values))
    command = [sys.executable, "-m", "tests.edge_agent.unhurried", "run", "--config", str(config)]
    return subprocess.Popen(command, cwd=ROOT, stderr=subprocess.PIPE, text=True)


def wait_until(condition: Callable[[], bool], what: str, within_s: float = 60.0) -> None:
    deadline_s = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < deadline_s, what
        time.sleep(0.05)


def spooled_bytes(folder: Path) -> int:
    return sum(file.stat().st_size for file in folder.glob("state/spool/*/*.seg"))


def test_a_killed_agent_and_a_network_that_is_away_cost_no_scan(shared_data: Path, tmp_path: Path):
    recording = shared_data / "yard1" / "yard1.bag"
    service, server = start_service(tmp_path / "store.sqlite")
    host, _, port = server.rpartition(":")
    relay = CountingRelay((host, int(port)))
    processes = [agent(tmp_path, recording, relay.address, "first")]
    try:
        with grpc.insecure_channel(server) as channel:
            sessions = rpc.SessionServiceStub(channel)

            def stored() -> int:
                return max((s.durable_seq for s in sessions.List(pb.ListRequest(), timeout=30).sessions), default=0)

            wait_until(lambda: stored() >= 30, "the run never began")
            relay.away = True
            relay.cut()
            known, before = stored() + IN_FLIGHT, spooled_bytes(tmp_path)
            wait_until(lambda: spooled_bytes(tmp_path) > before + 60 * 1000, "nothing came to the disk")
            processes[0].send_signal(signal.SIGKILL)  # two seconds of frames, of which only the disk knows
            processes[0].wait()
            left = spooled_bytes(tmp_path)

            processes.append(agent(tmp_path, recording, relay.address, "second"))
            wait_until(lambda: spooled_bytes(tmp_path) > left + 20 * 1000, "it did not go on without the network")
            assert stored() <= known
            relay.away = False
            _, stderr = processes[1].communicate(timeout=200)
            assert processes[1].returncode == 0, stderr
            assert "run continued" in stderr
            (session,) = sessions.List(pb.ListRequest(), timeout=30).sessions
            chunks = sessions.Trajectory(pb.TrajectoryRequest(session_id=session.session_id))
            poses = [pose for chunk in chunks for pose in chunk.poses]
    finally:
        for process in processes:
            if process.poll() is None:
                process.kill()
            process.wait()
            assert process.stderr is not None
            process.stderr.close()
        relay.close()
        kill(service)

    report = json.loads((tmp_path / "second" / "edge.json").read_text())
    assert session.finished
    stamps_ns = np.array([pose.stamp_ns for pose in poses])
    assert [pose.seq for pose in poses] == list(range(1, SCANS + 1))
    assert len(stamps_ns) == SCANS
    assert np.diff(stamps_ns).min() > 0.9e8
    assert np.diff(stamps_ns).max() < 1.1e8  # no scan was left out where one agent follows the other
    assert report["continued"]["after_scan"] > known
    assert report["scans"]["dropped"] == 0
    assert report["dropped_by_reason"] == {}
    assert report["scans"]["mapped"] == SCANS - report["continued"]["after_scan"]
    assert not list((tmp_path / "state" / "spool").glob("*-*"))

    lines = [
        tum_line(p.stamp_ns, np.array([p.pose.tx_m, p.pose.ty_m, p.pose.tz_m]),
                 np.array([p.pose.qx, p.pose.qy, p.pose.qz, p.pose.qw]))
        for p in poses
    ]  # fmt: skip
    (tmp_path / "trajectory.tum").write_text("".join(lines))
    result = evaluate(read_tum(tmp_path / "trajectory.tum"), read_tum(recording.with_suffix(".tum")))
    print(f"ATE {result.ate_m * 1e3:.1f} mm, continued after scan {report['continued']}")
    assert result.ate_m == pytest.approx(0.0, abs=bars.HARMED_ATE_M)
