from __future__ import annotations

import json
from pathlib import Path

import pytest

from edge_agent import run_id
from edge_agent.run_id import RunState
from splitslam.errors import InputError


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> dict[str, float]:
    now = {"s": 1000.0}
    monkeypatch.setattr(run_id, "_since_boot_s", lambda: now["s"])
    return now


def test_a_restart_within_thirty_seconds_continues_the_run(tmp_path: Path, clock: dict[str, float]):
    state = RunState(tmp_path)
    first = state.open()
    clock["s"] += 100.0
    state.save(first)
    clock["s"] += 29.0
    second = RunState(tmp_path).open()
    assert (second.value, first.continued, second.continued) == (first.value, False, True)


def test_a_longer_gap_is_a_new_run(tmp_path: Path, clock: dict[str, float]):
    first = RunState(tmp_path).open()
    clock["s"] += 31.0
    assert RunState(tmp_path).open().value != first.value


def test_another_boot_is_a_new_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    first = RunState(tmp_path).open()
    monkeypatch.setattr(run_id, "_boot_id", lambda: "another")
    assert RunState(tmp_path).open().value != first.value


def test_a_finished_run_is_not_continued(tmp_path: Path):
    state = RunState(tmp_path)
    first = state.open()
    state.forget()
    assert RunState(tmp_path).open().value != first.value


@pytest.mark.parametrize("text", ["", "{", "[]", '{"run_id": "../x", "boot_id": 1, "since_boot_s": 0}'])
def test_a_damaged_file_begins_a_new_run(tmp_path: Path, text: str):
    (tmp_path / "run.json").write_text(text)
    run = RunState(tmp_path).open()
    assert not run.continued
    assert json.loads((tmp_path / "run.json").read_text())["run_id"] == run.value


def test_without_a_directory_each_run_is_new():
    assert RunState(None).open().value != RunState(None).open().value


def test_a_directory_that_cannot_be_written_is_one_line(tmp_path: Path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"^state_dir"):
        RunState(tmp_path / "file").open()
