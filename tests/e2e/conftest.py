"""What several of these tests look at and none of them changes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.e2e.commands import Run, run
from tests.once import made_once


@pytest.fixture(scope="session")
def yard1(shared_data: Path) -> Path:
    return shared_data / "yard1" / "yard1.bag"


@pytest.fixture(scope="session")
def yard1_as_it_is(yard1: Path, tmp_path_factory: pytest.TempPathFactory, worker_id: str) -> Run:
    """The whole of yard1 by `splitslam run` without options; made by one worker for all."""
    base = tmp_path_factory.getbasetemp()
    shared = base if worker_id == "master" else base.parent
    out = made_once(shared / "yard1_as_it_is", lambda folder: run(folder, yard1))
    return Run(out, json.loads((out / "report.json").read_text()))
