"""One bundle of a robot that runs, of one that was killed, of one that never started; and no secret in any."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from edge_agent.raw_ring import RawStream
from edge_agent.sources.bag import Bag, stream_of
from splitslam.diagnose.agent import _rates
from splitslam.diagnose.raw import RawPart
from tests.edge_agent.test_daemon import standing_service
from tests.systemd.manager import Manager
from tests.typed import typed

EXECUTABLES = Path(sys.executable).parent
SCANS = 40
SECRETS = {
    "FLEET_TOKEN": "tok-4f1c9aa0e7",
    "STORE_PASSWORD": "correct-horse",
    "LOGGED": "c0ffee.bearer.0123456789",
    "KEY": "MIGkAgEBBDDsecretpemline",
}


def diagnose(*arguments: str | Path, **environment: str) -> dict[str, Any]:
    done = subprocess.run(
        [str(EXECUTABLES / "splitslam"), "diagnose", *map(str, arguments), "--json"],
        capture_output=True,
        text=True,
        timeout=200,
        env=dict(os.environ) | environment,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def verdicts(summary: dict[str, Any], part: str = "edge") -> dict[str, tuple[str, str]]:
    return {check["name"]: (check["verdict"], check["text"]) for check in summary[part]}


def contents(bundle: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(bundle) as file:
        return {name: file.read(name) for name in file.namelist()}


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[Manager]:
    manager = Manager(tmp_path, EXECUTABLES)
    yield manager
    manager.close()


def test_a_robot_alive_and_killed_is_told_of_and_its_last_scans_run_again(
    manager: Manager, shared_data: Path, tmp_path: Path
):
    recording = shared_data / "yard1" / "yard1.bag"
    with standing_service() as service:
        config = {
            "robot": str(recording.with_suffix(".yaml")),
            "server": service.address,
            "source": {"recording": str(recording), "realtime": True, "max_scans": 10 * SCANS},
            "metrics": {"port": 0},
            "raw_ring": {"seconds": 2.0},
            "uplink": {"connect_timeout_s": None},
        }
        (manager.config / "edge.yaml").write_text(json.dumps(config))
        manager.start(FLEET_TOKEN=SECRETS["FLEET_TOKEN"])
        manager.until(lambda: any("scans/s" in status for status in manager.statuses()), "no scans")
        with manager.log.open("a") as log:  # as a careless line of somebody else's would
            log.write(f"told {SECRETS['FLEET_TOKEN']}\nAuthorization: Bearer {SECRETS['LOGGED']}\n")
            log.write(f"-----BEGIN PRIVATE KEY-----\n{SECRETS['KEY']}\n-----END PRIVATE KEY-----\n")
        ring = manager.runtime / "raw"
        manager.until(lambda: sum(file.stat().st_size for file in ring.iterdir()) > 3_000_000, "no raw scans")
        alive = diagnose("--edge", manager.state, "--out", tmp_path / "alive.zip", "--log", manager.log)
        manager.send(signal.SIGKILL)
        manager.wait()
        dead = diagnose("--edge", manager.state, "--out", tmp_path / "dead.zip")

    found = verdicts(alive)
    for name in ("agent", "configuration", "kernels", "spool", "service", "metrics", "logs", "raw scans"):
        assert found[name][0] == "ok", found[name]
    assert found["lidar rate"][0] == found["imu rate"][0] == "ok", found
    assert set(verdicts(alive, "machine")) == {"clock", "memory"}
    found = verdicts(dead)
    assert found["agent"][0] == "fail"
    assert found["metrics"][0] == "fail"
    assert found["raw scans"][0] == "ok"

    for name in ("alive.zip", "dead.zip"):
        files = contents(tmp_path / name)
        assert json.loads(files["versions.json"])["packages"]["numba"]
        assert b"seconds: 2.0" in files["edge/configuration/effective.yaml"]
        assert (tmp_path / name).stat().st_mode & 0o077 == 0
    files = contents(tmp_path / "alive.zip")
    assert b"splitslam_edge_scans_total" in files["edge/metrics.txt"]
    assert b"told <redacted>" in files["edge/logs/edge-agent.log"]  # known from the environment of the process
    assert not [name for name, text in files.items() if any(secret.encode() in text for secret in SECRETS.values())]

    with zipfile.ZipFile(tmp_path / "dead.zip") as file:
        file.extractall(tmp_path / "dead")
    raw, robot = tmp_path / "dead/edge/raw/raw.bag", tmp_path / "dead/edge/robot.yaml"
    out = tmp_path / "again"
    command = [EXECUTABLES / "splitslam", "run", raw, "--robot", robot, "--out", out, "--json"]
    again = subprocess.run(command, capture_output=True, text=True, timeout=200)
    assert again.returncode == 0, again.stderr
    report = json.loads(again.stdout)
    assert report["scans"]["mapped"] == report["scans"]["read"] >= 19
    assert 1.5 < report["recording_s"] <= 2.1


def test_no_secret_of_configuration_environment_or_log_is_in_a_bundle(tmp_path: Path):
    state, config, map_config, log = (tmp_path / name for name in ("state", "edge.yaml", "map.yaml", "agent.log"))
    state.mkdir()
    # A key that the agent does not know: it cannot start, which is when a bundle is asked for.
    values = {"robot": "r.yaml", "source": {"recording": "x.bag"}, "server": "127.0.0.1:1"}
    config.write_text(json.dumps(values | {"cloud": {"api_key": SECRETS["FLEET_TOKEN"]}}))
    password = SECRETS["STORE_PASSWORD"]
    map_config.write_text(f"store: postgresql://splitslam:{password}@127.0.0.1:1/maps\nmetrics: {{port: null}}\n")
    log.write_text(
        f"login with {SECRETS['FLEET_TOKEN']} and {password}\nAuthorization: Bearer {SECRETS['LOGGED']}\n"
        f"-----BEGIN PRIVATE KEY-----\n{SECRETS['KEY']}\n-----END PRIVATE KEY-----\n"
    )
    programs = tmp_path / "bin"
    programs.mkdir()
    journal = programs / "journalctl"  # of a machine that has one
    journal.write_text(f'#!/bin/sh\necho "journal of $1: {SECRETS["FLEET_TOKEN"]}, $SOME_SECRET"\n')
    journal.chmod(0o755)
    unit_file = tmp_path / "environment"
    unit_file.write_text("# of the unit\nUPLINK_TOKEN='of the unit file'\n")
    systemctl = programs / "systemctl"  # the agent is dead: what it was given, its unit says
    lines = (f"EnvironmentFiles={unit_file} (ignore_errors=no)", 'Environment=LANG=C "CLOUD_TOKEN=of the unit"')
    systemctl.write_text("#!/bin/sh\n" + "".join(f"echo '{line}'\n" for line in (*lines, "ActiveState=failed")))
    systemctl.chmod(0o755)
    with log.open("a") as file:
        file.write("tokens of the unit file, of the unit\n")
    out = tmp_path / "bundle.zip"
    summary = diagnose(
        *("--edge", state, "--config", config, "--map", map_config, "--log", log, "--out", out),
        PATH=f"{programs}:{os.environ['PATH']}",
        SOME_SECRET="only-in-the-environment",
        SPLITSLAM_OPERATOR_TOKEN="only-in-the-environment-2",
    )
    found = verdicts(summary)
    assert found["agent"][0] == "warn"
    assert found["configuration"][0] == "fail"
    assert found["configuration"][1].startswith(f"{config}: cloud: unknown key")
    assert verdicts(summary, "map")["store"][0] == "fail"
    files = contents(out)
    assert b"journal of --unit=edge-agent: <redacted>, <redacted>" in files["edge/logs/journal.txt"]
    assert b"login with <redacted> and <redacted>" in files["edge/logs/agent.log"]
    assert b"tokens <redacted>, <redacted>" in files["edge/logs/agent.log"]
    secrets = (*SECRETS.values(), "only-in-the-environment", "of the unit")
    leaks = [(name, secret) for name, text in files.items() for secret in secrets if secret.encode() in text]
    assert not leaks
    assert not [secret for secret in secrets if secret in json.dumps(summary)]


def test_a_sensor_that_is_too_slow_is_seen_in_the_raw_messages():
    part = RawPart(None, 10.0, {"/points": 101, "/imu": 2001})
    robot = {
        "lidar": {"topic": "/points", "rate_hz": 10},
        "imu": {"topic": "/imu", "rate_hz": 500},
        "gnss": {"topic": "/gps"},
    }
    found = {check.name: (check.verdict.value, check.text) for check in _rates(part, robot)}
    assert found == {
        "lidar rate": ("ok", "/points: 10.0 a second"),
        "imu rate": ("fail", "/imu: 200.0 a second, expected 500"),
        "gnss rate": ("warn", "/gps: nothing"),
    }


def test_a_robot_elsewhere_gives_its_metrics_and_one_that_is_not_there_is_said(tmp_path: Path):
    summary = diagnose("--edge", "http://127.0.0.1:1", "--out", tmp_path / "bundle.zip")
    ((name, (verdict, text)),) = verdicts(summary).items()
    assert (name, verdict) == ("metrics", "fail")
    assert text.startswith("http://127.0.0.1:1/metrics: ")


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (("--edge", "{empty}"), "--edge {empty}: no agent.json there, and {missing}: cannot read"),
        (("--edge", "http://127.0.0.1:1", "--out", "/proc/x/b.zip"), "--out /proc/x/b.zip: "),
        (("--map", "{missing}"), "{missing}: cannot read"),
    ],
)
def test_what_cannot_be_diagnosed_is_one_line_and_leaves_nothing(arguments: tuple[str, ...], line: str, tmp_path: Path):
    names = {"empty": str(tmp_path / "empty"), "missing": str(tmp_path / "no.yaml")}
    (tmp_path / "empty").mkdir()
    words = [word.format(**names) for word in arguments]
    if arguments[0] == "--edge":
        words += ["--config", names["missing"]]
    exit_code, _, err = typed("splitslam", "diagnose", *words, folder=tmp_path)
    assert exit_code == 2
    assert err.startswith(line.format(**names)), err
    assert err.count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["empty"]


def test_a_folder_without_an_agent_and_no_configuration_named_is_one_line(tmp_path: Path):
    exit_code, _, err = typed("splitslam", "diagnose", "--edge", tmp_path, "--out", tmp_path / "b.zip")
    assert exit_code == 2
    assert err.startswith(f"--edge {tmp_path}: no agent.json there, and ")
    assert err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_a_recordings_topics_are_known_to_the_ring_by_value(shared_data: Path):
    """Two agents, or one before and after a restart, mean the same stream."""
    streams = []
    for _ in range(2):
        with Bag(shared_data / "yard1" / "yard1.bag") as bag:
            streams.append([stream_of(connection) for connection in bag.connections])
    assert streams[0] == streams[1]
    assert isinstance(streams[0][0], RawStream)
    assert {stream.encoding for stream in streams[0]} == {"ros1"}
