"""The agent as its unit runs it: ready when it is, alive while scans flow, restarted when it is stuck."""

from __future__ import annotations

import json
import re
import signal
import socket
import sys
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from tests.edge_agent.fake_service import FakeService
from tests.edge_agent.test_daemon import standing_service
from tests.systemd.cut import cut
from tests.systemd.manager import Manager

EXECUTABLES = Path(sys.executable).parent
WATCHDOG_S = 4.0
SCANS = 30
STUCK = Path(__file__).with_name("stuck")


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[Manager]:
    manager = Manager(tmp_path, EXECUTABLES, WATCHDOG_S)
    yield manager
    manager.close()


@pytest.fixture
def service() -> Iterator[FakeService]:
    with standing_service() as service:
        yield service


def configure(manager: Manager, server: str, recording: Path, robot: Path, **values: Any) -> None:
    config = {
        "robot": str(robot),
        "server": server,
        "source": {"recording": str(recording), "realtime": True, "max_scans": SCANS},
        "metrics": {"port": None},
        "uplink": {"connect_timeout_s": None},
        **values,
    }
    (manager.config / "edge.yaml").write_text(json.dumps(config))


def yard1(shared_data: Path) -> tuple[Path, Path]:
    return shared_data / "yard1" / "yard1.bag", shared_data / "yard1" / "yard1.yaml"


def test_it_is_ready_when_scans_can_come_and_alive_while_they_do(
    manager: Manager, service: FakeService, shared_data: Path
):
    bag, robot = yard1(shared_data)  # all of it: a busy machine would be at the end of a part before it is asked more
    source = {"recording": str(bag), "realtime": True}
    feed = {"socket": str(manager.runtime / "pose.sock")}
    configure(manager, service.address, bag, robot, source=source, feed=feed)
    manager.start()
    manager.until(lambda: bool(manager.with_field("WATCHDOG")), "no sign of life")
    (ready,) = manager.with_field("READY")
    assert manager.with_field("WATCHDOG")[0].at_s >= ready.at_s
    before = [status.partition(" ")[0] for status in manager.statuses()[:2]]
    assert before == ["compiling", "waiting"]
    assert manager.with_field("STATUS")[2] == ready
    assert (manager.runtime / "pose.sock").is_socket()
    manager.until(lambda: any("scans/s; " in text and "tracking" in text for text in manager.statuses()), "no status")

    configure(manager, service.address, bag, robot, source=source, log={"level": "info"}, site_id="yard")
    manager.send(signal.SIGHUP)
    manager.until(lambda: len(manager.with_field("READY")) == 2, "not reloaded")
    (reloading,), again = manager.with_field("RELOADING"), manager.with_field("READY")[1]
    assert int(reloading.fields["MONOTONIC_USEC"]) <= again.at_s * 1e6
    assert again.fields["STATUS"] == "reloaded; for a restart: feed.socket, site_id"

    manager.send(signal.SIGTERM)
    assert manager.wait() == 0
    assert not manager.aborted
    assert manager.with_field("STOPPING")
    signs_s = [said.at_s for said in manager.with_field("WATCHDOG")]
    assert max(b - a for a, b in pairwise(signs_s)) < WATCHDOG_S
    assert (manager.state / "run.json").is_file()
    assert list((manager.runtime / "raw").iterdir())
    assert not manager.restarts(0)


def test_a_stuck_pipeline_is_ended_with_its_stacks_in_the_log_and_the_next_start_continues_the_run(
    manager: Manager, service: FakeService, shared_data: Path
):
    configure(manager, service.address, *yard1(shared_data))
    manager.start(PYTHONPATH=str(STUCK), STUCK_AT_SCAN="10")
    code = manager.wait()
    assert manager.aborted
    assert code == -signal.SIGABRT
    assert manager.restarts(code)
    log = manager.log.read_text()
    assert "thread stuck: no more signs of life thread=pipeline " in log
    assert "in hold_on" in log  # where it was
    assert any("the pipeline is stuck since" in status for status in manager.statuses())

    manager.start(PYTHONPATH=str(STUCK))
    assert manager.wait() == 0, manager.log.read_text()[-2000:]
    assert re.search(r"run continued run_id=\S+ seq=9\b", manager.log.read_text())
    assert service.finished
    assert service.holes == []


def test_silent_sensors_are_said_and_are_no_reason_to_end(manager: Manager, service: FakeService, shared_data: Path):
    bag, robot = yard1(shared_data)
    recording = cut(
        bag, manager.root / "cut.bag", keep_s=((0.0, 1.0), (WATCHDOG_S + 3.5, 100.0)), until_s=WATCHDOG_S + 4.5
    )
    configure(manager, service.address, recording, robot)
    manager.start()
    assert manager.wait() == 0, manager.log.read_text()[-2000:]
    assert not manager.aborted
    log = manager.log.read_text()
    assert log.count("no scans silent_s=") == 1
    assert log.count("scans come again after_s=") == 1
    assert any(status.startswith("no scan for ") for status in manager.statuses())
    assert service.finished


def test_the_map_service_is_ready_when_robots_can_connect_and_says_when_it_goes(tmp_path: Path):
    manager = Manager(tmp_path, EXECUTABLES, WATCHDOG_S, "map-service")
    (manager.config / "map.yaml").write_text(
        json.dumps({"listen": "127.0.0.1:0", "store": "sqlite:///map.db", "metrics": {"port": None}, "workers": 1})
    )
    try:
        manager.start()
        manager.until(lambda: len(manager.with_field("WATCHDOG")) > 3, "no sign of life")
        (ready,) = manager.with_field("READY")
        host, _, port = ready.fields["STATUS"].removeprefix("listening on ").rpartition(":")
        with socket.create_connection((host, int(port)), timeout=30):
            pass
        assert (manager.state / "map.db").is_file()
        manager.send(signal.SIGTERM)
        assert manager.wait() == 0, manager.log.read_text()[-2000:]
        assert manager.with_field("STOPPING")
        assert not manager.aborted
    finally:
        manager.close()


def test_a_bad_configuration_ends_it_for_good_before_it_is_ready(manager: Manager, shared_data: Path):
    configure(manager, "127.0.0.1:1", *yard1(shared_data), uplnik={})
    manager.start()
    code = manager.wait()
    assert not manager.restarts(code)
    assert manager.log.read_text().count("\n") == 1
    assert "uplnik: unknown key; nearest known: uplink" in manager.log.read_text()
    assert not manager.with_field("READY")
