"""An upgrade under way: services and agents of both releases, one store, runs that are handed from one to the other."""

from __future__ import annotations

import json
import lzma
import sqlite3
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from splitslam import __version__
from splitslam.evaluate import evaluate
from splitslam.tum import read_tum
from tests import tolerances as bars
from tests.versions import previous
from tests.versions.make_golden import GOLDEN, poses_of
from tests.versions.mixed import (
    NEW_AGENT,
    NEW_SERVICE,
    READY_S,
    RUN_S,
    Robot,
    Service,
    Switch,
    robot,
    sessions_of,
    trajectory_of,
    wait_until,
)

SCANS = 200


@pytest.fixture
def ends() -> Iterator[list]:
    """What is to be closed at the end, whatever happens."""
    things: list = []
    yield things
    for thing in reversed(things):
        if isinstance(thing, Robot):
            thing.process.kill()
            thing.process.wait()
        else:
            thing.close()


def test_runs_go_on_while_the_services_are_upgraded_one_after_the_other(
    shared_data: Path, tmp_path: Path, ends: list
) -> None:
    """Old service, then the new one on the same store; an old and a new robot, both handed over in the middle."""
    recording, store = shared_data / "yard1" / "yard1.bag", tmp_path / "map.db"
    old = Service(previous.command("map_service"), store, tmp_path / "old.log")
    ends.append(old)
    old.wait_ready()
    agents = {"old-robot": previous.command("edge_agent"), "new-robot": NEW_AGENT}
    ways = {name: Switch(old.target) for name in agents}
    ends.extend(ways.values())

    def lead_to(service: Service | None) -> None:
        for way in ways.values():
            way.to(service)

    lead_to(None)
    robots = [robot(name, program, recording, ways[name].address, tmp_path, SCANS) for name, program in agents.items()]
    ends.extend(robots)
    # one of them may have its kernels to compile first
    wait_until(lambda: all(way.turned_away for way in ways.values()), "the robots never came", READY_S)
    lead_to(old)

    def stored(service: Service, scans: int) -> bool:
        found = sessions_of(service.target)
        return len(found) == 2 and all(session.durable_seq >= scans for session in found.values())

    wait_until(lambda: stored(old, 20), "the runs never began", READY_S)
    lead_to(None)  # both robots wait
    new = Service(NEW_SERVICE, store, tmp_path / "new.log")  # migrates the store under the old one
    ends.append(new)
    new.wait_ready()
    assert "store migrated" in new.log
    lead_to(old)
    wait_until(lambda: stored(old, 50), "the old service does not go on with the new store", RUN_S)
    lead_to(new)
    at_old = sessions_of(old.target)
    assert max(session.durable_seq for session in at_old.values()) < SCANS - 20, "too late to hand anything over"
    wait_until(lambda: stored(new, 110), "the new service does not take the runs over", RUN_S)
    lead_to(old)  # a proxy may: the old one says no, and nothing comes to harm
    wait_until(lambda: old.log.count("tracker state of version 2, expected 1") >= 2, "the old one tries", RUN_S)
    lead_to(new)
    for each in robots:
        each.wait_end()

    found = sessions_of(new.target)
    truth = read_tum(recording.with_suffix(".tum"))
    for name, session in found.items():
        assert session.finished
        file = tmp_path / f"{name}.tum"
        assert trajectory_of(new.target, session, file) == list(range(1, SCANS + 1)), "each scan once"
        error = evaluate(read_tum(file), truth)
        print(f"{name}: handed over after scan {at_old[name].durable_seq}, ATE {error.ate_m * 1e3:.1f} mm")
        assert error.ate_m <= bars.YARD1_ATE_M
    assert "frames are recoded" in (tmp_path / "new-robot.log").read_text()


def test_the_way_back_is_open_and_without_it_the_old_release_refuses_in_one_line(tmp_path: Path, ends: list) -> None:
    store = tmp_path / "map.db"
    with sqlite3.connect(store) as database:
        database.executescript(lzma.decompress((GOLDEN / __version__ / "store.sql.xz").read_bytes()).decode())
    refused = Service(previous.command("map_service"), store, tmp_path / "refused.log")
    ends.append(refused)
    assert refused.process.wait(READY_S) == 2
    assert refused.log.strip() == "store: schema version 2: this service reads version 1"

    command = (*NEW_SERVICE, "store", "migrate", "--to", "1", "--store", f"sqlite:///{store}")
    subprocess.run(command, check=True, capture_output=True, timeout=READY_S)
    old = Service(previous.command("map_service"), store, tmp_path / "old.log")
    ends.append(old)
    old.wait_ready()
    known = json.loads((GOLDEN / __version__ / "store.json").read_text())
    for name, poses in poses_of(old.target).items():
        np.testing.assert_allclose(poses, known[name], rtol=0, atol=bars.SE3_ROUND_TRIP_M)
    assert len(known) == 2
