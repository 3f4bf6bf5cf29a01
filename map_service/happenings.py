"""What happens to a session's map besides its answers, as the pipeline notes it; messages.py has it on the wire."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from map_service.types import Cause

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class LoopAccepted:
    """Keyframes that became a loop, and what lay between where the graph had the newer and where the loop has it."""

    older: int
    newer: int
    translation_m: float
    rotation_rad: float


@dataclass(frozen=True, slots=True, eq=False)
class DatumFound:
    """GNSS fixes that agree. origin: latitude and longitude in degrees, altitude in m. T_enu_map: (4, 4)."""

    datum: int
    origin: tuple[float, float, float]
    T_enu_map: Array


@dataclass(frozen=True, slots=True, eq=False)
class MapMove:
    """Version `version` of the map begins with frame `first_seq`.

    translation_m, rotation_rad: the largest move of any keyframe. T_map_lidar: (n, 4, 4), the keyframes as the version
    before ended.
    """

    version: int
    first_seq: int
    cause: Cause
    translation_m: float
    rotation_rad: float
    T_map_lidar: Array


Happening = LoopAccepted | DatumFound | MapMove


@dataclass(frozen=True, slots=True, eq=False)
class Happened:
    """A happening, and the newest frame by then."""

    seq: int
    stamp_ns: int
    what: Happening
