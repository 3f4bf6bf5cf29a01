from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from edge_agent.features.integer import MASKED, FeatureMarks, Limits
from edge_agent.features.projection import Image, Projector
from edge_agent.features.select import Selector
from edge_agent.settings import FeatureSettings
from splitslam.features import FeatureSet
from splitslam.scan import Scan
from tests.features.made_scan import made_scan


def seen(scan: Scan) -> tuple[Image, FeatureMarks]:
    image = Projector(16, 1800).project(scan)
    assert image.range_q is not None
    return image, FeatureMarks.of(image.range_q, image.column, image.ring_start, Limits.of(FeatureSettings()))


def features(scan: Scan, dense: bool, **settings: Any) -> tuple[FeatureSet, FeatureSet]:
    return chosen(*seen(scan), dense, **settings)


def chosen(
    image: Image, found: FeatureMarks, dense: bool, share: float = 1.0, **settings: Any
) -> tuple[FeatureSet, FeatureSet]:
    selector = Selector(FeatureSettings(**settings), 16, 1800)
    wanted = selector.find(image, found, dense)
    corners, surfs = selector.choose(image, found, dense, share)
    if share == 1.0:
        assert len(corners) + len(surfs) == wanted
    return corners, surfs


@pytest.mark.parametrize("dense", [True, False])
def test_every_feature_is_a_real_point_with_its_ring_time_and_intensity(dense: bool):
    scan = made_scan()
    known = {
        p.tobytes(): (r, t, i)
        for p, r, t, i in zip(scan.points_lidar, scan.ring, scan.t_offset_ns, scan.intensity, strict=True)
    }
    for chosen in features(scan, dense):
        assert len(chosen) >= 100
        for p, r, t, i in zip(chosen.points_lidar, chosen.ring, chosen.t_offset_ns, chosen.intensity, strict=True):
            assert known[p.tobytes()] == (r, t, i)


@pytest.mark.parametrize("dense", [True, False])
def test_features_are_sorted_by_ring_then_column_without_doubles(dense: bool):
    corners, surfs = features(made_scan(), dense)
    keys = [c.ring.astype(int) * 1800 + c.column for c in (corners, surfs)]
    for key in keys:
        assert np.all(np.diff(key) > 0)
    assert not set(keys[0]) & set(keys[1])


def test_corners_lie_on_the_pillars_and_room_edges_not_on_walls():
    corners, _ = features(made_scan(), dense=False)
    p = corners.points_lidar.astype(np.float64)
    pillars = np.array([(4.0, 2.0), (-5.0, 3.0), (2.0, -6.0), (-3.0, -8.0), (8.0, -3.0)])
    near_pillar = np.linalg.norm(p[:, None, :2] - pillars, axis=2).min(axis=1) < 1.0
    offsets = np.stack([12 - p[:, 0], p[:, 0] + 9, 7 - p[:, 1], p[:, 1] + 14, p[:, 2] + 1.5, 6 - p[:, 2]])
    near_edge = np.sort(np.abs(offsets), axis=0)[1] < 0.5  # two of the room's planes meet there
    assert np.mean(near_pillar | near_edge) > 0.7


def test_a_sparse_frame_has_the_wanted_numbers_on_all_rings_and_sides():
    corners, surfs = features(made_scan(), dense=False, sparse_corners=100, sparse_surfs=600)
    assert (len(corners), len(surfs)) == (100, 600)
    assert np.bincount(surfs.ring, minlength=16).min() >= 10
    azimuth = np.arctan2(surfs.points_lidar[:, 1], surfs.points_lidar[:, 0])
    assert np.histogram(azimuth, bins=6, range=(-np.pi, np.pi))[0].min() >= 40


def test_a_sparse_frame_has_surfs_that_face_every_way_alike():
    """However small a wall looks, it says as much about the pose as the floor does."""
    _, every = features(made_scan(), dense=True)
    _, surfs = features(made_scan(), dense=False, sparse_surfs=300)

    def shares(p: np.ndarray) -> np.ndarray:
        planes = np.abs([12 - p[:, 0], p[:, 0] + 9, 7 - p[:, 1], p[:, 1] + 14, p[:, 2] + 1.5])
        counts = (planes < 0.15).sum(axis=1)
        return counts / counts.sum()

    assert np.ptp(shares(surfs.points_lidar)) < 0.7 * np.ptp(shares(every.points_lidar))


@pytest.mark.parametrize("dense", [True, False])
def test_a_share_of_a_frame_is_an_even_share_of_its_features(dense: bool):
    image, found = seen(made_scan())
    whole, part = (sum(map(len, chosen(image, found, dense, share))) for share in (1.0, 0.3))
    assert part == pytest.approx(0.3 * whole, abs=2)
    _, surfs = chosen(image, found, dense, 0.3)
    azimuth = np.arctan2(surfs.points_lidar[:, 1], surfs.points_lidar[:, 0])
    assert np.histogram(azimuth, bins=6, range=(-np.pi, np.pi))[0].min() > 0.04 * len(surfs)


def test_a_sparse_frame_prefers_the_sharpest_corners():
    scan = made_scan()
    image, found = seen(scan)
    curvature = {(int(r), int(c)): v for r, c, v in zip(image.ring, image.column, found.d, strict=True)}
    means = []
    for dense in (True, False):
        corners, _ = features(scan, dense, sparse_corners=60)
        values = [curvature[int(r), int(c)] for r, c in zip(corners.ring, corners.column, strict=True)]
        means.append(np.median(values))
    assert means[1] > means[0]


def test_a_scan_with_fewer_features_than_wanted_gives_all_of_them():
    scan = made_scan()
    all_corners, all_surfs = features(scan, dense=True)
    corners, surfs = features(scan, dense=False, sparse_corners=10**6, sparse_surfs=10**6)
    assert len(corners) == len(all_corners)
    assert len(surfs) == len(all_surfs)
    np.testing.assert_array_equal(surfs.points_lidar, all_surfs.points_lidar)


def test_masked_points_are_never_corners():
    scan = made_scan()
    image, found = seen(scan)
    hidden = found.marks & MASKED > 0
    masked = {(int(r), int(c)) for r, c in zip(image.ring[hidden], image.column[hidden], strict=True)}
    corners, _ = chosen(image, found, True)
    assert len(masked) > 100
    assert not masked & {(int(r), int(c)) for r, c in zip(corners.ring, corners.column, strict=True)}


def test_without_an_imu_a_sparse_frame_carries_twice_as_many():
    image, found = seen(made_scan())
    selector = Selector(FeatureSettings(sparse_corners=50, sparse_surfs=300), 16, 1800)
    assert [selector.find(image, found, False, times) for times in (1.0, 2.0)] == [350, 700]
    corners, surfs = selector.choose(image, found, False)
    assert (len(corners), len(surfs)) == (100, 600)
