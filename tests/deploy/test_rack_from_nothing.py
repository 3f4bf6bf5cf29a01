"""What docker-compose.yml says, run as processes: from nothing to a robot whose scans are mapped."""

from __future__ import annotations

import json
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from splitslam.stack.process import StackProcess, wait_until
from tests import tolerances as bars
from tests.deploy.guide import commands, type_in
from tests.deploy.native_rack import NativeRack, fill_kernels

SCANS = 40
_FIRST_S, _RUN_S = 90.0, 60.0


@pytest.fixture
def folder() -> Iterator[Path]:
    """A short name: paths of Unix sockets end after 107 characters. Others than root come through."""
    made = Path(tempfile.mkdtemp(prefix="rack-"))
    made.chmod(0o755)
    yield made
    shutil.rmtree(made)


def certificates(folder: Path) -> Path:
    """The steps of docs/server.md, for a robot called yard1 and a rack on this machine."""
    script = commands("Certificates").replace("rover-7", "yard1").replace("rack.farm.example", "127.0.0.1")
    type_in(script, folder)
    return folder / "tls"


def robot(recording: Path, server: str, folder: Path) -> StackProcess:
    """An agent that is switched on with the rack and waits for it."""
    certs = folder / "certs"
    config = {
        "robot": str(recording.with_suffix(".yaml")),
        "server": server,
        "site_id": "north",
        "tls": {"cert": f"{certs}/robots/yard1.pem", "key": f"{certs}/robots/yard1.key", "ca": f"{certs}/ca.pem"},
        "source": {"recording": str(recording), "max_scans": SCANS, "realtime": True, "queue_scans": 1000},
        "uplink": {"connect_timeout_s": None},
        "output": {"dir": str(folder / "out"), "progress": True},
        "metrics": {"port": None},
        "state_dir": str(folder / "state"),
    }
    (folder / "agent.yaml").write_text(yaml.safe_dump(config))
    agent = StackProcess("robot", folder / "robot.log")
    agent.launch((sys.executable, "-m", "edge_agent", "run", "--config", folder / "agent.yaml"))
    return agent


def mapped(agent: StackProcess) -> int:
    """Scans of its progress lines."""
    lines = [line for line in agent.log.read_text().splitlines() if line.startswith("{")]
    return max((event.get("mapped", 0) for event in map(json.loads, lines)), default=0)


def test_from_nothing_to_the_first_mapped_scan_and_to_an_orderly_end(shared_data: Path, folder: Path) -> None:
    recording = shared_data / "yard1" / "yard1.bag"
    kernels = folder / "kernels"
    slower = fill_kernels(kernels)  # when the image is built
    tls = certificates(folder)
    began_s = time.monotonic()
    rack = NativeRack(folder, tls, kernels)
    agent = robot(recording, rack.address, folder)
    try:
        with rack:
            wait_until(lambda: mapped(agent) >= 1 or not agent.alive or not rack.alive, _FIRST_S, "a scan mapped")
            took_s = time.monotonic() - began_s
            rack.check_alive()
            print(
                f"\nfrom nothing to the first mapped scan: {took_s:.1f} s, this machine slowed down {slower:.1f} times"
            )
            assert mapped(agent) >= 1, agent.last_line()
            assert took_s <= bars.RACK_FROM_NOTHING_S * slower

            wait_until(lambda: all(replica.healthy() for replica in rack.replicas), _RUN_S, "every replica healthy")
            assert rack.envoy.well()
            assert rack.envoy.healthy() == {replica.address for replica in rack.replicas}
            assert agent.wait(_RUN_S) == 0, agent.last_line()
            report = json.loads((folder / "out" / "edge.json").read_text())
            assert report["scans"] == {"read": SCANS, "sent": SCANS, "mapped": SCANS, "dropped": 0}

            up = 'up{job="map-service"} == 1'
            wait_until(lambda: len(rack.prometheus.ask(up)) == len(rack.replicas), _RUN_S, "Prometheus sees every one")
            leaving = rack.replicas[0]
            assert rack.stop(leaving) == 0, leaving.last_line()
            assert not leaving.healthy()
            wait_until(lambda: leaving.address not in rack.envoy.healthy(), _RUN_S, "the proxy to leave it out")
    finally:
        agent.kill()
