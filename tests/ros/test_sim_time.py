"""Simulated time over DDS: what the agent says of itself is stamped by /clock, whoever publishes it and however."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.topic import Topic

from edge_agent.daemon import run_agent
from edge_agent.ros.codec import CLOCK, DIAGNOSTICS, Codec
from edge_agent.ros.connect import GraphClock
from edge_agent.ros.dds.graph import DdsGraph
from edge_agent.ros.dds.types import raw_type
from edge_agent.ros.graph import RELIABLE
from edge_agent.ros.settings import Ros2Settings
from edge_agent.sources.messages import stamp_ns
from tests.edge_agent.fake_service import FakeService
from tests.ros.dds import DOMAIN, cyclonedds_uri
from tests.ros.test_agent_in_a_graph import GRAPH, agent

CODEC = Codec("cdr")
SIMULATED_S = 4200
SECOND_NS = 1_000_000_000


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[int]]:
    """A simulator that says every 10 ms what time it is, best effort, as they do; [0]: the time, ns."""
    monkeypatch.setenv("CYCLONEDDS_URI", cyclonedds_uri())
    participant, over, now_ns = DomainParticipant(DOMAIN), threading.Event(), [SIMULATED_S * SECOND_NS]
    topic = Topic(participant, "rt/clock", raw_type(CLOCK, CODEC.types))
    best_effort = Qos(Policy.Reliability.BestEffort, Policy.DataRepresentation(use_cdrv0_representation=True))
    writer = DataWriter(participant, topic, best_effort)

    def tick() -> None:
        types = CODEC.types.types
        while not over.wait(0.01):
            now = types["builtin_interfaces/msg/Time"](*divmod(now_ns[0], SECOND_NS))
            writer.write(topic.data_type(CODEC.encode(types[CLOCK](now))))

    thread = threading.Thread(target=tick)
    thread.start()
    yield now_ns
    over.set()
    thread.join()


def test_the_graphs_clock_is_what_the_simulator_says_when_it_says_it(clock: list[int]):
    graph = DdsGraph(Ros2Settings(domain_id=DOMAIN))
    try:
        now_ns = GraphClock(graph, simulated=True)
        _until(lambda: now_ns() == SIMULATED_S * SECOND_NS)
        time.sleep(0.1)
        assert now_ns() == SIMULATED_S * SECOND_NS, "it stands while the simulator stands"
        clock[0] = 7 * SECOND_NS + 5
        _until(lambda: now_ns() == 7 * SECOND_NS + 5)
    finally:
        graph.close()


def test_an_agent_in_simulated_time_stamps_what_it_says_of_itself_by_it(shared_data: Path, clock: list[int]):
    heard: list[Any] = []
    graph = DdsGraph(Ros2Settings(domain_id=DOMAIN))
    graph.subscribe("/diagnostics", DIAGNOSTICS, RELIABLE, lambda raw: heard.append(CODEC.decode(raw, DIAGNOSTICS)))
    try:
        # the run is not over before the agent has found the simulator's clock
        in_time = lambda: SIMULATED_S * SECOND_NS in [stamp_ns(message.header) for message in list(heard)]  # noqa: E731
        with FakeService(pose_x_m=lambda seq: 0.0, welcome_when=in_time) as service:
            settings = {"ros2": {**GRAPH, "use_sim_time": True}, "diagnostics_hz": 10}
            run_agent(agent(shared_data, service.address, ros=settings), threading.Event())
    finally:
        graph.close()
    stamps_ns = [stamp_ns(message.header) for message in heard]
    assert SIMULATED_S * SECOND_NS in stamps_ns
    assert set(stamps_ns) <= {0, SIMULATED_S * SECOND_NS}, "0: before the first that the simulator said"


def _until(done: Any, timeout_s: float = 30.0) -> None:
    deadline_s = time.monotonic() + timeout_s
    while not done():
        assert time.monotonic() < deadline_s
        time.sleep(0.01)
