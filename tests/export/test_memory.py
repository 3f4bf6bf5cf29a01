"""An export's memory does not grow with the map; the long form is benchmarks/export.py."""

from __future__ import annotations

from benchmarks.export import measured
from tests.tolerances import EXPORT_MEMORY_MB


def test_five_million_points_are_sorted_into_an_octree_in_little_memory() -> None:
    cost = measured("copc", 5_000_000)
    assert cost.points == 5_000_000
    assert cost.file_mb > 20
    assert cost.memory_mb < EXPORT_MEMORY_MB
