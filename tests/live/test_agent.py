"""The agent itself with `source: {live: ...}`, a capture at its pace, and a map service behind it."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import time
import urllib.request
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import yaml

from edge_agent.metrics import EdgeMetrics
from edge_agent.sources.live.clock import RunClock
from edge_agent.sources.live.sensor_clock import TimeBase
from splitslam.diagnose.agent import sensor_clocks
from splitslam.diagnose.checks import Verdict
from splitslam.pcap import datagrams
from splitslam.replay import send
from tests.e2e.commands import BIN

WAIT_S = 90.0  # for a process to get ready on a busy machine


@dataclass
class Agent:
    """A running agent: its ports by key, and the page of its metrics."""

    process: subprocess.Popen[str]
    ports: dict[str, int]
    metrics: str
    log: Path

    def metric(self, name: str) -> float:
        with urllib.request.urlopen(f"{self.metrics}", timeout=30) as page:
            (value,) = re.findall(rf"^{re.escape(name)} (\S+)$", page.read().decode(), re.MULTILINE)
        return float(value)


@pytest.fixture
def service(tmp_path: Path) -> Iterator[str]:
    command = [
        str(BIN / "map-service"),
        "serve",
        "--listen",
        "127.0.0.1:0",
        "--store",
        f"sqlite:///{tmp_path}/s.sqlite",
    ]
    with subprocess.Popen(
        [*command, "--workers", "1", "--metrics-port", "0"], stdout=subprocess.PIPE, text=True
    ) as rack:
        assert rack.stdout is not None
        yield json.loads(rack.stdout.readline())["grpc"]
        rack.terminate()


@pytest.fixture
def notifications(tmp_path: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(str(tmp_path / "notify"))
        listener.settimeout(WAIT_S)
        yield listener


@pytest.fixture
def agent(service: str, notifications: socket.socket, tmp_path: Path) -> Iterator[Agent]:
    robot = {"robot": {"id": "live"}, "lidar": {"model": "vlp16"}, "imu": None, "gnss": None}
    (tmp_path / "robot.yaml").write_text(yaml.safe_dump(robot))
    config = {
        "robot": str(tmp_path / "robot.yaml"),
        "server": service,
        "source": {"live": {"lidar": {"udp": {"host": "127.0.0.1", "port": 0, "position_port": 0}}, "silent_s": 1.0}},
        "state_dir": str(tmp_path / "state"),
        "metrics": {"port": 0},
        "log": {"format": "json", "level": "info"},
    }
    (tmp_path / "edge.yaml").write_text(yaml.safe_dump(config))
    log = tmp_path / "agent.log"
    with log.open("w") as stderr:
        process = subprocess.Popen(
            [str(BIN / "edge-agent"), "run", "--config", str(tmp_path / "edge.yaml")],
            stderr=stderr,
            text=True,
            env={**os.environ, "NOTIFY_SOCKET": str(tmp_path / "notify")},
        )
    try:
        heard(notifications, "READY=1")
        said = log.read_text()
        ports = {key: int(port) for port, key in re.findall(r"udp 127.0.0.1:(\d+) \((\w+)\)", said)}
        (metrics,) = re.findall(r"metrics on (\S+)", said)
        yield Agent(process, ports, metrics, log)
    finally:
        if process.poll() is None:
            process.kill()
        process.wait()


def heard(notifications: socket.socket, text: str) -> str:
    """The first notification with this text."""
    while text not in (message := notifications.recv(65536).decode()):
        pass
    return message


def wait_for(agent: Agent, name: str, at_least: float) -> None:
    deadline_s = time.monotonic() + WAIT_S
    while (value := agent.metric(name)) < at_least:
        assert agent.process.poll() is None
        assert time.monotonic() < deadline_s, f"{name}: {value}\n{agent.log.read_text()}"
        time.sleep(0.1)


def test_a_velodyne_on_the_wire_is_mapped_its_silence_is_said_and_a_signal_ends_the_agent(
    agent: Agent, notifications: socket.socket, shared_data: Path
):
    packets = list(datagrams(shared_data / "fixtures/velodyne/vlp16_gps.pcap"))
    send(packets, "127.0.0.1", {2368: agent.ports["port"], 8308: agent.ports["position_port"]})
    wait_for(agent, 'splitslam_edge_scans_total{result="mapped"}', 3)
    used = agent.metric('splitslam_edge_sensor_packets_total{result="used",sensor="lidar"}')
    start = agent.metric('splitslam_edge_sensor_packets_total{result="start",sensor="lidar"}')
    assert used + start == len(packets)
    assert agent.metric('splitslam_edge_sensor_packets_total{result="lost",sensor="lidar"}') == 0
    heard(notifications, "lidar silent for")
    wait_for(agent, 'splitslam_edge_sensor_losses_total{sensor="lidar"}', 1)
    agent.process.send_signal(signal.SIGTERM)
    assert agent.process.wait(WAIT_S) == 0
    said = [json.loads(line) for line in agent.log.read_text().splitlines() if line.startswith("{")]
    chosen = [line for line in said if line["event"] == "sensor clock chosen"]
    assert [(line["sensor"], line["taken_from"]) for line in chosen] == [("lidar", "gps")]


def test_diagnose_says_whose_time_the_sensors_are_in():
    clocks = RunClock("gps", 0.05, ["lidar"])
    for k in range(300):
        clocks.clock("lidar").heard(k * 10_000_000, k * 10_000_000, TimeBase.OWN)
        clocks.ready(clocks.clock("lidar"), k * 10_000_000)
    metrics = EdgeMetrics()
    assert sensor_clocks(metrics.page()) == []
    metrics.live_from(dict, dict, clocks)
    (found,) = sensor_clocks(metrics.page())
    assert (found.verdict, found.text.partition(";")[0]) == (Verdict.WARN, "lidar by host")


def test_the_agents_of_the_guide_are_configured_as_it_says(tmp_path: Path):
    from edge_agent.config import AgentConfig
    from splitslam.config import load
    from splitslam.robot import Robot
    from tests.conftest import ROOT

    blocks = re.findall(r"^```yaml\n(.*?)^```", (ROOT / "docs/sensors.md").read_text(), re.MULTILINE | re.DOTALL)
    loaded: list[Any] = []
    for block in blocks:
        (tmp_path / "block.yaml").write_text(block)
        loaded.append(load(AgentConfig if "source" in yaml.safe_load(block) else Robot, tmp_path / "block.yaml"))
    assert [type(one) for one in loaded] == [AgentConfig, Robot, AgentConfig, Robot]
    assert all(one.source.live is not None for one in loaded if isinstance(one, AgentConfig))
