"""A made drive against its own truth: what was written is decoded with the libraries users have, and checked."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import velodyne_decoder as vd
from numpy.typing import NDArray
from rosbags.rosbag1 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from splitslam.robot import load_robot
from splitslam.sim import DEMO, DriveSpec, SimRecording, simulate
from splitslam.sim.lidar import ORIGIN_UP_M
from splitslam.sim.spec import Perturbations
from splitslam.sim.trajectory import Trajectory, make_trajectory
from splitslam.sim.world import World, make_world
from tests.sim.drives import SHORT

Points = NDArray[np.float64]


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> SimRecording:
    return simulate(SHORT, tmp_path_factory.mktemp("drive"))


@pytest.fixture(scope="module")
def world() -> World:
    return make_world(SHORT.world)


@pytest.fixture(scope="module")
def trajectory(world: World) -> Trajectory:
    return make_trajectory(SHORT.path, world.place, SHORT.duration_s)


def test_points_seen_from_their_own_firing_time_lie_on_surfaces(
    recording: SimRecording, world: World, trajectory: Trajectory
) -> None:
    own_time, scan_start = [], []
    for message in _messages(recording, "/velodyne_packets")[-5:]:  # the head turns at 100 deg/s
        points, laser, t_s = _decoded(message)
        own_time.append(_residual_m(world, trajectory, points, laser, t_s))
        scan_start.append(_residual_m(world, trajectory, points, laser, np.full_like(t_s, t_s[0])))
    skewed_m, frozen_m = np.concatenate(own_time), np.concatenate(scan_start)
    near = np.abs(skewed_m) < 0.05
    # Beams that graze an edge miss it by the packet's 0.01 deg: the rest must be pure range noise.
    assert near.mean() > 0.96
    assert abs(skewed_m[near].mean()) < 0.001
    assert skewed_m[near].std() == pytest.approx(SHORT.lidar.range_noise_m, rel=0.1)
    assert (np.abs(frozen_m) < 0.05).mean() < 0.75, "the scans must be skewed: one pose for all points must not do"


def test_the_scans_follow_each_other_without_gap_as_the_sensor_sends_them(recording: SimRecording) -> None:
    scans = _messages(recording, "/velodyne_packets")
    assert len(scans) == round(SHORT.duration_s * SHORT.lidar.rate_hz)
    stamps = [_ns(packet.stamp) for scan in scans for packet in scan.packets]
    assert set(np.diff(stamps)) == {24 * 55_296}
    assert {len(scan.packets) for scan in scans} <= {75, 76}
    assert all(_ns(scan.header.stamp) == _ns(scan.packets[0].stamp) for scan in scans)
    starts = [int.from_bytes(bytes(scan.packets[0].data[2:4]), "little") for scan in scans]
    assert max(starts) < 36_000 * 24 * 55_296e-9 * SHORT.lidar.rate_hz


def test_the_truth_holds_the_pose_at_each_scans_first_firing(recording: SimRecording, trajectory: Trajectory) -> None:
    lines = [line.split() for line in recording.truth_path.read_text().splitlines()]
    headers = [_ns(scan.header.stamp) for scan in _messages(recording, "/velodyne_packets")]
    assert [int(stamp.replace(".", "")) for stamp, *_ in lines] == headers
    _, position = trajectory.poses((np.array(headers) - SHORT.start_ns) * 1e-9)
    np.testing.assert_allclose(np.array([row[1:4] for row in lines], float), position, atol=1e-8)


def test_a_standing_start_reads_plus_g(recording: SimRecording) -> None:
    imu = _messages(recording, "/imu/data")
    standing = [m for m in imu if _ns(m.header.stamp) < SHORT.start_ns + SHORT.path.stand_s * 1e9]
    force = np.mean([(a.x, a.y, a.z) for a in (m.linear_acceleration for m in standing)], axis=0)
    turning = np.mean([(w.x, w.y, w.z) for w in (m.angular_velocity for m in standing)], axis=0)
    assert np.linalg.norm(force) == pytest.approx(SHORT.gravity_mps2, abs=4 * SHORT.imu.accel_bias_mps2)
    assert force[2] > 0.99 * SHORT.gravity_mps2
    assert np.abs(turning).max() < 4 * SHORT.imu.gyro_bias_radps


def test_the_imu_covers_every_scan(recording: SimRecording) -> None:
    last = _messages(recording, "/velodyne_packets")[-1].packets[-1]
    assert _ns(_messages(recording, "/imu/data")[-1].header.stamp) > _ns(last.stamp) + 24 * 55_296


def test_the_robot_file_describes_the_sensors(recording: SimRecording) -> None:
    robot = load_robot(recording.robot_path)
    assert robot.imu is not None
    assert robot.gnss is not None
    assert (robot.robot.id, robot.lidar.model, robot.imu.rate_hz) == ("short", "vlp16", 500)
    np.testing.assert_allclose(robot.T_lidar_imu[:3, 3], SHORT.imu.lever_m)


def test_the_same_spec_gives_the_same_bytes_and_another_seed_does_not(recording: SimRecording, tmp_path: Path) -> None:
    again = simulate(SHORT, tmp_path / "again")
    for first, second in ((recording.bag_path, again.bag_path), (recording.truth_path, again.truth_path)):
        assert first.read_bytes() == second.read_bytes()
    other = simulate(replace(SHORT, seed=SHORT.seed + 1), tmp_path / "other")
    assert other.bag_path.read_bytes() != recording.bag_path.read_bytes()
    assert other.truth_path.read_bytes() == recording.truth_path.read_bytes(), (
        "the seed is the noise's, not the drive's"
    )


def test_people_are_seen_and_they_move(tmp_path: Path, recording: SimRecording) -> None:
    spec = replace(SHORT, perturbations=Perturbations(walking_people=6))
    crowded = _messages(simulate(spec, tmp_path), "/velodyne_packets")
    empty = _messages(recording, "/velodyne_packets")
    seen = [_ranges_m(c) < _ranges_m(e) - 0.3 for c, e in zip(crowded, empty, strict=True)]
    assert 20 < seen[0].sum() < 2_000
    azimuth = [np.flatnonzero(s.any(axis=1)) for s in (seen[0], seen[-1])]
    assert not set(azimuth[0]) >= set(azimuth[1])


def test_the_demo_returns_to_where_it_began() -> None:
    t_s = np.arange(0.0, DEMO.duration_s, 0.05)
    way = make_trajectory(DEMO.path, make_world(DEMO.world).place, DEMO.duration_s).poses(t_s)[1]
    back = np.linalg.norm(way[t_s > 35.0, None, :2] - way[t_s < 12.0][None, :, :2], axis=2)
    assert back.min(axis=1)[-1] < 0.2, "the last metres are those of the start, more than 30 s later"


def _messages(recording: SimRecording, topic: str) -> list[Any]:
    store = get_typestore(Stores.ROS1_NOETIC)
    with Reader(recording.bag_path) as bag:
        connections = [c for c in bag.connections if c.topic == topic]
        for c in connections:
            store.register(get_types_from_msg(c.msgdef.data, c.msgtype))
        return [store.deserialize_ros1(raw, c.msgtype) for c, _, raw in bag.messages(connections)]


def _decoded(scan: Any) -> tuple[Points, NDArray[np.int64], Points]:
    """Points in the lidar frame, ring (lowest first) and time since the drive's start, s."""
    decoder = vd.ScanDecoder(vd.Config(model=vd.Model.VLP16, timestamp_first_packet=True))
    sent = [vd.VelodynePacket(_ns(p.stamp) * 1e-9, bytes(p.data)) for p in scan.packets]
    _, cloud = decoder.decode(vd.PacketVector(sent))
    t_s = (_ns(scan.header.stamp) - SHORT.start_ns) * 1e-9 + cloud[:, 4].astype(float)
    return cloud[:, :3].astype(float), cloud[:, 6].astype(int), t_s


