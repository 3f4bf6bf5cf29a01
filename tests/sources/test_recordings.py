"""The heads of the real recordings, topic choice, and every way a recording can be wrong."""

from __future__ import annotations

import shutil
from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest

from edge_agent.sources import open_recording
from splitslam.errors import InputError
from splitslam.robot import load_robot, robot_from_yaml
from splitslam.scan import GnssFix, ImuSamples, Scan, WheelSamples
from tests.sources import made_bags as made
from tests.sources.robots import RIGID, robot


def one_cloud(stamp_ns: int = made.T0_NS, topic: str = "/points_raw") -> made.Message:
    xyz, ring, fraction = made.turn()
    return made.cloud(made.structured(xyz, made.VELODYNE, 22, ring=ring, time=fraction * 0.1), stamp_ns, topic=topic)


def test_stamps_of_yard1_are_the_exact_first_firings(shared_data):
    folder = shared_data / "yard1"
    truth_ns = [int(Decimal(line.split()[0]) * 10**9) for line in (folder / "yard1.tum").read_text().splitlines()]
    recording = open_recording(folder / "yard1.bag", load_robot(folder / "yard1.yaml"), max_scans=20)
    scans = [event for _, event in recording.events() if isinstance(event, Scan)]
    assert len(scans) == 20
    # the truth file has six decimals
    assert max(abs(scan.stamp_ns - t) for scan, t in zip(scans, truth_ns, strict=False)) <= 500
    for scan in scans:
        assert 25_000 < len(scan) < 27_000
        assert (np.diff(scan.t_offset_ns) > 0).all()
        assert scan.native_bytes == 76 * 1206
    assert recording.counts.native_bytes == sum(scan.native_bytes for scan in scans)
    assert recording.counts.read_points == sum(len(scan) for scan in scans)
    assert not recording.dropped
    assert np.rad2deg(recording.beam_elevations_rad) == pytest.approx(np.arange(-15, 16, 2))


def test_a_standing_lidar_in_the_yard_sees_the_same_thing_scan_after_scan(shared_data):
    folder = shared_data / "yard1"
    recording = open_recording(folder / "yard1.bag", load_robot(folder / "yard1.yaml"), max_scans=12)
    first, *_, last = (event for _, event in recording.events() if isinstance(event, Scan))
    bins = np.arange(-180, 181)

    def profile(scan: Scan) -> np.ndarray:
        xyz = scan.points_lidar[scan.ring == 8]
        azimuth = np.rad2deg(np.arctan2(xyz[:, 1], xyz[:, 0]))
        ranges = np.linalg.norm(xyz, axis=1)
        which = np.digitize(azimuth, bins)
        return np.array([np.median(ranges[which == k]) if (which == k).any() else np.nan for k in range(1, 361)])

    assert np.nanmedian(np.abs(profile(first) - profile(last))) < 0.02


def test_max_scans_reads_on_only_until_the_imu_covers_the_last_scan(shared_data):
    folder = shared_data / "yard1"
    recording = open_recording(folder / "yard1.bag", load_robot(folder / "yard1.yaml"), max_scans=10)
    events = [event for _, event in recording.events()]
    last_scan = [event for event in events if isinstance(event, Scan)][-1]
    last_imu = [event for event in events if isinstance(event, ImuSamples)][-1]
    assert recording.counts.scans_read == 10
    assert recording.scan_count == 10
    assert 0 <= int(last_imu.stamps_ns[-1]) - last_scan.end_ns < 600_000_000
    assert 1.0 <= (recording.end_ns - recording.start_ns) * 1e-9 < 1.6


@pytest.mark.parametrize(("name", "rings", "points"), [("ring16", 16, 28_000), ("ring64_4s", 64, 118_000)])
def test_kitti_reads_with_its_own_point_times_and_estimated_elevations(shared_data, name, rings, points):
    folder = shared_data / "kitti_0005"
    recording = open_recording(
        folder / f"kitti_0005_{name}.bag", load_robot(folder / f"kitti_0005_{name}.yaml"), max_scans=2
    )
    scans = [event for _, event in recording.events() if isinstance(event, Scan)]
    assert len(scans) == 2
    assert all(len(scan) > points for scan in scans)
    assert all(0.102e9 < scan.end_ns - scan.stamp_ns < 0.105e9 for scan in scans)
    assert scans[0].intensity.max() > 200  # 0..1 in the recording
    elevations_deg = np.rad2deg(recording.beam_elevations_rad)
    assert elevations_deg.shape == (rings,)
    assert (np.diff(elevations_deg) > 0.1).all()
    assert -26 < elevations_deg[0] < -21
    assert 1.5 < elevations_deg[-1] < 3.5  # HDL-64E: -24.8 to +2


