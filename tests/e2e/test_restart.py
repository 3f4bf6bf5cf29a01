"""The map service is killed half way and started again: nothing is lost, nothing is mapped twice."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import threading
import time
from pathlib import Path

from splitslam.stack.process import free_port
from tests import tolerances as bars
from tests.e2e.commands import BIN, Run, splitslam


def start_service(store: Path, port: int = 0) -> tuple[subprocess.Popen[str], str]:
    """The service on loopback; returns it and its HOST:PORT once it listens.

    port: to start it again; 0: one that no outgoing connection takes while it is dead, as the robot's own might.
    """
    service = subprocess.Popen(
        [str(BIN / "map-service"), "serve", "--listen", f"127.0.0.1:{port or free_port()}", "--store", f"sqlite:///{store}",
         "--workers", "1", "--metrics-port", "0"],
        stdout=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip
    assert service.stdout is not None
    return service, json.loads(service.stdout.readline())["grpc"]


def kill(service: subprocess.Popen[str]) -> None:
    service.send_signal(signal.SIGKILL)
    service.wait()
    assert service.stdout is not None
    service.stdout.close()


def frames_stored(server: str) -> int:
    import grpc

    from splitslam.wire import session_pb2, session_pb2_grpc

    with grpc.insecure_channel(server) as channel:
        stub = session_pb2_grpc.SessionServiceStub(channel)
        sessions = stub.List(session_pb2.ListRequest(), timeout=30).sessions
    return max((s.durable_seq for s in sessions), default=0)


def test_a_killed_service_costs_no_scan_and_no_accuracy(yard1, yard1_as_it_is, tmp_path):
    recording, undisturbed = yard1, yard1_as_it_is
    truth = recording.with_suffix(".tum")

    service, server = start_service(tmp_path / "store.sqlite")
    outcome: list[subprocess.CompletedProcess[str]] = []
    out = tmp_path / "disturbed"
    options = ("--robot", str(recording.with_suffix(".yaml")), "--out", str(out), "--server", server)
    runner = threading.Thread(target=lambda: outcome.append(splitslam("run", str(recording), *options)))
    runner.start()
    try:
        deadline = time.monotonic() + 240
        while frames_stored(server) < 375:
            assert time.monotonic() < deadline, "the run never came half way"
            time.sleep(0.2)
        kill(service)
        service, _ = start_service(tmp_path / "store.sqlite", int(server.rpartition(":")[2]))
        runner.join(timeout=200)
        assert outcome, "the run did not complete"
        assert outcome[0].returncode == 0, outcome[0].stderr
    finally:
        if service.poll() is None:
            os.killpg(service.pid, signal.SIGKILL)
            kill(service)

    disturbed = Run(out, json.loads((out / "report.json").read_text()))
    assert disturbed.report["scans"] == undisturbed.report["scans"]
    stamps = [line.split()[0] for line in (out / "trajectory.tum").read_text().splitlines()]
    assert len(stamps) == len(set(stamps)) == disturbed.report["scans"]["mapped"]
    before, after = (r.evaluation(truth)["ate_m"] for r in (undisturbed, disturbed))
    assert after <= max(bars.RESTART_ATE_RATIO * before, before + bars.RESTART_ATE_M)
