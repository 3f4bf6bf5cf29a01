"""Fixtures that every area uses."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from tests.missing import missing

ROOT = Path(__file__).resolve().parent.parent
# How long an example takes is the machine's business: on a busy one the default of 200 ms is over now and then.
settings.register_profile("unhurried", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("unhurried")


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real and made recordings: $SPLITSLAM_DATA or ../shared/data.

    Without it a test is skipped on a laptop and fails in CI, where a missing recording must not look like success.
    """
    folder = Path(os.environ.get("SPLITSLAM_DATA") or ROOT.parent / "shared" / "data")
    if not (folder / "yard1" / "yard1.bag").is_file():
        missing(f"no recordings in {folder} (set SPLITSLAM_DATA)")
    return folder
