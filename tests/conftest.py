"""Fixtures that every area uses."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real and made recordings: $SPLITSLAM_DATA or ../shared/data.

    Without it a test is skipped on a laptop and fails in CI, where a missing recording must not look like success.
    """
    folder = Path(os.environ.get("SPLITSLAM_DATA") or ROOT.parent / "shared" / "data")
    if not (folder / "yard1" / "yard1.bag").is_file():
        reason = f"no recordings in {folder} (set SPLITSLAM_DATA)"
        if os.environ.get("CI", "").lower() in ("true", "1"):
            pytest.fail(reason)
        pytest.skip(reason)
    return folder


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """While a test marked `alone` runs, the other workers start none: it needs the whole machine."""
    if not hasattr(item.config, "workerinput"):
        return (yield)
    with _turn(fcntl.LOCK_EX if item.get_closest_marker("alone") else fcntl.LOCK_SH):
        return (yield)


@contextmanager
def _turn(kind: int) -> Iterator[None]:
    """A lock among worker processes, shared or exclusive; the gate keeps shared ones from starving an exclusive one."""
    gate, lock = os.open(ROOT / "tests", os.O_RDONLY), os.open(ROOT, os.O_RDONLY)
    try:
        fcntl.flock(gate, fcntl.LOCK_EX)
        fcntl.flock(lock, kind)
        fcntl.flock(gate, fcntl.LOCK_UN)
        yield
    finally:
        os.close(lock)
        os.close(gate)
