"""Maps as they pass from who has them to who writes them: keyframe by keyframe, and the graph between the keyframes."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class MapPiece:
    """The points of one keyframe: (N, 4) little-endian float32, x y z m in `map` and intensity 0 to 255.

    stamp_ns: the scan's reference time, 0 where it is not known. T_map_lidar: (4, 4) at that time. dense: they are all
    that the sensor saw, not the features alone.
    """

    keyframe: int
    stamp_ns: int
    T_map_lidar: Array
    points_map: NDArray[np.float32]
    dense: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Between:
    """A measured T_older_newer (4, 4) of two keyframes, `odometry` or `loop`.

    covariance: (6, 6), right tangent rx ry rz tx ty tz, rad and m. robust: in the graph under a robust kernel.
    """

    kind: str
    older: int
    newer: int
    T_older_newer: Array
    covariance: Array
    robust: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class AntennaFix:
    """A GNSS fix in the graph: the antenna in a keyframe's frame and in `enu`, (3,) m, with sigmas_m (3,) there."""

    keyframe: int
    antenna_keyframe: Array
    enu_m: Array
    sigmas_m: Array
    datum: int


@dataclass(frozen=True, slots=True, eq=False)
class Georeference:
    """Where `map` lies on Earth: WGS84 origin of `enu` (altitude above the ellipsoid), and T_enu_map (4, 4)."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    T_enu_map: Array


@dataclass(frozen=True, slots=True, eq=False)
class MapGraph:
    """The factor graph of a map as far as others can use it.

    T_map_lidar: (K, 4, 4) of keyframes 0 to K - 1; stamps_ns: (K,) int64. T_enu_map: by datum, a receiver's world that
    fixes agree on. origin: latitude_deg, longitude_deg, altitude_m of `enu`; None without GNSS. others: how many
    factors of other kinds there are.
    """

    T_map_lidar: Array
    stamps_ns: NDArray[np.int64]
    betweens: list[Between]
    fixes: list[AntennaFix] = field(default_factory=list)
    T_enu_map: dict[int, Array] = field(default_factory=dict)
    origin: tuple[float, float, float] | None = None
    others: dict[str, int] = field(default_factory=dict)

    @property
    def georeference(self) -> Georeference | None:
        """By the datum with the most fixes; None when GNSS has not told where the map lies."""
        if self.origin is None or not self.T_enu_map:
            return None
        count = {datum: sum(fix.datum == datum for fix in self.fixes) for datum in self.T_enu_map}
        return Georeference(*self.origin, self.T_enu_map[max(count, key=count.__getitem__)])
