"""Occupancy grids against what the exact geometry of made worlds says."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from splitslam.export.grid.nav2 import write_grid
from splitslam.export.grid.settings import GridSettings
from splitslam.sim import DEMO, DRIVES
from splitslam.sim.spec import DriveSpec, Perturbations
from tests import tolerances
from tests.export.made_world import Drive, driven, seen_free, standing_cells, widened
from tests.export.nav2_loader import LoadedMap, load

SETTINGS = GridSettings()
STILL = Perturbations()


@dataclass(frozen=True, eq=False)
class Scored:
    """occupied_near: share of occupied cells with geometry within a cell; free_recall: share of the cells that are
    really seen free which the grid calls free; false_free: share of its free cells that geometry stands in."""

    occupied_near: float
    free_recall: float
    false_free: float
    occupied: int


def gridded(drive: Drive, folder: Path, settings: GridSettings = SETTINGS) -> LoadedMap:
    write_grid(folder / "map.yaml", folder / "map.pgm", "map.pgm", iter(drive.pieces), settings)
    return load(folder / "map.yaml")


def scored(drive: Drive, loaded: LoadedMap, settings: GridSettings = SETTINGS) -> Scored:
    low = np.array(loaded.origin[:2])
    truth = standing_cells(drive.world.place, low, loaded.data.shape, settings)
    occupied, free = loaded.data == 100, loaded.data == 0
    rng = np.random.default_rng(1)
    candidates = np.argwhere(~widened(truth))
    rows = candidates[rng.integers(0, len(candidates), 40_000)]
    centres = low + (rows[:, ::-1] + 0.5) * settings.resolution_m
    seen = seen_free(drive, centres, settings.range_m)
    recall = free[tuple(rows[seen].T)].mean()
    false_free = (truth & free).sum() / free.sum()
    return Scored((occupied & widened(truth)).sum() / occupied.sum(), recall, false_free, int(occupied.sum()))


WALKS: dict[str, tuple[DriveSpec, float, float]] = {
    "campus": (replace(DEMO, perturbations=STILL), 2.0, 30.0),
    "corridor": (replace(DRIVES["corridor"], perturbations=STILL), 0.0, 20.0),
    "park": (replace(DRIVES["park"], perturbations=STILL), 0.0, 30.0),
}


@pytest.mark.parametrize("name", WALKS)
def test_what_is_occupied_is_there_and_what_is_seen_free_is_free(name: str, tmp_path: Path) -> None:
    drive = driven(*WALKS[name])
    score = scored(drive, gridded(drive, tmp_path))
    print(score)
    assert score.occupied > 1000
    assert score.occupied_near >= tolerances.GRID_OCCUPIED_NEAR
    assert score.free_recall >= tolerances.GRID_FREE_RECALL
