"""The robot file: defaults, round trip, and one line for every mistake."""

from __future__ import annotations

import json
import pickle

import numpy as np
import pytest

from splitslam.errors import InputError
from splitslam.robot import Robot, load_robot, robot_from_yaml, robot_to_yaml

RIGID = "T_lidar_imu: [[1, 0, 0, 0.5], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]"


def wrong(text: str) -> str:
    """The error of a robot file, which must be one line."""
    with pytest.raises(InputError) as error:
        robot_from_yaml(text, "robot.yaml")
    line = str(error.value)
    assert "\n" not in line
    assert line.startswith("robot.yaml")
    return line


def test_the_example_of_the_conventions_loads_as_written():
    robot = robot_from_yaml(EXAMPLE)
    assert robot.robot.id == "rover-7"
    assert robot.lidar.model == "vlp16"
    assert robot.imu is not None
    assert robot.imu.gyro_noise_radps_rthz == 1.2e-4
    assert robot.gnss is not None
    assert robot.gnss.t_lidar_antenna_m == (0.0, 0.0, 0.0)
    assert robot.T_lidar_imu.dtype == np.float64
    assert robot.T_lidar_imu[0, 3] == 0.5


def test_every_key_but_the_imus_place_has_a_default():
    robot = robot_from_yaml("")
    assert robot.imu is not None
    assert robot.imu.topic == "auto"
    assert not robot.imu_placed
    assert (robot.T_body_lidar == np.eye(4)).all()


def test_a_null_section_or_topic_is_no_sensor():
    for text in ("imu: null\ngnss: null", "imu: {topic: null}\ngnss: {topic: null}"):
        robot = robot_from_yaml(text)
        assert robot.imu is None
        assert robot.gnss is None


def test_a_robot_survives_yaml_and_pickle(shared_data):
    for name in ("yard1/yard1.yaml", "kitti_0005/kitti_0005_ring64_4s.yaml"):
        robot = load_robot(shared_data / name)
        again = robot_from_yaml(robot_to_yaml(robot))
        assert again == robot
        assert np.array_equal(again.T_lidar_imu, robot.T_lidar_imu)
        assert pickle.loads(pickle.dumps(robot)) == robot


def test_robots_that_differ_in_one_number_are_not_equal():
    assert robot_from_yaml(RIGID) != robot_from_yaml(RIGID.replace("0.5", "0.6"))


def test_an_imus_place_that_nobody_gave_is_not_invented_by_a_round_trip():
    assert not robot_from_yaml(robot_to_yaml(robot_from_yaml(""))).imu_placed
    assert robot_from_yaml(robot_to_yaml(robot_from_yaml(RIGID))).imu_placed


def test_four_digits_of_a_rotation_are_made_orthonormal(shared_data):
    R = load_robot(shared_data / "yard1" / "yard1.yaml").T_lidar_imu[:3, :3]
    assert np.abs(R.T @ R - np.eye(3)).max() < 1e-14


def test_transforms_cannot_be_changed():
    with pytest.raises(ValueError, match="read-only"):
        robot_from_yaml(RIGID).T_lidar_imu[0, 0] = 2.0


