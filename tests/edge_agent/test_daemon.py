"""The whole agent on a real recording, against a service that only answers: the robot stands in the first seconds."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from edge_agent.config import AgentConfig
from edge_agent.daemon import run_agent
from splitslam.config import validate
from splitslam.errors import InputError
from splitslam.stack.process import free_port, wait_until
from tests.conftest import ROOT
from tests.edge_agent.fake_service import FakeService, Fault

SCANS = 12


def settings(data: Path, server: str, out: Path, **source: Any) -> dict[str, Any]:
    return {
        "robot": str(data / "yard1" / "yard1.yaml"),
        "server": server,
        "source": {"recording": str(data / "yard1" / "yard1.bag"), "max_scans": SCANS, **source},
        "output": {"dir": str(out)},
        "metrics": {"port": None},
    }


def run(values: dict[str, Any]) -> dict[str, Any]:
    config = validate(AgentConfig, values, "test")
    run_agent(config, threading.Event())
    assert config.output.dir is not None
    return json.loads((config.output.dir / "edge.json").read_text())


def standing_service(**fields: Any) -> FakeService:
    return FakeService(pose_x_m=lambda seq: 0.0, **fields)


def test_a_run_maps_every_scan_and_writes_what_the_conventions_say(shared_data: Path, tmp_path: Path):
    with standing_service() as service:
        report = run(settings(shared_data, service.address, tmp_path / "out"))
    assert report["scans"] == {"read": SCANS, "sent": SCANS, "mapped": SCANS, "dropped": 0}
    assert service.finished
    assert service.holes == []
    assert service.hellos[0].lockstep
    assert report["uplink"]["bytes"] > report["uplink"]["payload_bytes"] == sum(report["bytes_by_scan"])
    assert report["uplink"]["raw_kbps"] > report["uplink"]["native_kbps"] > report["uplink"]["kbps"]
    for key in ("deskew", "features", "encode", "total"):
        assert set(report["edge_ms"][key]) == set(report["edge_wall_ms"][key]) == {"mean", "std", "p50", "p99", "max"}
    assert report["cpu_ms_per_scan"]["edge"] > 0
    assert report["cpu_ms_per_scan"]["reader"] > 0
    assert set(report["jumps"]) == {"odom_max_m", "odom_max_deg", "map_count", "map_max_m"}
    stamps = [line.split()[0] for line in (tmp_path / "out" / "online.tum").read_text().splitlines()]
    assert [int(stamp.replace(".", "")) for stamp in stamps] == report["stamps_ns_by_scan"]
    assert len((tmp_path / "out" / "odom.tum").read_text().splitlines()) == SCANS
    imu_stamps = np.loadtxt(tmp_path / "out" / "imu.tum")[:, 0]
    assert np.median(np.diff(imu_stamps)) == pytest.approx(1 / 500, rel=0.1)


def test_two_runs_are_identical_even_when_the_stream_of_one_breaks(shared_data: Path, tmp_path: Path):
    outputs = []
    for name, faults in (("a", {}), ("b", {5: Fault.KILL_AFTER, 9: Fault.FORGET})):
        with standing_service(faults=faults, commit_every=3) as service:
            report = run(settings(shared_data, service.address, tmp_path / name))
        files = [(tmp_path / name / f).read_bytes() for f in ("online.tum", "odom.tum", "imu.tum")]
        outputs.append((report["uplink"]["payload_sha256"], *files))
    assert outputs[0] == outputs[1]


def test_by_the_clock_no_scan_is_dropped_and_the_run_takes_as_long_as_the_recording(shared_data: Path, tmp_path: Path):
    with standing_service() as service:
        report = run(settings(shared_data, service.address, tmp_path / "out", realtime=True))
    assert report["scans"]["mapped"] == SCANS
    assert not service.hellos[0].lockstep
    assert 0.9 <= report["wall_s"] <= report["recording_s"] + 10.0


def test_an_unreachable_server_leaves_nothing_behind(shared_data: Path, tmp_path: Path):
    port = free_port()
    values = settings(shared_data, f"127.0.0.1:{port}", tmp_path / "out") | {"uplink": {"connect_timeout_s": 0.4}}
    with pytest.raises(InputError, match=rf"^server 127.0.0.1:{port}: expected a map service there"):
        run(values)
    assert not (tmp_path / "out").exists()


def test_a_robot_that_starts_out_of_reach_maps_its_first_scans_when_the_service_is_there(
    shared_data: Path, tmp_path: Path
):
    service = standing_service()
    with service:
        pass  # take a port and free it again
    values = settings(shared_data, service.address, tmp_path / "out", realtime=True)
    values |= {"state_dir": str(tmp_path / "state")}

    def begin_late() -> None:
        deadline_s = time.monotonic() + 60.0
        while not any(file.stat().st_size for file in tmp_path.glob("state/spool/*/*.seg")):
            if time.monotonic() > deadline_s:
                return  # the run will never end without the service: the report below says so
            time.sleep(0.01)
        service.start()

    begun = threading.Thread(target=begin_late)
    begun.start()
    report = run(values | {"uplink": {"connect_timeout_s": None, "reconnect_timeout_s": 60.0}})
    service.stop()
    begun.join()
    assert report["scans"] == {"read": SCANS, "sent": SCANS, "mapped": SCANS, "dropped": 0}
    assert service.holes == []
    assert service.finished


def agent(values: dict[str, Any], folder: Path) -> subprocess.Popen[str]:
    (folder / "agent.yaml").write_text(json.dumps(values))
    command = [sys.executable, "-m", "tests.edge_agent.unhurried", "run", "--config", str(folder / "agent.yaml")]
    return subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_stopped_agent_leaves_its_session_open_and_the_next_one_continues_it(
    shared_data: Path, tmp_path: Path, number: signal.Signals
):
    with standing_service() as service:
        by_the_clock = {"realtime": True, "queue_scans": 5 * SCANS}
        values = settings(shared_data, service.address, tmp_path / "out", max_scans=5 * SCANS, **by_the_clock)
        values |= {"state_dir": str(tmp_path / "state")}
        process = agent(values, tmp_path)
        wait_until(lambda: len(service.applied) >= 5, 120.0, "the first answers")
        os.kill(process.pid, number)
        _, stderr = process.communicate(timeout=120)
        assert (process.returncode, stderr) == (0, "")
        first = json.loads((tmp_path / "out" / "edge.json").read_text())
        assert first["stopped"]
        assert not service.finished
        applied = max(service.applied)

        process = agent(values | {"source": values["source"] | {"realtime": False}}, tmp_path)
        _, stderr = process.communicate(timeout=120)
        assert process.returncode == 0, stderr
        assert re.search(rf"run continued run_id=\S+ seq={applied}\b", stderr)
    assert service.finished
    assert service.holes == []
    assert len({hello.run_id for hello in service.hellos}) == 1
    stamps_ns = [answer.stamp_ns for _, answer in sorted(service.applied.items())]
    assert len(stamps_ns) == 5 * SCANS
    assert (np.diff(stamps_ns) > 0).all()
    assert not (tmp_path / "state" / "run.json").exists()


def test_progress_lines_and_errors_go_where_a_caller_looks_for_them(shared_data: Path, tmp_path: Path):
    with standing_service() as service:
        values = settings(shared_data, service.address, tmp_path / "out")
        values["output"]["progress"] = True
        process = agent(values, tmp_path)
        stdout, _ = process.communicate(timeout=120)
    lines = [json.loads(line) for line in stdout.splitlines()]
    assert lines[0] == {"event": "start", "scans": SCANS}
    assert lines[-2:] == [{"event": "scan", "read": SCANS, "mapped": SCANS}, {"event": "end"}]

    values["feed"] = {"socket": str(tmp_path / "nowhere/pose.sock")}
    process = agent(values, tmp_path)
    _, stderr = process.communicate(timeout=120)
    assert process.returncode == 2
    expected = "expected a path where a Unix socket can be made"
    assert stderr == f"feed.socket {tmp_path}/nowhere/pose.sock: {expected}\n", "not a word of gRPC's"

    process = agent(values | {"uplnk": {}}, tmp_path)
    stdout, stderr = process.communicate(timeout=120)
    assert process.returncode == 2
    assert stdout == ""
    assert stderr == f"{tmp_path}/agent.yaml: uplnk: unknown key; nearest known: uplink\n"


def test_print_config_shows_what_the_environment_changed(shared_data: Path, tmp_path: Path):
    (tmp_path / "agent.yaml").write_text(json.dumps(settings(shared_data, "127.0.0.1:1", tmp_path / "out")))
    command = [sys.executable, "-m", "edge_agent", "run", "--config", str(tmp_path / "agent.yaml"), "--print-config"]
    environment = {**os.environ, "SPLITSLAM_EDGE__UPLINK__MAX_KBPS": "120"}
    shown = subprocess.run(command, env=environment, capture_output=True, text=True, check=True, timeout=60).stdout
    assert "max_kbps: 120" in shown
    assert not (tmp_path / "out").exists()
