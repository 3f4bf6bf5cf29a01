"""Trajectories for other programs."""

from __future__ import annotations

import json
from datetime import datetime
from pathlib import Path

import numpy as np
import pymap3d
import pytest

from splitslam.export.gps_time import adjusted_gps_s
from splitslam.export.paths import write_geojson, write_kitti
from tests.export.made import START_NS, YOKOHAMA, MadeSource, pieces

SOURCE = MadeSource(pieces(points=1), YOKOHAMA)


def test_kitti_has_a_matrix_a_line_and_times_beside(tmp_path: Path) -> None:
    write_kitti(tmp_path / "poses.txt", tmp_path / "times.txt", SOURCE.trajectory())
    rows = np.loadtxt(tmp_path / "poses.txt").reshape(-1, 3, 4)
    np.testing.assert_allclose(rows, [piece.T_map_lidar[:3] for piece in SOURCE.made], atol=1e-9)
    np.testing.assert_allclose(np.loadtxt(tmp_path / "times.txt"), np.arange(5) * 0.7, atol=1e-9)


def test_geojson_is_where_the_robot_was_and_when(tmp_path: Path) -> None:
    path = tmp_path / "trajectory.geojson"
    write_geojson(path, SOURCE.trajectory(), YOKOHAMA, "robot/run")
    (feature,) = json.loads(path.read_text())["features"]
    assert feature["geometry"]["type"] == "LineString"
    positions = SOURCE.trajectory().positions_m @ YOKOHAMA.T_enu_map[:3, :3].T + YOKOHAMA.T_enu_map[:3, 3]
    origin = YOKOHAMA.latitude_deg, YOKOHAMA.longitude_deg, YOKOHAMA.altitude_m
    for (longitude, latitude, height), (east, north, up) in zip(
        feature["geometry"]["coordinates"], positions.tolist(), strict=True
    ):
        expected = pymap3d.enu2geodetic(east, north, up, *origin)
        assert (latitude, longitude, height) == pytest.approx(expected, abs=1e-4)
        assert (latitude, longitude) == pytest.approx(expected[:2], abs=2e-9)  # 0.2 mm
    times = [datetime.fromisoformat(text) for text in feature["properties"]["coordTimes"]]
    assert times[0].timestamp() == pytest.approx(START_NS * 1e-9, abs=1e-3)
    assert len(times) == 5
    assert feature["properties"]["session"] == "robot/run"


@pytest.mark.parametrize(
    ("unix_s", "gps_s"),
    [
        # the GPS epoch; GPS second 10^9 was 2011-09-14T01:46:25 UTC; before and after the leap second of 2017
        (315_964_800, 0),
        (1_315_964_785, 1_000_000_000),
        (1_483_228_799, 1_167_264_016),
        (1_483_228_800, 1_167_264_018),
    ],
)
def test_gps_time_knows_the_leap_seconds(unix_s: int, gps_s: int) -> None:
    (found,) = adjusted_gps_s(np.array([unix_s * 10**9 + 500_000_000]))
    assert found + 1e9 == gps_s + 0.5
