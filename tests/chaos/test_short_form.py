"""The short form of the chaos suite: one stack, one fault after the other, robots that check every answer."""

from __future__ import annotations

import os
from functools import partial

import pytest

from tests import tolerances as bars
from tests.chaos.faults import SHORT
from tests.chaos.field import Size, open_field
from tests.chaos.material import make
from tests.chaos.sequence import play


@pytest.mark.alone
def test_whatever_is_killed_frozen_or_cut_every_scan_is_mapped_once_and_nothing_is_left_behind(tmp_path):
    size = Size(light=3, real=1, frames=150)
    with open_field(tmp_path, partial(make, tmp_path / "drive", seconds=30.0), size) as field:
        outcomes = play(field, SHORT)
    assert field.wrong == []
    assert field.fleet.judged >= size.light
    assert [outcome.fault for outcome in outcomes] == [fault.name for fault in SHORT]
    busy = max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1))  # how many wait for each core
    for outcome in outcomes:
        if outcome.bar_s is not None:
            assert outcome.gap_s <= bars.GAP_SLACK * busy * outcome.bar_s, outcome.line()
