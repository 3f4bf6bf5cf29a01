"""What is said about an IMU on made motions: each mistake alone gives one line, the right file none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from splitslam import se3
from splitslam.check.findings import Finding, problems
from splitslam.check.imu_verdict import ImuVerdict, judge
from splitslam.robot import Robot
from splitslam.scan import ImuSamples
from tests import tolerances
from tests.check import made

SECONDS = 25.0
MOTION = made.motion(made.WALK, SECONDS)
SAMPLES = made.samples(made.WALK, SECONDS)


def verdict(robot: Robot | None = None, samples: ImuSamples = SAMPLES) -> ImuVerdict:
    return judge(robot or made.robot(), MOTION, samples, made.SCAN_S)


def only_problem(findings: tuple[Finding, ...]) -> Finding:
    (finding,) = problems(findings)
    return finding


def error_deg(v: ImuVerdict) -> float:
    assert v.alignment is not None
    return float(np.degrees(se3.angle(v.alignment.R_lidar_imu @ made.T_LIDAR_IMU[:3, :3].T)))


def test_a_right_robot_file_gives_no_line() -> None:
    assert verdict().findings == ()


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("angle_deg", [5.0, 90.0, 180.0])
def test_a_mounting_that_is_turned_is_one_line_with_the_right_rotation(axis: int, angle_deg: float) -> None:
    v = verdict(made.robot(made.turned(axis, angle_deg)))
    finding = only_problem(v.findings)
    assert finding.where == "T_lidar_imu"
    assert v.mounting is not None
    assert v.mounting.angle_deg == pytest.approx(angle_deg, abs=tolerances.CHECK_ROTATION_DEG)
    assert abs(v.mounting.axis[axis]) == pytest.approx(1.0, abs=0.01)
    assert error_deg(v) < tolerances.CHECK_ROTATION_DEG


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_two_degrees_are_no_finding(axis: int) -> None:
    assert verdict(made.robot(made.turned(axis, 2.0))).findings == ()


def test_a_transposed_mounting_is_one_line() -> None:
    T = se3.compose(made.T_LIDAR_IMU[:3, :3].T, made.T_LIDAR_IMU[:3, 3])
    v = verdict(made.robot(T))
    assert only_problem(v.findings).where == "T_lidar_imu"
    assert error_deg(v) < tolerances.CHECK_ROTATION_DEG


@pytest.mark.parametrize("rate_hz", [100.0, 200.0, 500.0])
@pytest.mark.parametrize("delay_ms", [-15.0, 15.0])
def test_fifteen_milliseconds_are_one_line_that_says_which_offset_to_write(rate_hz: float, delay_ms: float) -> None:
    v = verdict(samples=made.samples(made.WALK, SECONDS, rate_hz=rate_hz, delay_s=delay_ms * 1e-3))
    finding = only_problem(v.findings)
    assert finding.where == "imu.time_offset_ns"
    assert int(finding.expected.removeprefix("about ")) == pytest.approx(
        -delay_ms * 1e6, abs=tolerances.CHECK_DELAY_S * 1e9
    )


@pytest.mark.parametrize("delay_ms", [-5.0, 5.0])
def test_five_milliseconds_are_no_finding(delay_ms: float) -> None:
    v = verdict(samples=made.samples(made.WALK, SECONDS, delay_s=delay_ms * 1e-3))
    assert v.findings == ()
    assert v.mounting is not None
    assert v.mounting.time_offset_s == pytest.approx(-delay_ms * 1e-3, abs=tolerances.CHECK_DELAY_S)


def test_the_offset_of_the_robot_file_is_counted_in() -> None:
    robot = made.robot()
    assert robot.imu is not None
    stated = robot.model_copy(update={"imu": robot.imu.model_copy(update={"time_offset_ns": 20_000_000})})
    v = verdict(stated, made.samples(made.WALK, SECONDS, delay_s=0.02))  # stamps have it added already
    assert only_problem(v.findings).expected.startswith(("about -", "about 0"))
    assert v.mounting is not None
    assert v.mounting.time_offset_s == pytest.approx(0.0, abs=tolerances.CHECK_DELAY_S)


def test_an_offset_of_one_scan_asks_for_the_meaning_of_the_lidar_stamp() -> None:
    v = verdict(samples=made.samples(made.WALK, SECONDS, delay_s=made.SCAN_S))
    assert "lidar.stamp" in only_problem(v.findings).what


def test_rotation_and_delay_wrong_together_are_two_lines() -> None:
    v = verdict(made.robot(made.turned(1, 6.0)), made.samples(made.WALK, SECONDS, delay_s=0.02))
    assert [f.where for f in problems(v.findings)] == ["T_lidar_imu", "imu.time_offset_ns"]


@pytest.mark.parametrize(
    ("wrong", "where", "word"),
    [
        (replace(SAMPLES, accel_mps2=SAMPLES.accel_mps2 / made.G), "/imu linear_acceleration", "in g"),
        (replace(SAMPLES, accel_mps2=SAMPLES.accel_mps2 * 0.0), "/imu linear_acceleration", "no gravity"),
        (replace(SAMPLES, gyro_radps=np.degrees(SAMPLES.gyro_radps)), "/imu angular_velocity", "deg/s"),
        (replace(SAMPLES, gyro_radps=1.3 * SAMPLES.gyro_radps), "/imu angular_velocity", "1.3"),
        (replace(SAMPLES, accel_mps2=-SAMPLES.accel_mps2), "imu linear_acceleration", "sign"),
        (replace(SAMPLES, gyro_radps=-SAMPLES.gyro_radps), "imu angular_velocity", "all three axes"),
        (replace(SAMPLES, gyro_radps=SAMPLES.gyro_radps * [-1, 1, 1]), "imu angular_velocity", "x of the gyro"),
        (replace(SAMPLES, gyro_radps=SAMPLES.gyro_radps * [1, -1, 1]), "imu angular_velocity", "y of the gyro"),
        (replace(SAMPLES, gyro_radps=SAMPLES.gyro_radps * [1, 1, -1]), "imu angular_velocity", "z of the gyro"),
    ],
)
def test_wrong_units_and_signs_are_one_line_and_hide_nothing_else(wrong: ImuSamples, where: str, word: str) -> None:
    finding = only_problem(verdict(samples=wrong).findings)
    assert finding.where == where
    assert word in finding.what


def test_a_gyro_of_another_robot_is_one_line() -> None:
    other = made.samples(made.Drive(turn_rad=0.0, wobble_rad=0.3), SECONDS)
    finding = only_problem(verdict(samples=other).findings)
    assert "do not turn alike" in finding.what or "explains" in finding.what


def test_standing_still_tests_nothing_and_says_so() -> None:
    v = judge(
        made.robot(made.turned(0, 30.0)), made.motion(made.STANDING, 15.0), made.samples(made.STANDING, 15.0), 0.1
    )
    assert problems(v.findings) == []
    assert "not tested" in v.findings[0].what
    assert v.mounting is None


def test_standing_still_an_imu_upside_down_is_seen_by_gravity() -> None:
    v = judge(
        made.robot(made.turned(0, 180.0)), made.motion(made.STANDING, 15.0), made.samples(made.STANDING, 15.0), 0.1
    )
    assert "away from the lidar's z axis" in only_problem(v.findings).what


@pytest.mark.parametrize("axis", [0, 1])
def test_turning_about_one_axis_shows_the_other_two_and_says_which_is_unknown(axis: int) -> None:
    motion, samples = made.motion(made.SMOOTH_CAR, SECONDS), made.samples(made.SMOOTH_CAR, SECONDS)
    right = judge(made.robot(), motion, samples, made.SCAN_S)
    assert problems(right.findings) == []
    assert "lidar's z axis" in right.findings[0].what
    wrong = judge(made.robot(made.turned(axis, 5.0)), motion, samples, made.SCAN_S)
    assert only_problem(wrong.findings).where == "T_lidar_imu"
    assert wrong.mounting is not None
    assert wrong.mounting.angle_deg == pytest.approx(5.0, abs=tolerances.CHECK_ROTATION_DEG)


@pytest.mark.parametrize("rate_hz", [10.0, 200.0])
def test_a_car_that_brakes_and_turns_shows_all_three_axes(rate_hz: float) -> None:
    motion, samples = made.motion(made.CAR, SECONDS), made.samples(made.CAR, SECONDS, rate_hz=rate_hz)
    assert judge(made.robot(), motion, samples, made.SCAN_S).findings == ()
    wrong = judge(made.robot(made.turned(2, 5.0)), motion, samples, made.SCAN_S)
    assert only_problem(wrong.findings).where == "T_lidar_imu"


def test_an_offset_within_one_sample_of_a_slow_imu_is_a_note() -> None:
    samples = made.samples(made.CAR, SECONDS, rate_hz=10.0, delay_s=0.05)
    (finding,) = judge(made.robot(rate_hz=10.0), made.motion(made.CAR, SECONDS), samples, made.SCAN_S).findings
    assert finding.severity == "note"
    assert "within one sample" in finding.what


@pytest.mark.parametrize("drive", [made.WALK, made.CAR], ids=["walk", "car"])
def test_the_stated_uncertainty_holds_the_error_for_every_noise(drive: made.Drive) -> None:
    for seed in range(5):
        v = judge(made.robot(), made.motion(drive, SECONDS, seed), made.samples(drive, SECONDS, seed=90 + seed), 0.1)
        a = v.alignment
        assert a is not None
        error = se3.so3_log(a.R_lidar_imu @ made.T_LIDAR_IMU[:3, :3].T)
        assert error @ np.linalg.solve(a.covariance, error) < 3 * tolerances.CHECK_NEES
        assert abs(a.delay_s) < 3.0 * a.delay_sigma_s
