"""A stored session with GNSS, and the command as somebody types it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from map_service.rows import SessionCommit
from map_service.store import Opening, Store
from tests.map_pipeline.made_drives import Odometry, Receiver, driven, fixes, rounds
from tests.typed import Said, typed

SESSION = "rover/1"
Run = Callable[..., Said]


@pytest.fixture(scope="session")
def store_url(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Of a SQLite store with one finished session, rover/1: 60 m with GNSS."""
    url = f"sqlite:///{tmp_path_factory.mktemp('store')}/map.db"
    truth = rounds(60.0, 1.4)
    outcome = driven(truth, fixes(truth, Receiver(rate_hz=1.0)), Odometry(drift=(0, 0, 2e-5, 0.002, 0, 0.001)))
    commit = outcome.pipeline.take_commit()
    store = Store(url)
    opened = store.open_session(Opening(SESSION, "rover", "1", "", "", "robot: {}"))
    T_map_odom = {frame.seq: np.eye(4) for frame in commit.frames}
    store.commit(opened.key, opened.epoch, SessionCommit(commit, T_map_odom, finished=True))
    store.close()
    return url


@pytest.fixture
def run(tmp_path: Path) -> Run:
    """`splitslam export ...`, typed in an empty folder."""
    return partial(typed, "splitslam", "export", folder=tmp_path)
