"""PointCloud2 in the layouts drivers write."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from edge_agent.sources import open_recording
from splitslam.errors import DataError, InputError
from splitslam.scan import Scan
from tests.sources import made_bags as made
from tests.sources.robots import robot

PERIOD_NS = 100_000_000
KINDS = [made.ROS1, made.SQLITE3, made.MCAP]


def scans_of(path: Path, lidar: str = "rings: 3") -> list[Scan]:
    return [event for _, event in open_recording(path, robot(lidar)).events() if isinstance(event, Scan)]


def velodyne(offset_s: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    xyz, ring, fraction = made.turn()
    time_s = (fraction * 0.1 + offset_s).astype(np.float32)
    return made.structured(xyz, made.VELODYNE, 22, intensity=42.4, ring=ring, time=time_s), fraction


@pytest.mark.parametrize("kind", KINDS)
def test_velodyne_seconds_become_nanoseconds_after_the_header_in_every_container(tmp_path, kind):
    points, fraction = velodyne()
    (scan,) = scans_of(made.write_bag(tmp_path, kind, [made.cloud(points, made.T0_NS)]))
    assert scan.stamp_ns == made.T0_NS
    assert np.abs(scan.t_offset_ns - fraction * PERIOD_NS).max() <= 10
    assert scan.end_ns == scan.stamp_ns + int(scan.t_offset_ns.max())
    assert (scan.ring == np.arange(300) % 3).all()
    assert (scan.intensity == 42).all()
    assert scan.points_lidar.dtype == np.float32
    assert scan.t_offset_ns.dtype == np.int32
    assert scan.points_lidar.flags.c_contiguous


def test_negative_offsets_put_the_first_firing_before_the_header(tmp_path):
    points, fraction = velodyne(offset_s=-0.09)
    (scan,) = scans_of(made.write_bag(tmp_path, made.ROS1, [made.cloud(points, made.T0_NS)]), "rings: 3, stamp: end")
    assert abs(scan.stamp_ns - (made.T0_NS - 90_000_000)) <= 10
    assert np.abs(scan.t_offset_ns - fraction * PERIOD_NS).max() <= 20


def test_a_header_of_the_scan_end_with_offsets_from_its_start_is_moved_back(tmp_path):
    points, _ = velodyne()
    (scan,) = scans_of(made.write_bag(tmp_path, made.ROS1, [made.cloud(points, made.T0_NS)]), "rings: 3, stamp: end")
    assert scan.end_ns == made.T0_NS
    assert scan.stamp_ns == made.T0_NS - int(scan.t_offset_ns.max())


def test_the_reference_time_is_the_first_firing_even_when_the_gate_removes_its_point(tmp_path):
    points, _ = velodyne(offset_s=0.002)
    for axis in "xyz":
        points[axis][:30] *= 0.01  # the first ten columns are too near
    (scan,) = scans_of(made.write_bag(tmp_path, made.ROS1, [made.cloud(points, made.T0_NS)]))
    assert len(scan) == 270
    assert abs(scan.stamp_ns - (made.T0_NS + 2_000_000)) <= 10
    assert scan.t_offset_ns.min() == pytest.approx(10_000_000, abs=20)
    assert scan.read_points == 300


def test_ouster_nanoseconds_organised_with_zeros_padding_and_u8_rings(tmp_path):
    xyz, ring, fraction = made.turn(64)
    order = np.argsort(ring, kind="stable")  # row by row, as the driver publishes
    t = (fraction[order] * PERIOD_NS).astype(np.uint32)
    points = made.structured(xyz[order], made.OUSTER, 48, t=t, ring=ring[order], reflectivity=7, intensity=3000.0)
    for axis in "xyz":
        points[axis][5] = 0.0  # no return
    path = made.write_bag(tmp_path, made.MCAP, [made.cloud(points, made.T0_NS, height=3, row_padding=16)])
    recording = open_recording(path, robot("model: ouster, rings: 3"))
    (scan,) = [event for _, event in recording.events()]
    assert isinstance(scan, Scan)
    assert recording.counts.left_out == {"zero": 1}
    keep = np.arange(192) != 5
    assert (scan.t_offset_ns == t[keep]).all()
    assert (scan.ring == ring[order][keep]).all()
    assert (scan.intensity == 255).all()


def test_hesai_absolute_seconds_keep_microseconds(tmp_path, shared_data):
    xyz = read_xyz_pcd(shared_data / "fixtures" / "hesai" / "xt32_reference.pcd")
    elevation_deg = np.rad2deg(np.arctan2(xyz[:, 2], np.hypot(xyz[:, 0], xyz[:, 1])))
    ring = np.clip(np.rint(15.0 - elevation_deg), 0, 31)  # Hesai counts from the top
    offset_ns = np.arange(len(xyz)) * (PERIOD_NS // len(xyz))
    seconds = made.T0_NS // 10**9 + (made.T0_NS % 10**9 + offset_ns) * 1e-9
    points = made.structured(xyz, made.HESAI, 48, ring=ring, timestamp=seconds, intensity=10.0)
    path = made.write_bag(tmp_path, made.SQLITE3, [made.cloud(points, made.T0_NS, topic="/hesai/pandar")])
    lidar = "model: hesai, min_range_m: 0, max_range_m: 300"
    recording = open_recording(path, robot(lidar))
    (scan,) = [event for _, event in recording.events()]
    assert isinstance(scan, Scan)
    assert len(scan) == len(xyz) == 63021
    assert abs(scan.stamp_ns - made.T0_NS) < 500
    assert np.abs(scan.t_offset_ns - offset_ns).max() < 500
    # ring 0 is the top one, and the table estimated from the scan says so
    elevations_deg = np.rad2deg(recording.beam_elevations_rad)
    assert np.abs(elevations_deg - np.arange(15, -17, -1)).max() < 0.6


def test_point_times_of_another_clock_count_only_as_differences_and_this_is_said(tmp_path):
    xyz, ring, fraction = made.turn()
    points = made.structured(xyz, made.HESAI, 48, ring=ring, timestamp=1.0e9 + fraction * 0.1)
    recording = open_recording(made.write_bag(tmp_path, made.ROS1, [made.cloud(points, made.T0_NS)]), robot())
    (scan,) = [event for _, event in recording.events()]
    assert isinstance(scan, Scan)
    assert scan.stamp_ns == made.T0_NS
    assert np.abs(scan.t_offset_ns - fraction * PERIOD_NS).max() < 500
    assert any("another clock" in note for note in recording.notes)


def test_big_endian_padded_float64_points_read_as_any_other(tmp_path):
    xyz, ring, fraction = made.turn()
    layout = [("z", "<f8", 0), ("ring", "<u2", 8), ("x", "<f8", 16), ("time", "<f4", 24), ("y", "<f8", 32)]
    points = made.structured(xyz, layout, 64, ring=ring, time=fraction * 0.1)
    path = made.write_bag(
        tmp_path, made.ROS1, [made.cloud(points, made.T0_NS, big_endian=True, height=2, row_padding=5)]
    )
    (scan,) = scans_of(path)
    assert (scan.points_lidar == xyz).all()
    assert (scan.ring == ring).all()
    assert np.abs(scan.t_offset_ns - fraction * PERIOD_NS).max() <= 10


def test_without_ring_it_comes_from_the_elevation(tmp_path):
    xyz, ring, fraction = made.turn()
    layout = [*made.PLAIN, ("time", "<f4", 12)]
    points = made.structured(xyz, layout, 16, time=fraction * 0.1)
    path = made.write_bag(tmp_path, made.ROS1, [made.cloud(points, made.T0_NS)])
    recording = open_recording(path, robot())
    (scan,) = [event for _, event in recording.events()]
    assert isinstance(scan, Scan)
    assert (scan.ring == ring).all()
    assert np.rad2deg(recording.beam_elevations_rad) == pytest.approx([-10, 0, 10], abs=0.02)


@pytest.mark.parametrize("row_by_row", [False, True])
def test_without_time_it_comes_from_the_azimuth_and_this_is_said(tmp_path, row_by_row):
    xyz, ring, fraction = made.turn()
    order = np.argsort(ring, kind="stable") if row_by_row else np.arange(len(ring))
    points = made.structured(xyz[order], [*made.PLAIN, ("ring", "<u1", 12)], 16, ring=ring[order])
    path = made.write_bag(tmp_path, made.ROS1, [made.cloud(points, made.T0_NS)])
    recording = open_recording(path, robot())
    assert any("no time" in note for note in recording.notes)
    (scan,) = [event for _, event in recording.events()]
    assert isinstance(scan, Scan)
    assert scan.stamp_ns == made.T0_NS
    assert np.abs(scan.t_offset_ns - fraction[order] * PERIOD_NS).max() <= 1000


def test_a_ring_that_fires_a_little_behind_the_first_one_is_not_put_at_the_end_of_the_turn(tmp_path):
    xyz, ring, fraction = made.turn()
    late = -2 * np.pi * (ring == 1) * -0.004  # ring 1 looks 1.4 deg back
    c, s = np.cos(late), np.sin(late)
    xyz = np.stack([c * xyz[:, 0] - s * xyz[:, 1], s * xyz[:, 0] + c * xyz[:, 1], xyz[:, 2]], axis=1)
    points = made.structured(xyz, [*made.PLAIN, ("ring", "<u1", 12)], 16, ring=ring)
    (scan,) = scans_of(made.write_bag(tmp_path, made.ROS1, [made.cloud(points, made.T0_NS)]))
    assert np.abs(scan.t_offset_ns - fraction * PERIOD_NS).max() < 0.005 * PERIOD_NS


def test_ring_numbers_that_cannot_be_are_left_out_and_counted(tmp_path):
    points, _ = velodyne()
    bad = points.copy()
    bad["ring"][:2] = 3
    messages = [made.cloud(points, made.T0_NS), made.cloud(bad, made.T0_NS + PERIOD_NS)]
    recording = open_recording(
        made.write_bag(tmp_path, made.ROS1, messages),
        robot("model: generic, rings: 3, beam_elevations_deg: [-10, 0, 10]"),
    )
    first, second = (event for _, event in recording.events())
    assert isinstance(first, Scan)
    assert isinstance(second, Scan)
    assert (len(first), len(second)) == (300, 298)
    assert recording.counts.left_out == {"unknown_ring": 2}


def test_nan_and_zero_points_are_removed_and_counted(tmp_path):
    points, _ = velodyne()
    points["x"][3], points["y"][4], points["z"][5] = np.nan, np.inf, np.nan
    for axis in "xyz":
        points[axis][7] = 0.0
        points[axis][9] *= 1000.0
    recording = open_recording(made.write_bag(tmp_path, made.ROS1, [made.cloud(points, made.T0_NS)]), robot())
    (scan,) = [event for _, event in recording.events()]
    assert isinstance(scan, Scan)
    assert len(scan) == 295
    assert recording.counts.left_out == {"nan": 3, "zero": 1, "gated": 1}


def test_masts_are_cut_out_in_the_body_frame(tmp_path):
    points, _ = velodyne()
    body = "T_body_lidar: [[1, 0, 0, 100], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]"
    path = made.write_bag(tmp_path, made.ROS1, [made.cloud(points, made.T0_NS)])
    box = robot("rings: 3, crop_boxes_body: [[105, -1, -5, 115, 1, 5]]", f"imu: null\n{body}")
    recording = open_recording(path, box)
    (scan,) = [event for _, event in recording.events()]
    assert isinstance(scan, Scan)
    ahead = (points["x"] > 5) & (np.abs(points["y"]) <= 1)
    assert recording.counts.left_out == {"cropped": ahead.sum()}
    assert ahead.sum() > 0
    assert len(scan) == 300 - ahead.sum()


def test_unit_intensity_is_scaled_and_kept_at_that_scale(tmp_path):
    dark, _ = velodyne()
    dark["intensity"] = np.linspace(0, 1, 300)
    (scan,) = scans_of(made.write_bag(tmp_path, made.ROS1, [made.cloud(dark, made.T0_NS)]))
    assert scan.intensity[0] == 0
    assert scan.intensity[-1] == 255


def test_a_damaged_cloud_in_the_stream_is_dropped_and_counted(tmp_path):
    points, _ = velodyne()
    good = [made.cloud(points, made.T0_NS + k * PERIOD_NS) for k in range(4)]
    good[1][3]["data"] = good[1][3]["data"][:100]
    good[2][3]["width"], good[2][3]["data"], good[2][3]["row_step"] = 0, np.zeros(0, np.uint8), 0
    points = points.copy()
    points["x"] = np.nan
    messages = [*good, made.cloud(points, made.T0_NS + 4 * PERIOD_NS)]
    recording = open_recording(made.write_bag(tmp_path, made.ROS1, messages), robot())
    assert len(list(recording.events())) == 2
    assert recording.dropped == {"decode": 1, "empty": 1, "nan": 1}
    assert recording.counts.scans_read == 5


def test_more_rings_than_the_robot_file_says_is_an_error_that_says_how_many(tmp_path):
    points, _ = velodyne()
    path = made.write_bag(tmp_path, made.ROS1, [made.cloud(points, made.T0_NS)])
    with pytest.raises(InputError, match=r"lidar.rings: 2, but ring numbers go up to 2; expected at least 3"):
        open_recording(path, robot("rings: 2"))


def test_points_without_coordinates_are_no_scan(tmp_path):
    points = made.structured(np.zeros((5, 3)), [*made.PLAIN], 12)
    message = made.cloud(points, made.T0_NS)
    message[3]["fields"] = message[3]["fields"][:2]
    with pytest.raises(InputError, match="no field z"):
        open_recording(made.write_bag(tmp_path, made.ROS1, [message]), robot())


def read_xyz_pcd(path: Path) -> np.ndarray:
    raw = path.read_bytes()
    body = raw.index(b"DATA binary\n") + len(b"DATA binary\n")
    return np.frombuffer(raw[body:], "<f4").reshape(-1, 3)


def test_a_scan_of_two_seconds_does_not_fit_and_is_dropped():
    from collections import Counter

    from edge_agent.sources.raw import Gate, RawScan

    raw = RawScan(
        0,
        2_500_000_000,
        np.ones((2, 3), np.float32),
        np.array([0, 2_500_000_000]),
        np.zeros(2, int),
        np.zeros(2, np.uint8),
    )
    with pytest.raises(DataError, match="point_time"):
        Gate(robot(), Counter())(raw)


def test_times_that_run_backwards_are_mirrored_with_the_points_and_stamps_stay(tmp_path):
    points, fraction = velodyne()
    bag = made.write_bag(tmp_path, made.ROS1, [made.cloud(points, made.T0_NS)])
    (given,), (mirrored,) = scans_of(bag), scans_of(bag, "rings: 3, point_times: mirrored")
    assert np.abs(mirrored.t_offset_ns[::-1] - (fraction.max() - fraction) * PERIOD_NS).max() <= 20
    assert (mirrored.stamp_ns, mirrored.end_ns) == (given.stamp_ns, given.end_ns)
    assert (mirrored.points_lidar[::-1] == given.points_lidar).all()  # in the order of time, as they were
    assert (mirrored.ring[::-1] == given.ring).all()
    assert (np.diff(mirrored.t_offset_ns) >= 0).all()


def test_points_of_one_moment_all_have_the_time_of_the_scans_start(tmp_path):
    points, _ = velodyne()
    (scan,) = scans_of(
        made.write_bag(tmp_path, made.ROS1, [made.cloud(points, made.T0_NS)]), "rings: 3, point_times: one_moment"
    )
    assert (scan.t_offset_ns == 0).all()
    assert scan.end_ns > scan.stamp_ns
