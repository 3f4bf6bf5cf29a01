"""Trajectories as TUM, KITTI and GeoJSON files."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from splitslam.export.placing import OnEarth
from splitslam.maps import Georeference
from splitslam.se3 import matrix_from_quat
from splitslam.tum import Trajectory


def write_kitti(path: Path, times: Path, trajectory: Trajectory) -> None:
    """KITTI odometry: T_map_lidar (3, 4) row by row, a pose a line; `times`: s after the first pose, a line each."""
    with path.open("w", encoding="ascii") as poses:
        for position, quat in zip(trajectory.positions_m, trajectory.quats_xyzw, strict=True):
            rows = np.column_stack([matrix_from_quat(quat), position])
            poses.write(" ".join(f"{value:.12g}" for value in rows.ravel().tolist()) + "\n")
    first_ns = trajectory.stamps_ns[0] if len(trajectory) else 0
    with times.open("w", encoding="ascii") as file:
        file.writelines(f"{(ns - first_ns) * 1e-9:.9e}\n" for ns in trajectory.stamps_ns.tolist())


def write_geojson(path: Path, trajectory: Trajectory, georeference: Georeference, name: str) -> None:
    """RFC 7946: one LineString of longitude, latitude (deg, WGS84), height above the ellipsoid (m).

    Times of the positions are in `coordTimes`, ISO 8601, UTC, as other writers of GeoJSON tracks name them.
    """
    line = OnEarth(georeference).place(trajectory.positions_m)
    coordinates = [[round(lon, 9), round(lat, 9), round(h, 4)] for lon, lat, h in line.tolist()]
    feature = {
        "type": "Feature",
        "geometry": {"type": "LineString", "coordinates": coordinates},
        "properties": {"session": name, "coordTimes": [_iso(ns) for ns in trajectory.stamps_ns.tolist()]},
    }
    with path.open("w", encoding="ascii") as file:
        json.dump({"type": "FeatureCollection", "features": [feature]}, file)
        file.write("\n")


def _iso(stamp_ns: int) -> str:
    seconds, rest_ns = divmod(stamp_ns, 1_000_000_000)
    return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%dT%H:%M:%S}.{rest_ns // 1_000_000:03d}Z"
