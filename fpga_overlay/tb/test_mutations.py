"""The list of deliberate mistakes is sound; `python -m fpga_overlay.tb.mutations` makes and judges them."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

from fpga_overlay.modules import RTL
from fpga_overlay.tb.mutation import Mutation
from fpga_overlay.tb.mutations import all_mutations

MUTATIONS = all_mutations()


@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda m: m.name)
def test_a_mistake_can_be_made_and_has_a_test(mutation: Mutation):
    assert (RTL / mutation.file).read_text().count(mutation.old) == 1
    assert mutation.new != mutation.old
    bench = importlib.util.find_spec(mutation.bench)
    assert bench is not None
    assert bench.origin is not None
    assert f"async def {mutation.test}(" in Path(bench.origin).read_text()


def test_names_are_unique_and_at_least_twelve():
    names = [m.name for m in MUTATIONS]
    assert len(set(names)) == len(names) >= 12
