"""Short made drives on foot with LiDARs of other resolutions, made once and kept."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from splitslam.errors import InputError
from splitslam.sim.grid_lidar import Grid
from splitslam.sim.spec import DEMO, HeadTurn

GRIDS = (Grid(16, 1800), Grid(32, 1800), Grid(64, 2048), Grid(128, 2048))
MAX_S = 40.0


def grids(text: str) -> tuple[Grid, ...]:
    """`16x1800,64x2048` as grids. Raises InputError."""
    found = []
    for part in filter(None, (part.strip() for part in text.split(","))):
        rings, _, columns = part.partition("x")
        if not (rings.isdecimal() and columns.isdecimal() and 4 <= int(rings) <= 128 and 64 <= int(columns) <= 4096):
            raise InputError(
                f"--grids: expected RINGSxCOLUMNS of 4 to 128 rings and 64 to 4096 columns, found {part!r}"
            )
        found.append(Grid(int(rings), int(columns)))
    return tuple(found)


def made_drive(
    grid: Grid, seconds: float, folder: Path, progress: Callable[[int, int], None] | None = None
) -> tuple[Path, Path]:
    """(bag, robot file) of a walk round the campus' pavilion with two head turns; what lies there is not made again."""
    from splitslam.sim.recorder import simulate_grid

    path = replace(
        DEMO.path, stand_s=1.0, accel_s=1.0, head_turns=(HeadTurn(2.5, 60.0, 1.4), HeadTurn(5.0, -60.0, 1.4))
    )
    spec = replace(DEMO, name=f"{grid}_{seconds:g}s", duration_s=seconds, path=path, gnss=None)
    made = folder / f"{spec.name}.bag", folder / f"{spec.name}.yaml"
    if all(path.is_file() for path in made):
        return made
    return simulate_grid(spec, grid, folder, progress)
