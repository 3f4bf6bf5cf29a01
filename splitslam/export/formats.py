"""What can be exported: formats by name, the names of their files, and what they need."""

from __future__ import annotations

import difflib
import importlib.util
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

from splitslam.errors import InputError


class Kind(Enum):
    """What a format holds."""

    CLOUD = "cloud"
    PATH = "path"
    GRAPH = "graph"
    GRID = "grid"


@dataclass(frozen=True, slots=True)
class Format:
    """One format. default: name of its file; modules: what the extra `export` brings for it."""

    name: str
    kind: Kind
    default: str
    modules: tuple[str, ...] = ()


FORMATS = {
    f.name: f
    for f in (
        Format("ply", Kind.CLOUD, "map.ply"),
        Format("pcd", Kind.CLOUD, "map.pcd"),
        Format("las", Kind.CLOUD, "map.las", ("laspy",)),
        Format("laz", Kind.CLOUD, "map.laz", ("laspy", "lazrs")),
        Format("copc", Kind.CLOUD, "map.copc.laz", ("laspy", "lazrs")),
        Format("e57", Kind.CLOUD, "map.e57", ("pye57",)),
        Format("tum", Kind.PATH, "trajectory.tum"),
        Format("kitti", Kind.PATH, "trajectory.txt"),
        Format("geojson", Kind.PATH, "trajectory.geojson", ("pyproj",)),
        Format("g2o", Kind.GRAPH, "graph.g2o"),
        Format("grid", Kind.GRID, "map.yaml"),
    )
}


def find_format(name: str) -> Format:
    """Raises InputError for one that is not known."""
    if name not in FORMATS:
        nearest = difflib.get_close_matches(name, FORMATS, n=1)
        hint = f"; nearest: {nearest[0]}" if nearest else ""
        raise InputError(f"--format: expected one of {', '.join(FORMATS)}, found {name!r}{hint}")
    return FORMATS[name]


def check_modules(modules: tuple[str, ...]) -> None:
    """Raises InputError that says what to install."""
    if missing := [module for module in modules if importlib.util.find_spec(module) is None]:
        raise InputError(f"{', '.join(missing)} is not installed: pip install 'splitslam[export]'")


def companion(path: Path, format_: Format) -> Path | None:
    """The second file of a format that has two: KITTI's times, the grid's image. InputError when both would be one."""
    if format_.name == "kitti":
        return path.with_name(f"{path.stem}.times.txt")
    if format_.kind is not Kind.GRID:
        return None
    if path.suffix == ".pgm":
        raise InputError(f"--out {path}: expected the name of the grid's YAML; its image gets the same with .pgm")
    return path.with_suffix(".pgm")
