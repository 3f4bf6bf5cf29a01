"""Where the points of a map go in a file: as they are in `map`, or on Earth, as UTM coordinates."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from splitslam.errors import InputError
from splitslam.maps import Georeference

Array = NDArray[np.float64]
_ROUND_M = 100.0
_UTM_DEG = (-80.0, 84.0)


class Placing(Protocol):
    """From `map` to a file's frame."""

    @property
    def wkt(self) -> str:
        """The coordinate reference system as WKT 1; "" for `map`."""
        ...

    @property
    def description(self) -> str:
        """For people: frame, offset, ..."""
        ...

    @property
    def offset_m(self) -> Array:
        """(3,) near the map's points, whole hundreds of metres: what a file of small numbers leaves out."""
        ...

    def place(self, points_map: Array) -> Array:
        """(N, 3) m in `map` -> (N, 3) m in the file's frame, offset included."""
        ...


class InMap:
    """As it is in `map`."""

    wkt = ""
    description = "frame map, metres"
    offset_m = np.zeros(3)

    def place(self, points_map: Array) -> Array:
        """As Placing."""
        return points_map


class InUtm:
    """UTM zone of the origin on WGS84, easting and northing, height above the ellipsoid.

    By way of `enu` and geocentric coordinates, each point exactly (PROJ's topocentric, cart, utm). UTM shortens lengths
    by up to 0.04 %: so does every file in it.
    """

    def __init__(self, georeference: Georeference) -> None:
        """Raises InputError where there is no UTM."""
        import pyproj
        from pyproj.enums import WktVersion

        latitude_deg, longitude_deg = georeference.latitude_deg, georeference.longitude_deg
        if not _UTM_DEG[0] <= latitude_deg <= _UTM_DEG[1]:
            raise InputError(f"latitude {latitude_deg:.3f}: UTM ends there; --frame map leaves the map where it is")
        zone = min(int((longitude_deg + 180.0) % 360.0 // 6.0) + 1, 60)
        south = latitude_deg < 0.0
        self.epsg = (32700 if south else 32600) + zone
        self.wkt = pyproj.CRS.from_epsg(self.epsg).to_wkt(WktVersion.WKT1_GDAL)
        self._T_enu_map = georeference.T_enu_map
        to_earth = _to_geocentric(georeference)
        utm = f"+step +proj=utm +zone={zone} {'+south ' if south else ''}+ellps=WGS84"
        self._transform = pyproj.Transformer.from_pipeline(f"{to_earth} +step +inv +proj=cart +ellps=WGS84 {utm}")
        origin = self.place(np.zeros((1, 3)))[0]
        self.offset_m = np.round(origin / _ROUND_M) * _ROUND_M
        e, n, h = self.offset_m
        self.description = f"EPSG:{self.epsg}, height above the WGS84 ellipsoid, metres, less {e:.0f} {n:.0f} {h:.0f}"

    def place(self, points_map: Array) -> Array:
        """As Placing."""
        return np.column_stack(self._transform.transform(*_enu(self._T_enu_map, points_map).T))


class OnEarth:
    """Longitude and latitude, degrees, and height above the ellipsoid, m: WGS84."""

    def __init__(self, georeference: Georeference) -> None:
        import pyproj

        to_degrees = "+step +inv +proj=cart +ellps=WGS84 +step +proj=unitconvert +xy_in=rad +xy_out=deg"
        self._transform = pyproj.Transformer.from_pipeline(f"{_to_geocentric(georeference)} {to_degrees}")
        self._T_enu_map = georeference.T_enu_map

    def place(self, points_map: Array) -> Array:
        """(N, 3) m in `map` -> (N, 3) longitude_deg, latitude_deg, altitude_m."""
        return np.column_stack(self._transform.transform(*_enu(self._T_enu_map, points_map).T))


def _enu(T_enu_map: Array, points_map: Array) -> Array:
    return points_map @ T_enu_map[:3, :3].T + T_enu_map[:3, 3]


def _to_geocentric(at: Georeference) -> str:
    where = f"+lat_0={at.latitude_deg!r} +lon_0={at.longitude_deg!r} +h_0={at.altitude_m!r}"
    return f"+proj=pipeline +step +inv +proj=topocentric +ellps=WGS84 {where}"
