"""Occupancy grids against what the exact geometry of made worlds says."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from map_service.catalog import StoredKeyframe
from map_service.export import map_pieces
from splitslam import se3
from splitslam.errors import InputError
from splitslam.export.grid import nav2
from splitslam.export.grid.nav2 import write_grid
from splitslam.export.grid.settings import GridSettings
from splitslam.maps import MapPiece
from splitslam.sim import DEMO, DRIVES
from splitslam.sim.mesh import Mesh
from splitslam.sim.place import Place
from splitslam.sim.spec import DriveSpec, Perturbations
from splitslam.sim.world import Hits, World
from tests import tolerances
from tests.export.made import pieces
from tests.export.made_world import Camera, Drive, driven, seen_free, standing_cells, widened
from tests.export.nav2_loader import LoadedMap, load

SETTINGS = GridSettings()


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
    rows = candidates[rng.integers(0, len(candidates), 15_000)]
    centres = low + (rows[:, ::-1] + 0.5) * settings.resolution_m
    seen = seen_free(drive, centres, settings.range_m)
    recall = free[tuple(rows[seen].T)].mean()
    false_free = (truth & free).sum() / free.sum()
    return Scored((occupied & widened(truth)).sum() / occupied.sum(), recall, false_free, int(occupied.sum()))


WALKS: dict[str, tuple[DriveSpec, float, float]] = {
    "campus, four people walking": (DEMO, 2.0, 14.0),
    "corridor": (replace(DRIVES["corridor"], perturbations=Perturbations()), 0.0, 8.0),
}


@pytest.mark.parametrize("name", WALKS)
def test_what_is_occupied_is_there_and_what_is_seen_free_is_free(name: str, tmp_path: Path) -> None:
    drive = driven(*WALKS[name])
    score = scored(drive, gridded(drive, tmp_path))
    assert score.occupied > 1000
    assert score.occupied_near >= tolerances.GRID_OCCUPIED_NEAR
    assert score.free_recall >= tolerances.GRID_FREE_RECALL


class Slope:
    """A meadow that rises by 12 degrees, with posts on it; as Beams."""

    RISE = np.tan(np.radians(12.0))

    def __init__(self) -> None:
        mesh = Mesh()
        mesh.ground((-40.0, -40.0), (60.0, 40.0), 1.0, self.height_m, reflectivity=100)
        for x, y in ((8.0, 4.0), (14.0, -5.0), (20.0, 3.0), (3.0, -6.0)):
            mesh.box((x, y, float(self.height_m(np.array(x), np.array(y))) - 0.3), (0.6, 0.6, 1.5), reflectivity=100)
        self.place = Place(*mesh.arrays(), self.height_m, ())
        self.world = World(self.place)

    def height_m(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return self.RISE * x + 0.0 * y

    def cast(self, scan: int, t_s: np.ndarray, origins: np.ndarray, directions: np.ndarray) -> Hits:
        return self.world.cast(origins, directions)


@pytest.fixture(scope="module")
def uphill() -> Drive:
    """Twelve metres up the slope, the sensor a metre over the ground and as inclined as it."""
    slope = Slope()
    inclined = se3.exp(np.array([0.0, -np.radians(12.0), 0.0, 0.0, 0.0, 0.0]))[:3, :3]
    poses = np.array([se3.compose(inclined, np.array([x, 0.0, slope.RISE * x + 1.0])) for x in np.arange(0.0, 12.0)])
    camera = Camera(slope)
    stored = [StoredKeyframe(k, k, T, camera.cloud(k, 0.0, T)) for k, T in enumerate(poses)]
    return Drive(slope.world, poses, list(map_pieces(stored, 0.0)))


def test_a_slope_is_no_obstacle_and_what_stands_on_it_is_one(uphill: Drive, tmp_path: Path) -> None:
    loaded = gridded(uphill, tmp_path)
    score = scored(uphill, loaded)
    assert score.occupied > 40
    assert score.occupied_near >= tolerances.GRID_OCCUPIED_NEAR
    assert score.free_recall >= tolerances.GRID_FREE_RECALL
    for x, y in ((8.0, 4.0), (14.0, -5.0), (3.0, -6.0)):
        row, column = np.floor((np.array([y, x]) - loaded.origin[1::-1]) / loaded.resolution_m).astype(int)
        assert (loaded.data[row - 8 : row + 9, column - 8 : column + 9] == 100).any()


def views(passes: int, stands: int) -> list[MapPiece]:
    """A sensor that sees a wall ten metres ahead, and in the first `stands` views somebody before it at five metres."""
    y = np.linspace(-2.0, 2.0, 161)
    floor = np.column_stack(
        [np.tile(np.linspace(2.0, 9.0, 40), 41), np.repeat(np.linspace(-2, 2, 41), 40), -np.ones(1640)]
    )
    made = []
    for k in range(passes):
        wall = np.concatenate([np.column_stack([np.full(161, 10.0), y, np.full(161, z)]) for z in (-0.4, -0.1, 0.3)])
        if k < stands:
            near = np.abs(wall[:, 1]) < 0.6
            wall[near, :2] *= 0.5
            floor_seen = floor[(floor[:, 0] < 5.0) | (np.abs(floor[:, 1]) > 0.07 * floor[:, 0])]
        else:
            floor_seen = floor
        points = np.column_stack([np.concatenate([wall, floor_seen]), np.zeros(len(wall) + len(floor_seen))])
        made.append(MapPiece(k, k + 1, np.eye(4), points.astype("<f4")))
    return made


@pytest.mark.parametrize(("passes", "remains"), [(2, True), (6, False)])
def test_who_has_gone_is_outvoted_by_those_who_saw_through(passes: int, remains: bool, tmp_path: Path) -> None:
    write_grid(tmp_path / "map.yaml", tmp_path / "map.pgm", "map.pgm", views(passes, 1), SETTINGS)
    loaded = load(tmp_path / "map.yaml")
    at = np.floor((np.array([[0.0, 5.02], [0.0, 10.02]]) - loaded.origin[1::-1]) / loaded.resolution_m).astype(int)
    person, wall = (loaded.data[row - 4 : row + 5, column] for row, column in at)
    assert (person == 100).any() == remains
    assert (wall == 100).all()


def test_nav2_s_own_thresholds_and_names(tmp_path: Path) -> None:
    grid = write_grid(tmp_path / "map.yaml", tmp_path / "map.pgm", "map.pgm", views(4, 0), SETTINGS)
    loaded = load(tmp_path / "map.yaml")
    assert loaded.data.shape == (grid.rows, grid.columns)
    counts = {value: int((loaded.data == value).sum()) for value in (-1, 0, 100)}
    assert (counts[0], counts[100]) == (grid.free, grid.occupied)
    assert min(counts.values()) > 0
    assert loaded.resolution_m == 0.05
    # the sensor at (0, 0) is in the cell that the origin says: free; the wall is to the right of it
    column, row = (int(-value / 0.05) for value in loaded.origin[:2])
    assert loaded.data[row, column + 80] == 0
    assert loaded.data[row, column + 200] == 100


def test_parts_make_the_grid_that_one_part_makes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = pieces()
    images = []
    for part in (512, 200):
        monkeypatch.setattr(nav2, "_PART", part)
        grid = write_grid(tmp_path / "map.yaml", tmp_path / "map.pgm", "map.pgm", made, SETTINGS)
        images.append((grid, (tmp_path / "map.pgm").read_bytes()))
    assert images[0] == images[1]


def test_a_map_without_keyframes_or_of_too_many_cells_is_an_input_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="without keyframes"):
        write_grid(tmp_path / "map.yaml", tmp_path / "map.pgm", "map.pgm", [], SETTINGS)
    far = [MapPiece(k, 1, se3.compose(np.eye(3), np.array([k * 4e5, k * 4e5, 0.0])), np.zeros((0, 4), "<f4"))
           for k in range(2)]  # fmt: skip
    with pytest.raises(InputError, match=r"--resolution 0\.05: 80000\d\d x 80000\d\d cells: expected 8\.\d\d m"):
        write_grid(tmp_path / "map.yaml", tmp_path / "map.pgm", "map.pgm", far, SETTINGS)
