"""Whole scans of keyframes, and a service that does not know them yet: they wait on the robot until it does."""

from __future__ import annotations

import json
from contextlib import closing
from pathlib import Path

from map_service.catalog import Catalog
from map_service.store import Store
from tests.versions import previous
from tests.versions.mixed import NEW_AGENT, NEW_SERVICE, Service, robot


def test_whole_scans_wait_for_a_service_that_knows_them(shared_data: Path, tmp_path: Path) -> None:
    recording, file = shared_data / "yard1" / "yard1.bag", tmp_path / "map.db"
    old = Service(previous.command("map_service"), file, tmp_path / "old.log")
    with closing(old):
        old.wait_ready()
        server = "{}:{}".format(*old.target)
        said = robot("r", NEW_AGENT, recording, server, tmp_path, max_scans=80, dense="idle").wait_end()
    before = json.loads((tmp_path / "r" / "edge.json").read_text())
    assert before["scans"]["mapped"] == 80
    assert before["dense"]["sent"] == before["dense"]["bytes"] == 0
    waiting = before["dense"]["waiting"]
    assert waiting >= 4
    assert f"{waiting} dense keyframes are not sent" in said
    new = Service(NEW_SERVICE, file, tmp_path / "new.log")
    with closing(new):
        new.wait_ready()
        server = "{}:{}".format(*new.target)
        robot("r", NEW_AGENT, recording, server, tmp_path, max_scans=10, dense="idle").wait_end()
    after = json.loads((tmp_path / "r" / "edge.json").read_text())
    assert after["dense"]["waiting"] == 0
    assert after["dense"]["sent"] >= waiting
    store = Store(f"sqlite:///{file}")
    with closing(store):
        row = Catalog(store).session(before["session_id"])
        assert row is not None
        with closing(Catalog(store).keyframes(row.id, dense=True)) as keyframes:
            assert sum(keyframe.dense is not None for keyframe in keyframes) == waiting
