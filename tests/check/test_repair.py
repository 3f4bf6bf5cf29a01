"""A robot file that does not fit a recording is made to fit, with one line for each change."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from splitslam.check.findings import Finding, problems
from splitslam.check.repair import repaired
from splitslam.errors import InputError
from splitslam.robot import Robot, robot_from_yaml
from tests.sources import made_bags as bags

EYE = "T_lidar_imu: [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]"


def cloud(**where: Any) -> bags.Message:
    xyz, ring, share = bags.turn(elevations_deg=(-10.0, -5.0, 0.0, 5.0))
    points = bags.structured(xyz, bags.VELODYNE, 22, ring=ring, time=share * 0.1)
    return bags.cloud(points, bags.T0_NS, **where)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    messages = [cloud(), bags.imu(bags.T0_NS + 1, topic="/sensors/imu"), bags.fix(bags.T0_NS + 2)]
    return bags.write_bag(tmp_path_factory.mktemp("repair"), bags.ROS1, messages)


def repair(recording: Path, text: str) -> tuple[Robot, list[Finding]]:
    return repaired(recording, robot_from_yaml(text))


def test_a_file_that_fits_is_left_alone(recording: Path) -> None:
    robot, findings = repair(recording, f"{{lidar: {{rings: 4}}, imu: {{topic: /sensors/imu}}, {EYE}}}")
    assert findings == []
    assert robot.lidar.topic == "/points_raw"
    assert robot.imu is not None
    assert robot.gnss is not None


def test_a_missing_topic_is_a_problem_and_the_other_of_its_type_is_used(recording: Path) -> None:
    robot, findings = repair(recording, f"{{lidar: {{rings: 4}}, imu: {{topic: /imu}}, {EYE}}}")
    (finding,) = problems(findings)
    assert finding.where == "imu.topic"
    assert finding.what == "no topic /imu"
    assert finding.expected.startswith("one of /gps/fix (")
    assert "/sensors/imu (sensor_msgs/Imu)" in finding.expected
    assert robot.imu is not None
    assert robot.imu.topic == "/sensors/imu"


def test_a_topic_of_another_type_is_a_problem(recording: Path) -> None:
    robot, findings = repair(recording, "{lidar: {rings: 4}, imu: null, gnss: {topic: /sensors/imu}}")
    (finding,) = problems(findings)
    assert finding.where == "gnss.topic"
    assert robot.gnss is not None
    assert robot.gnss.topic == "/gps/fix"


def test_ring_numbers_beyond_the_file_are_a_problem_and_the_rings_there_are_used(recording: Path) -> None:
    robot, findings = repair(recording, f"{{lidar: {{rings: 2}}, imu: {{topic: /sensors/imu}}, {EYE}}}")
    assert [f.line for f in findings] == ["lidar.rings: 2, but ring numbers go up to 3; expected at least 4"]
    assert robot.lidar.rings == 4


def test_a_mounting_that_nobody_gave_is_a_problem_and_can_then_be_estimated(recording: Path) -> None:
    robot, findings = repair(recording, "{lidar: {rings: 4}}")
    assert [f.where for f in findings] == ["T_lidar_imu"]
    assert robot.imu_placed
    np.testing.assert_array_equal(robot.T_lidar_imu, np.eye(4))


def test_a_sensor_that_the_file_leaves_out_is_a_note(recording: Path) -> None:
    _, findings = repair(recording, "{lidar: {rings: 4}, imu: null}")
    assert problems(findings) == []
    assert [f.line for f in findings] == ["imu: none in the robot file, but there is /sensors/imu"]


def test_an_imu_that_the_recording_lacks_is_a_problem(tmp_path: Path) -> None:
    path = bags.write_bag(tmp_path, bags.ROS1, [cloud()])
    robot, findings = repair(path, f"{{lidar: {{rings: 4}}, {EYE}}}")
    assert [f.line for f in findings] == ["imu: none in the recording; expected sensor_msgs/Imu"]
    assert robot.imu is None


def test_a_recording_without_lidar_is_bad_input(tmp_path: Path) -> None:
    path = bags.write_bag(tmp_path, bags.ROS1, [bags.imu(bags.T0_NS)])
    with pytest.raises(InputError, match="no LiDAR topic"):
        repair(path, f"{{{EYE}}}")
