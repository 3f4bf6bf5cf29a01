"""A drive through the locked door comes out as without it."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from splitslam.robot import load_robot
from splitslam.security.authority import Authority
from splitslam.security.identity import Identity
from splitslam.stack import Stack
from tests.e2e.commands import run

SCANS = 30
SAME = ("trajectory.tum", "online.tum", "odom.tum", "imu.tum", "map.ply")


def test_a_drive_through_mtls_to_two_replicas_has_the_same_result_as_one_without(
    shared_data: Path, tmp_path: Path
) -> None:
    recording, robot_file = shared_data / "yard1/yard1.bag", shared_data / "yard1/yard1.yaml"
    authority = Authority.make(tmp_path / "certs", "farm.example", 5)
    for role in ("service", "envoy"):
        authority.issue(Identity("farm.example", role), 5, ["127.0.0.1"])  # pyright: ignore[reportArgumentType]
    robot = authority.issue(Identity("farm.example", "robot", load_robot(robot_file).robot.id, "yard"), 5)
    tls = {"cert": str(robot.path), "key": str(robot.path.with_suffix(".key")), "ca": str(tmp_path / "certs/ca.pem")}
    config = tmp_path / "run.yaml"
    config.write_text(yaml.safe_dump({"edge": {"tls": tls}}))
    options = ("--max-scans", str(SCANS))
    plain = run(tmp_path / "plain", recording, *options).report
    with Stack(tmp_path / "stack", replicas=2, tls=authority.folder) as stack:
        options += ("--server", stack.address, "--config", str(config))
        locked = run(tmp_path / "locked", recording, *options).report
        assert stack.envoy.stat(f"listener.127.0.0.1_{stack.envoy.port}.ssl.handshake") >= 2
        assert all(replica.metrics()["splitslam_map_tls_handshakes_total"] >= 1 for replica in stack.replicas)
    for file in SAME:
        assert (tmp_path / "plain" / file).read_bytes() == (tmp_path / "locked" / file).read_bytes(), file
    assert plain["scans"]["mapped"] == locked["scans"]["mapped"] == SCANS
    assert plain["uplink"]["payload_sha256"] == locked["uplink"]["payload_sha256"]
    # TLS and its handshake: records of 22 bytes around each message, certificates once a connection
    assert 1.0 < locked["uplink"]["bytes"] / plain["uplink"]["bytes"] == pytest.approx(1.0, abs=0.1)
