"""The bytes of a whole scan: what comes back, and what is refused."""

from __future__ import annotations

import struct
import zlib
from dataclasses import replace

import numpy as np
import pytest

from splitslam import codec, dense_cloud
from splitslam.codec import STEP_M
from splitslam.errors import DataError
from tests import tolerances
from tests.dense.made import cloud, large_scan, whole_scan


def test_every_point_comes_back_where_it_was_with_its_intensity():
    scan = whole_scan(3, 2000)
    data = dense_cloud.encode(scan, STEP_M)
    points, intensity = dense_cloud.decode(data)
    assert dense_cloud.check(data) == dense_cloud.Head(3, scan.stamp_ns, 2000)
    off_m = np.linalg.norm(points - scan.points.points_lidar, axis=1)
    assert off_m.mean() < tolerances.CODEC_MEAN_M
    assert off_m.max() < tolerances.CODEC_MAX_M
    assert np.abs(intensity.astype(int) - scan.points.intensity).max() <= 16


def test_a_scan_with_more_points_than_the_codec_takes_goes_in_parts_of_whole_rings():
    scan = large_scan()
    assert len(scan.points) == 2 * codec.MAX_POINTS
    points, _ = dense_cloud.decode(dense_cloud.encode(scan, STEP_M))
    assert np.linalg.norm(points - scan.points.points_lidar, axis=1).max() < tolerances.CODEC_MAX_M


def test_a_scan_without_points_is_a_cloud_without_points():
    scan = whole_scan()
    nothing = replace(scan, points=dense_cloud.part_of(scan.points, 0, 0))
    points, intensity = dense_cloud.decode(dense_cloud.encode(nothing, STEP_M))
    assert points.shape == (0, 3)
    assert len(intensity) == 0


def test_it_lies_in_the_map_where_its_keyframe_does():
    data = cloud()
    T_map_lidar = np.eye(4)
    T_map_lidar[:3, 3] = 100.0, -50.0, 2.0
    moved = dense_cloud.in_map(data, T_map_lidar)
    points, intensity = dense_cloud.decode(data)
    assert moved.dtype == np.dtype("<f4")
    assert np.abs(moved[:, :3] - points - [100.0, -50.0, 2.0]).max() < tolerances.FLOAT32_MAP_M
    assert (moved[:, 3] == intensity).all()


def test_each_flipped_bit_and_each_cut_is_refused_by_who_stores_it():
    data = cloud(points=40)
    for at in range(0, len(data), 7):
        flipped = bytearray(data)
        flipped[at] ^= 1 << (at % 8)
        for harmed in (bytes(flipped), data[:at], data + bytes(at + 1)):
            with pytest.raises(DataError, match="corrupt: dense cloud"):
                dense_cloud.check(harmed)


@pytest.mark.parametrize(
    ("at", "value", "why"),
    [
        (0, b"SSd2", "not a dense cloud of version 1"),
        (4, struct.pack("<H", 0), "not a dense cloud of version 1"),
        (6, struct.pack("<H", 60_000), "shorter than its head says"),
        (8, struct.pack("<I", 1 << 20), "not a dense cloud of version 1"),
        (6, struct.pack("<H", 2), "not as long as it says"),
        (28, struct.pack("<f", float("nan")), "a beam beyond"),
    ],
)
def test_a_layout_that_is_none_is_refused_though_its_checksum_is_right(at: int, value: bytes, why: str):
    body = bytearray(cloud()[:-4])
    body[at : at + len(value)] = value
    with pytest.raises(DataError, match=why):
        dense_cloud.check(bytes(body) + struct.pack("<I", zlib.crc32(body)))