@pytest.mark.parametrize(
    ("rows", "why"),
    [
        ("[[2, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]", "R^T R differs from identity by 3"),
        ("[[-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]", "a reflection"),
        ("[[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 1, 1]]", "last row"),
        ("[[1, 0, 0, .nan], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]", "finite"),
        ("[[1, 0, 0], [0, 1, 0], [0, 0, 1]]", "four rows of four numbers"),
        ("[1, 2, 3]", "four rows of four numbers"),
        ("[[1, 0, 0, 0], [0, 1, 0], [0, 0, 1, 0], [0, 0, 0, 1]]", "four rows of four numbers"),
    ],
)
def test_what_is_no_rigid_transform_is_refused(rows, why):
    line = wrong(f"T_lidar_imu: {rows}")
    assert "T_lidar_imu" in line
    assert why in line


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("lidar: {modl: vlp16}", "lidar.modl: unknown key; nearest known: lidar.model"),
        ("lidr: {}", "lidr: unknown key; nearest known: lidar"),
        ("imu: {max_range: 3}", "imu.max_range: unknown key; nearest known: lidar.max_range_m"),
        ("lidar: {model: vlp32}", "lidar.model: Input should be 'vlp16'"),
        ("lidar: {rings: many}", "lidar.rings: Input should be a valid integer"),
        ("lidar: {rate_hz: 0}", "lidar.rate_hz: Input should be greater than 0, found 0"),
        ("lidar: {min_range_m: 5, max_range_m: 2}", "min_range_m 5.0 must be below max_range_m 2.0"),
        ("lidar: {rings: 3, beam_elevations_deg: [1, 2]}", "beam_elevations_deg has 2 values, expected rings = 3"),
        ("lidar: {crop_boxes_body: [[0, 0, 0, -1, 1, 1]]}", "crop_boxes_body: expected [xmin"),
        ("imu: {topic: /imu}", "T_lidar_imu: must be given when there is an IMU"),
        ("robot: {id: 'a b'}", "robot.id"),
        ("wheels: {topik: /odom}", "wheels.topik: unknown key; nearest known: wheels.topic"),
        ("wheels: {speed_noise_mps: 0}", "wheels.speed_noise_mps: Input should be greater than 0"),
        ("wheels: {T_body_wheel: [1]}", "wheels.T_body_wheel: "),
        ("gravity_mps2: 1.62", "gravity_mps2"),
        ("lidar: {rings: 3, rings: 4}", "key rings is given twice"),
        ("lidar: [", "line 1: not valid YAML"),
        ("- 1", "expected keys and values, found list"),
        ("lidar: 3", "lidar: "),
    ],
)
def test_every_mistake_names_the_file_the_key_and_what_was_expected(text, said):
    assert said in wrong(text)


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ("robot: {id: x}\nlidar\n  model: vlp16\n", ", line 2: not valid YAML: could not find expected ':'"),
        ("robot: {id: x}\nlidar", ", line 2: not valid YAML"),
        ("robot: {id: x}\nlidar: 'a\nimu: null\ngnss: null\n", ", line 2: not valid YAML: found unexpected end"),
        ("robot: {id: x}\nlidar: {rings: [1, 2}\nimu: null\n", ", line 2: not valid YAML: expected ',' or ']'"),
        ("robot: {id: x}\nlidar: {rings: 3\n", ", line 2: not valid YAML: expected ',' or '}'"),
        ("robot: {id: x}\nlidar: {rings: 3\nimu: null\n", ", lines 2 to 3: not valid YAML: expected ',' or '}'"),
        ("robot: {id: x}\nlidar: a: b\nimu: null\n", ", line 2: not valid YAML: mapping values"),
        ("robot: {id: x}\n- b\nimu: null\n", ", line 2: not valid YAML: expected <block end>"),
    ],
)
def test_the_line_is_that_of_the_mistake_and_not_of_where_it_is_noticed(text: str, where: str):
    assert wrong(text).startswith("robot.yaml" + where), wrong(text)


def test_two_mistakes_are_both_in_the_line():
    line = wrong("lidar: {modl: a, rings: x}")
    assert "lidar.modl" in line
    assert "lidar.rings" in line


@pytest.mark.parametrize("text", ["", "wheels: null", "wheels: {topic: null}"])
def test_a_robot_has_no_wheels_unless_it_is_said(text):
    assert robot_from_yaml(text).wheels is None


def test_wheels_survive_yaml():
    wheels = robot_from_yaml(EXAMPLE.replace("holonomic: false", "holonomic: true"))
    again = robot_from_yaml(robot_to_yaml(wheels))
    assert again == wheels
    assert again.wheels is not None
    assert again.wheels.holonomic


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(InputError, match=r"no.yaml: cannot read: No such file"):
        load_robot(tmp_path / "no.yaml")