def _residual_m(world: World, trajectory: Trajectory, points: Points, ring: NDArray[np.int64], t_s: Points) -> Points:
    """How far behind the first surface each point lies, along its own beam."""
    R, position = trajectory.poses(t_s)
    beam = points.copy()
    beam[:, 2] -= np.sort(ORIGIN_UP_M)[::-1][ring]
    origin = position + R[:, :, 2] * np.sort(ORIGIN_UP_M)[::-1][ring][:, None]
    range_m = np.linalg.norm(beam, axis=1)
    direction = np.einsum("nij,nj->ni", R, beam / range_m[:, None])
    return range_m - world.cast(origin, direction).range_m


def _ranges_m(scan: Any) -> Points:
    """(firings, 16); no return is far away."""
    blocks = np.concatenate([np.frombuffer(bytes(p.data)[:1200], np.uint8) for p in scan.packets]).reshape(-1, 100)
    raw = np.ascontiguousarray(blocks[:, 4:].reshape(-1, 3)[:, :2]).view("<u2").reshape(-1, 16) * 0.002
    return np.where(raw > 0, raw, 200.0)


def _ns(time: Any) -> int:
    return time.sec * 10**9 + time.nanosec


def test_a_drive_may_have_no_gnss(tmp_path: Path) -> None:
    spec: DriveSpec = replace(SHORT, gnss=None, duration_s=0.5)
    made = simulate(spec, tmp_path)
    with Reader(made.bag_path) as bag:
        assert set(bag.topics) == {"/velodyne_packets", "/imu/data"}
    assert load_robot(made.robot_path).gnss is None
