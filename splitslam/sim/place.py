"""The description of a place: surfaces, ground, and where people walk."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Place:
    """World frame, m, z up.

    triangles (K, 3, 3) float32; reflectivity (K,) uint8; ground_m(x, y) -> height of the way the sensor is carried
    over; walkways: straight ways (ax, ay, bx, by) on which people walk to and fro.
    """

    triangles: NDArray[np.float32]
    reflectivity: NDArray[np.uint8]
    ground_m: Callable[[Array, Array], Array]
    walkways: tuple[tuple[float, float, float, float], ...]
