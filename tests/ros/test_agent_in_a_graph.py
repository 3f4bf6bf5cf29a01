"""The whole agent in a graph of its own making, on loopback, against a service that only answers."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from edge_agent.config import AgentConfig
from edge_agent.daemon import run_agent
from edge_agent.ros.codec import DIAGNOSTICS, TF, Codec
from edge_agent.ros.dds.graph import DdsGraph
from edge_agent.ros.graph import RELIABLE, TRANSFORMS
from edge_agent.ros.settings import Ros2Settings
from splitslam.config import validate
from splitslam.errors import InputError
from splitslam.stack.process import wait_until
from tests.edge_agent.fake_service import FakeService
from tests.ros.dds import DOMAIN, cyclonedds_uri

GRAPH = {"via": "cyclonedds", "domain_id": DOMAIN}
SCANS = 12


@dataclass
class Heard:
    """tf: what is said on /tf. connected: the agent knows of both readers, which it has heard of in their order."""

    tf: list[Any] = field(default_factory=list)
    connected: threading.Event = field(default_factory=threading.Event)

    def service(self) -> FakeService:
        """Lets the run begin when nothing of it can be missed any more, however slowly a graph comes together."""
        return FakeService(pose_x_m=lambda seq: 0.0, welcome_when=self.connected.is_set)


@pytest.fixture
def heard(monkeypatch: pytest.MonkeyPatch) -> Iterator[Heard]:
    monkeypatch.setenv("CYCLONEDDS_URI", cyclonedds_uri())
    heard, codec = Heard(), Codec("cdr")
    graph = DdsGraph(Ros2Settings(domain_id=DOMAIN))
    graph.subscribe("/tf", TF, TRANSFORMS, lambda raw: heard.tf.append(codec.decode(raw, TF)))
    graph.subscribe("/diagnostics", DIAGNOSTICS, RELIABLE, lambda _: heard.connected.set())
    yield heard
    graph.close()


def agent(data: Path, server: str, **sections: Any) -> AgentConfig:
    yard1 = data / "yard1"
    values = {
        "robot": str(yard1 / "yard1.yaml"),
        "server": server,
        "source": {"recording": str(yard1 / "yard1.bag"), "max_scans": SCANS, "realtime": True},
        "metrics": {"port": None},
    }
    return validate(AgentConfig, values | sections, "test")


def test_sensors_from_elsewhere_can_be_published_to_a_graph(shared_data: Path, heard: Heard):
    with heard.service() as service:
        run_agent(agent(shared_data, service.address, ros={"ros2": GRAPH}), threading.Event())
    wait_until(lambda: len(heard.tf) >= 40, 30.0, "of 50 a second")
    assert all([t.child_frame_id for t in message.transforms] == ["odom", "base_link"] for message in heard.tf)


def test_without_an_imu_the_poses_of_the_scans_are_published(shared_data: Path, heard: Heard):
    with heard.service() as service:
        config = agent(shared_data, service.address, ros={"ros2": GRAPH}, disable=["imu"])
        run_agent(config, threading.Event())
    wait_until(lambda: len(heard.tf) >= SCANS - 3, 30.0, "a pose of each scan")
    assert len(heard.tf) <= SCANS


def test_what_shall_not_be_published_is_not(shared_data: Path, heard: Heard):
    with FakeService(pose_x_m=lambda seq: 0.0) as service:
        config = agent(shared_data, service.address, ros={"ros2": GRAPH, "publish": False})
        run_agent(config, threading.Event())
    assert heard.tf == []
    assert not heard.connected.is_set()


def test_an_agent_that_waits_for_its_lidar_ends_at_once_and_well_when_it_is_stopped(
    shared_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("CYCLONEDDS_URI", cyclonedds_uri())
    stop = threading.Event()
    config = agent(shared_data, "127.0.0.1:1", source={"ros2": GRAPH}, output={"dir": str(tmp_path / "out")})
    threading.Timer(0.3, stop.set).start()
    began_s = time.monotonic()
    run_agent(config, stop)
    assert time.monotonic() - began_s < 30.0
    assert not (tmp_path / "out").exists()


def test_one_agent_is_in_one_graph(shared_data: Path):
    with pytest.raises(InputError, match=r"expected only when the source is not in a ROS graph itself"):
        agent(shared_data, "127.0.0.1:1", source={"ros2": GRAPH}, ros={"ros1": {}})
    with pytest.raises(InputError, match="expected at most one of ros1 and ros2"):
        agent(shared_data, "127.0.0.1:1", ros={"ros1": {}, "ros2": {}})
    with pytest.raises(InputError, match=r"source.ros2.domain: unknown key; nearest known: source.ros2.domain_id"):
        agent(shared_data, "127.0.0.1:1", source={"ros2": {"domain": 3}})
