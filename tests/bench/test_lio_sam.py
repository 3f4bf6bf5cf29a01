"""What LIO-SAM's nodes would send: bytes counted by hand, features by its rules."""

from __future__ import annotations

import numpy as np

from edge_agent.features.integer import FeatureMarks, Limits
from edge_agent.features.projection import Image, Projector
from edge_agent.features.select import Selector
from edge_agent.settings import FeatureSettings
from edge_agent.tally import RAW_POINT_BYTES
from splitslam.bench import lio_sam
from tests.features.made_scan import made_scan

RINGS, COLUMNS = 16, 1800


def image() -> Image:
    return Projector(RINGS, COLUMNS).project(made_scan())


def lio_sams_marks(made: Image) -> FeatureMarks:
    assert made.range_q is not None
    return FeatureMarks.of(made.range_q, made.column, made.ring_start, Limits.of(lio_sam.SETTINGS))


def test_a_raw_point_is_what_the_paper_says():
    scan = made_scan()
    message = lio_sam.raw_message(scan.points_lidar, scan.ring, scan.t_offset_ns)
    assert len(message) == RAW_POINT_BYTES * len(scan) == 18 * len(scan)
    back = np.frombuffer(message, lio_sam.RAW_POINT)
    assert np.array_equal(back["xyz"], scan.points_lidar)
    assert np.array_equal(back["ring"], scan.ring)


def test_a_deskewed_point_is_20_bytes_and_the_rest_is_cloud_infos_head():
    made = image()
    message = lio_sam.deskewed_message(made)
    # header 25, flags and initial guess 52, four array lengths 16, two int32 a ring
    assert len(message) == 20 * len(made) + 25 + 52 + 16 + 8 * RINGS
    ranges = np.frombuffer(message, "<f4", len(made), len(message) - 8 * len(made))
    assert np.allclose(ranges, np.linalg.norm(made.points_lidar, axis=1), atol=2e-3)


def test_a_feature_is_12_bytes():
    made = image()
    corners, surfs = np.arange(3), np.arange(10, 50)
    message = lio_sam.feature_message(made, corners, surfs)
    assert len(message) == 12 * 43 + 25 + 52
    assert np.array_equal(np.frombuffer(message[-12 * 40 :], "<f4").reshape(-1, 3), made.points_lidar[surfs])


def test_ros_sends_ranges_and_columns_at_full_length_and_32_bytes_a_point():
    """230,544 B of arrays a scan were seen between LIO-SAM's own nodes, whatever the number of points."""
    head, cloud, empty = 25 + 52, 25 + 8 + 68 + 14, 16 + 8 + 4 + 14
    assert lio_sam.ros_bytes(RINGS, COLUMNS, 26_000) == head + 230_544 + cloud + 6 * empty + 32 * 26_000
    with_features = lio_sam.ros_bytes(RINGS, COLUMNS, 26_000, 6_000)
    assert with_features == head + 16 + 3 * cloud + 4 * empty + 32 * 32_000


def test_lio_sams_features_are_those_of_our_dense_frames_at_its_settings():
    made = image()
    marks = lio_sams_marks(made)
    corners, surfs = lio_sam.LioSamFeatures(RINGS, COLUMNS).select(made, marks)
    selector = Selector(lio_sam.SETTINGS, RINGS, COLUMNS)
    selector.find(made, marks, dense=True)
    ours = selector.choose(made, marks, dense=True)
    assert np.array_equal(made.points_lidar[corners], ours[0].points_lidar)
    assert np.array_equal(made.points_lidar[surfs], ours[1].points_lidar)
    assert len(corners) > 0
    assert len(surfs) > 0


def test_a_larger_voxel_leaves_fewer_surfs_and_the_same_corners():
    made, features = image(), lio_sam.LioSamFeatures(RINGS, COLUMNS)
    marks = lio_sams_marks(made)
    (corners, fine), (same, coarse) = features.select(made, marks), features.select(made, marks, leaf_m=2.0)
    assert np.array_equal(corners, same)
    assert len(coarse) < 0.6 * len(fine)


def test_the_settings_are_lio_sams_whatever_our_defaults_become():
    s = lio_sam.SETTINGS
    assert (s.corner_threshold_m2, s.surf_threshold_m2, s.surf_leaf_m) == (1.0, 0.1, 0.4)
    assert (s.corners_per_sector, s.sectors) == (20, 6)
    assert isinstance(s, FeatureSettings)