@pytest.mark.parametrize("kind", [made.ROS1, made.SQLITE3, made.MCAP])
def test_usual_topics_are_found_and_the_choice_is_said(tmp_path, kind):
    messages = [
        made.imu(made.T0_NS - 5_000_000, topic="/imu_raw"),
        made.imu(made.T0_NS, topic="/imu_other"),
        made.fix(made.T0_NS, topic="/gps/fix"),
        one_cloud(),
    ]
    recording = open_recording(made.write_bag(tmp_path, kind, messages), robot())
    assert recording.topics == {"lidar": "/points_raw", "imu": "/imu_raw", "gnss": "/gps/fix"}
    assert recording.robot.imu is not None
    assert recording.robot.imu.topic == "/imu_raw"
    for topic in recording.topics.values():
        assert any(topic in note for note in recording.notes)
    imu, gnss, scan = (event for _, event in recording.events())
    assert isinstance(imu, ImuSamples)
    assert isinstance(gnss, GnssFix)
    assert isinstance(scan, Scan)
    assert imu.stamps_ns.tolist() == [made.T0_NS - 5_000_000]
    assert imu.gyro_radps.tolist() == [[0.1, 0.2, 0.3]]
    assert imu.accel_mps2.tolist() == [[0.0, 0.0, 9.8]]
    assert (gnss.latitude_deg, gnss.longitude_deg, gnss.altitude_m) == (48.0, 11.0, 500.0)
    assert gnss.covariance_enu_m2 is not None
    assert np.diag(gnss.covariance_enu_m2).tolist() == [0.25, 0.36, 1.0]


def test_a_leading_slash_more_or_less_does_not_matter(tmp_path):
    path = made.write_bag(tmp_path, made.ROS1, [one_cloud(topic="points_raw")])
    with open_recording(path, robot("rings: 3, topic: /points_raw")) as recording:
        assert recording.topics["lidar"] == "points_raw"


def test_the_imu_offset_of_the_robot_file_moves_its_stamps(tmp_path):
    path = made.write_bag(tmp_path, made.ROS1, [made.imu(made.T0_NS), one_cloud()])
    recording = open_recording(path, robot(rest=f"imu: {{time_offset_ns: -7000}}\n{RIGID}"))
    imu = next(event for _, event in recording.events() if isinstance(event, ImuSamples))
    assert imu.stamps_ns.tolist() == [made.T0_NS - 7000]


def test_bad_imu_and_gnss_messages_are_dropped_by_reason(tmp_path):
    messages = [
        made.imu(made.T0_NS, gyro=(0.0, np.nan, 0.0)),
        made.imu(made.T0_NS + 1),
        made.fix(made.T0_NS + 2, status=-1),
        made.fix(made.T0_NS + 3, latitude=np.nan),
        made.fix(made.T0_NS + 4, covariance_type=0),
        one_cloud(),
    ]
    recording = open_recording(made.write_bag(tmp_path, made.ROS1, messages), robot())
    imu, gnss, _ = (event for _, event in recording.events())
    assert recording.dropped == {"imu_nan": 1, "gnss_no_fix": 1, "gnss_nan": 1}
    assert recording.counts.imu_messages == 2
    assert isinstance(imu, ImuSamples)
    assert isinstance(gnss, GnssFix)
    assert gnss.covariance_enu_m2 is None


WHEELS = f"imu: null\ngnss: null\nwheels: {{}}\n{RIGID}"


@pytest.mark.parametrize("kind", [made.ROS1, made.SQLITE3, made.MCAP])
def test_the_twist_of_wheel_odometry_is_read_and_its_pose_is_not(tmp_path, kind):
    path = made.write_bag(tmp_path, kind, [made.wheels(made.T0_NS), one_cloud()])
    rest = f"imu: null\nwheels: {{time_offset_ns: -7000}}\n{RIGID}"
    wheels, _ = (event for _, event in open_recording(path, robot(rest=rest)).events())
    assert isinstance(wheels, WheelSamples)
    assert wheels.stamps_ns.tolist() == [made.T0_NS - 7000]
    assert wheels.velocity_mps.tolist() == [[1.2, 0.1]]
    assert wheels.yaw_rate_radps.tolist() == [0.3]


def test_bad_wheel_messages_are_dropped_by_reason(tmp_path):
    messages = [
        made.wheels(made.T0_NS, velocity=(np.nan, 0.0, 0.0)),
        made.wheels(made.T0_NS + 1, yaw_rate=np.inf),
        made.wheels(made.T0_NS + 2, velocity=(1e9, 0.0, 0.0)),
        made.wheels(made.T0_NS + 3),
        one_cloud(),
    ]
    recording = open_recording(made.write_bag(tmp_path, made.ROS1, messages), robot(rest=WHEELS))
    assert [type(event) for _, event in recording.events()] == [WheelSamples, Scan]
    assert recording.dropped == {"wheel_nan": 2, "wheel_range": 1}


