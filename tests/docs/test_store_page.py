"""docs/store.md's commands on a store with a finished session."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

from map_service.catalog import Catalog
from map_service.command import app
from map_service.store import Store
from tests.conftest import ROOT
from tests.docs.pages import shell_lines
from tests.map_service.entries import OPENING, sound

PAGE = "docs/store.md"


def test_every_command_of_the_page_works(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In its order, but for `delete` and `restore`, which come last as they do away with what the others need."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "service.yaml").write_text("store: sqlite:///map.db\n")
    monkeypatch.setenv("SPLITSLAM_MAP__STORE", "sqlite:///map.db")
    store = Store("sqlite:///map.db")
    opened = store.open_session(replace(OPENING, session_id="r/0"))
    store.commit(opened.key, 1, replace(sound(), finished=True))
    store.close()
    lines = [line.text for line in shell_lines(PAGE, (ROOT / PAGE).read_text())]
    assert len(lines) >= 9
    for line in sorted(lines, key=lambda line: (" restore " in line, " delete " in line)):
        program, *words = shlex.split(line.replace("ROBOT/RUN", "r/0").replace("FILE", "backup"))
        result = CliRunner().invoke(app, words)
        assert program == "map-service"
        assert result.exit_code == 0, (line, result.output, result.exception)
    store = Store("sqlite:///map.db")
    assert [row.session_id for row in Catalog(store).sessions()] == ["r/0"]
    store.close()
