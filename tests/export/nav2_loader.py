"""A map as Nav2's map server loads it (nav2_map_server/src/map_io.cpp), rule by rule, out of its own parts."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from PIL import Image


@dataclass(frozen=True, eq=False)
class LoadedMap:
    """data: (height, width) int8 as nav_msgs/OccupancyGrid has it, row 0 at the origin: 0 free, 100 occupied, -1."""

    data: np.ndarray
    resolution_m: float
    origin: tuple[float, float, float]


def load(path: Path, free_thresh: float | None = None) -> LoadedMap:
    """Raises KeyError for a missing key, ValueError for what Nav2 does not take. free_thresh: not the file's."""
    document = yaml.safe_load(path.read_text())
    name = str(document["image"])
    if not name:
        raise ValueError("The image tag was empty.")
    image = Path(name) if name.startswith("/") else path.parent / name
    origin = [float(value) for value in document["origin"]]
    if len(origin) != 3:
        raise ValueError("value of the 'origin' tag should have 3 elements")
    if document.get("mode", "trinary") != "trinary":
        raise ValueError("another mode")
    occupied_thresh = float(document["occupied_thresh"])
    free_thresh = float(document["free_thresh"]) if free_thresh is None else free_thresh
    shade = np.asarray(Image.open(image).convert("L")) / 255.0
    occupied = shade if bool(document["negate"]) else 1.0 - shade
    data = np.full(occupied.shape, -1, np.int8)
    data[occupied < free_thresh] = 0
    data[occupied > occupied_thresh] = 100
    return LoadedMap(data[::-1], float(document["resolution"]), (origin[0], origin[1], origin[2]))