@pytest.mark.parametrize("topic", ["/odom", "/wheel/odom", "wheel_odometry"])
def test_odometry_is_wheels_only_when_the_robot_file_says_that_there_are_some(tmp_path, topic):
    path = made.write_bag(tmp_path, made.ROS1, [made.wheels(made.T0_NS, topic=topic), one_cloud()])
    with open_recording(path, robot()) as recording:
        assert recording.topics == {"lidar": "/points_raw"}
        assert recording.robot.wheels is None
    with open_recording(path, robot(rest=WHEELS)) as recording:
        assert recording.topics["wheels"] == topic
        assert any(f"wheels: topic {topic}" in note for note in recording.notes)


def test_the_best_of_several_usual_wheel_topics_is_taken_and_an_unusual_one_never(tmp_path):
    both = [made.wheels(made.T0_NS, topic=topic) for topic in ("/odom", "/slam/odometry", "/wheel/odom")]
    (tmp_path / "a").mkdir()
    with open_recording(made.write_bag(tmp_path / "a", made.ROS1, [*both, one_cloud()]), robot(rest=WHEELS)) as read:
        assert read.topics["wheels"] == "/wheel/odom"
    path = made.write_bag(tmp_path, made.ROS1, [both[1], one_cloud()])
    says(path, "wheels.topic: must be given, one of: /slam/odometry", f"lidar: {{rings: 3}}\n{WHEELS}")


def test_a_robot_file_with_wheels_and_a_recording_without_goes_without(tmp_path):
    with open_recording(made.write_bag(tmp_path, made.ROS1, [one_cloud()]), robot(rest=WHEELS)) as recording:
        assert recording.robot.wheels is None
        assert "wheels: none in the recording" in recording.notes


def says(path: Path, text: str, with_robot: str = "lidar: {rings: 3}\nimu: null\ngnss: null") -> None:
    with pytest.raises(InputError, match=text) as error:
        open_recording(path, robot_from_yaml(with_robot))
    assert "\n" not in str(error.value)
    assert str(path) in str(error.value)


def test_a_missing_file_is_named(tmp_path):
    says(tmp_path / "no.bag", "no such recording")


def test_a_file_that_is_no_recording_is_named(tmp_path):
    (tmp_path / "a.bag").write_bytes(b"hello")
    (tmp_path / "a.txt").write_bytes(b"hello")
    (tmp_path / "a.mcap").write_bytes(b"hello")
    (tmp_path / "folder").mkdir()
    for name in ("a.bag", "a.txt", "a.mcap", "folder"):
        says(tmp_path / name, "not a recording.*expected a ROS 1 .bag")


@pytest.mark.parametrize("kind", [made.ROS1, made.SQLITE3, made.MCAP])
def test_a_truncated_recording_is_an_error(tmp_path, kind):
    path = made.write_bag(tmp_path, kind, [one_cloud(made.T0_NS + k * 10**8) for k in range(5)])
    file = path if path.is_file() else next(p for p in path.iterdir() if p.suffix in (".db3", ".mcap"))
    raw = file.read_bytes()
    file.write_bytes(raw[: len(raw) * 2 // 3])
    with pytest.raises(InputError, match=r"truncated|damaged") as error:
        list(open_recording(path, robot()).events())
    assert "\n" not in str(error.value)


def test_a_named_topic_that_is_missing_lists_those_there_are(tmp_path):
    path = made.write_bag(tmp_path, made.ROS1, [made.imu(made.T0_NS), one_cloud()])
    wanted = "lidar: {rings: 3, topic: /cloud}\nimu: null"
    says(path, r"no topic /cloud; there are: /imu_raw \(sensor_msgs/Imu\), /points_raw \(sensor_msgs/Point", wanted)


def test_a_topic_of_the_wrong_type_is_an_error(tmp_path):
    path = made.write_bag(tmp_path, made.ROS1, [made.imu(made.T0_NS), one_cloud()])
    wanted = "lidar: {rings: 3, topic: /imu_raw}\nimu: null"
    says(path, r"lidar.topic: /imu_raw is sensor_msgs/Imu, expected sensor_msgs/PointCloud2 or velodyne", wanted)


def test_several_lidars_and_none_usual_must_be_told_apart(tmp_path):
    path = made.write_bag(tmp_path, made.ROS1, [one_cloud(topic="/front"), one_cloud(topic="/rear")])
    says(path, "lidar.topic: must be given, one of: /front, /rear")


def test_a_recording_without_scans_is_an_error(tmp_path):
    says(made.write_bag(tmp_path, made.ROS1, [made.imu(made.T0_NS)]), "no scans")


def test_an_imu_needs_its_place_on_the_robot(tmp_path):
    path = made.write_bag(tmp_path, made.ROS1, [made.imu(made.T0_NS), one_cloud()])
    says(path, "T_lidar_imu: must be given", "lidar: {rings: 3}")


def test_a_single_storage_file_opens_like_its_folder(tmp_path):
    path = made.write_bag(tmp_path, made.MCAP, [one_cloud()])
    file = next(path.glob("*.mcap"))
    alone = tmp_path / "alone.mcap"
    shutil.copy(file, alone)
    assert len(list(open_recording(alone, robot()).events())) == 1
