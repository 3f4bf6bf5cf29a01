"""Numbers of the documents that a change of the code makes false."""

from __future__ import annotations

import pytest

from map_service.config import SESSIONS_A_WORKER, ServiceConfig
from map_service.migrations import VERSION
from tests.conftest import ROOT

THINNED_MM = round(ServiceConfig().poses.within_m * 1e3)


@pytest.mark.parametrize(
    ("page", "words"),
    [
        ("docs/versions.md", f"| store | `meta.schema_version`, {VERSION} |"),
        ("docs/tuning.md", f"0: {SESSIONS_A_WORKER} a worker |"),
        ("deploy/README.md", f"0: {SESSIONS_A_WORKER} a worker |"),
        ("docs/server.md", f"A worker takes {SESSIONS_A_WORKER} robots"),
        ("docs/design.md", f"At most {SESSIONS_A_WORKER} robots a worker"),
        ("docs/api.md", f"poses are told within {THINNED_MM} mm"),
    ],
)
def test_a_page_says_the_number_that_is_in_force(page: str, words: str) -> None:
    assert words in (ROOT / page).read_text()