def test_rings_follow_from_the_model_or_from_the_list():
    assert robot_from_yaml("lidar: {model: hdl32}").lidar.rings == 32
    assert robot_from_yaml("lidar: {beam_elevations_deg: [-1, 0, 1]}").lidar.rings == 3


@pytest.mark.parametrize(("name", "rings"), [("OS-1-128_v2.3.0_1024x10_lb_n3", 128), ("OS-1-32-G_v2.1.1_1024x10", 32)])
def test_ouster_metadata_beside_the_file_gives_rings_columns_and_elevations(shared_data, tmp_path, name, rings):
    metadata = shared_data / "fixtures" / "ouster" / f"{name}.json"
    (tmp_path / "meta.json").write_text(metadata.read_text())
    (tmp_path / "robot.yaml").write_text("lidar: {model: ouster, metadata: meta.json}")
    lidar = load_robot(tmp_path / "robot.yaml").lidar
    assert (lidar.rings, lidar.columns) == (rings, 1024)
    assert lidar.beam_elevations_deg is not None
    assert len(lidar.beam_elevations_deg) == rings
    assert 10 < lidar.beam_elevations_deg[0] < 25  # ring 0 is the top one
    assert lidar.beam_elevations_deg[-1] == pytest.approx(-lidar.beam_elevations_deg[0], abs=3)


def test_metadata_that_is_none_is_refused(tmp_path):
    (tmp_path / "meta.json").write_text(json.dumps({"a": 1}))
    (tmp_path / "robot.yaml").write_text("lidar: {model: ouster, metadata: meta.json}")
    with pytest.raises(InputError, match=r"meta.json: not Ouster metadata"):
        load_robot(tmp_path / "robot.yaml")


def test_a_robot_is_a_key():
    assert len({robot_from_yaml(RIGID), robot_from_yaml(RIGID)}) == 1
    assert isinstance(robot_from_yaml(RIGID), Robot)


EXAMPLE = """
robot: {id: rover-7}
lidar:
  model: vlp16              # vlp16 | hdl32 | hdl64 | ouster | hesai | generic
  topic: /points_raw        # PointCloud2, or a VelodyneScan topic such as /velodyne_packets
  stamp: start              # start | end
  rings: 16
  columns: 1800
  rate_hz: 10
  min_range_m: 0.8
  max_range_m: 100
  beam_elevations_deg: null # list; null: the model's table or, for generic, estimated per ring from the first scans
  metadata: null            # Ouster: path of its JSON
  crop_boxes_body: []       # [[xmin, ymin, zmin, xmax, ymax, zmax], ...]: masts, handles
imu:
  topic: /imu/data          # null: no IMU
  rate_hz: 500
  time_offset_ns: 0         # added to IMU stamps
  gyro_noise_radps_rthz: 1.2e-4      # white noise density
  accel_noise_mps2_rthz: 2.5e-4
  gyro_walk_radps2_rthz: 2.0e-5      # bias random walk
  accel_walk_mps3_rthz: 2.0e-4
gnss: {topic: /gps/fix, t_lidar_antenna_m: [0, 0, 0]}     # null: none
wheels:                     # null or left out: none; nav_msgs/Odometry, of which only the twist is used
  topic: /wheel/odom
  rate_hz: 50
  time_offset_ns: 0         # added to its stamps
  T_body_wheel: [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]    # where the twist's frame is
  holonomic: false          # true: the base can drive sideways, and y is measured
  speed_noise_mps: 0.05     # white noise of a reading
  scale: 0.02               # standard deviation of the speed's relative error (tyres, track); it is estimated
  sideways_mps: 0.1         # how far from zero what is not measured may be: sideways and vertical velocity
T_lidar_imu: [[1, 0, 0, 0.5], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]   # p_lidar = T_lidar_imu @ p_imu
T_body_lidar: [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
gravity_mps2: 9.80665
"""
