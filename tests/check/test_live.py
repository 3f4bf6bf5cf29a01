"""The check in the first seconds of a run: both pipelines in lockstep on a recording, and the check by itself."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest

from edge_agent import check as check_module
from edge_agent.check import LiveCheck
from edge_agent.metrics import EdgeMetrics
from edge_agent.types import OdometryReply
from edge_agent.wire import Answer
from splitslam import se3
from splitslam.check.findings import problems
from splitslam.robot import Robot, load_robot
from splitslam.scan import ImuSamples, Scan
from tests import tolerances
from tests.check import made
from tests.check.live import run_live
from tests.logs.said import said

SCANS = 215


def yard1(shared_data: Path, turn_deg: float = 0.0, offset_ms: float = 0.0) -> tuple[Path, Robot]:
    robot = load_robot(shared_data / "yard1" / "yard1.yaml")
    assert robot.imu is not None
    turn = se3.compose(se3.so3_exp(np.radians(turn_deg) * np.array([0.6, 0.0, 0.8])), np.zeros(3))
    T = se3.compose((turn @ robot.T_lidar_imu)[:3, :3], robot.T_lidar_imu[:3, 3])
    imu = robot.imu.model_copy(update={"time_offset_ns": round(offset_ms * 1e6)})
    return shared_data / "yard1" / "yard1.bag", robot.model_copy(update={"T_lidar_imu": T, "imu": imu})


def value(metrics: EdgeMetrics, name: str) -> float:
    found = metrics.registry.get_sample_value(f"splitslam_edge_check_{name}")
    assert found is not None
    return found


def test_a_right_robot_file_gives_no_line(shared_data: Path, caplog: pytest.LogCaptureFixture) -> None:
    check, metrics = run_live(*yard1(shared_data), SCANS)
    assert check.findings == []
    assert caplog.records == []
    assert value(metrics, "problems") == 0
    assert np.degrees(value(metrics, "rotation_radians")) < tolerances.CHECK_LIVE_ROTATION_DEG
    assert abs(value(metrics, "time_offset_seconds")) < tolerances.CHECK_LIVE_DELAY_S


def test_a_mounting_off_by_five_degrees_is_one_warning(shared_data: Path, caplog: pytest.LogCaptureFixture) -> None:
    check, metrics = run_live(*yard1(shared_data, turn_deg=5.0), SCANS)
    assert [f.where for f in check.findings] == ["T_lidar_imu"]
    (record,) = caplog.records
    assert record.levelno == logging.WARNING
    ((event, fields),) = said(caplog)
    assert (event, fields["where"]) == ("robot file and data disagree", "T_lidar_imu")
    assert "\n" not in fields["detail"]
    assert value(metrics, "problems") == 1
    off_deg = np.degrees(value(metrics, "rotation_radians"))
    assert off_deg == pytest.approx(5.0, abs=2 * tolerances.CHECK_LIVE_ROTATION_DEG)


@pytest.mark.parametrize("offset_ms", [15.0, -15.0])
def test_stamps_off_by_fifteen_milliseconds_are_one_finding(shared_data: Path, offset_ms: float) -> None:
    check, metrics = run_live(*yard1(shared_data, offset_ms=offset_ms), SCANS)
    assert [f.where for f in check.findings] == ["imu.time_offset_ns"]
    assert value(metrics, "time_offset_seconds") == pytest.approx(
        -offset_ms * 1e-3, abs=2 * tolerances.CHECK_LIVE_DELAY_S
    )


def test_stamps_off_by_five_milliseconds_are_no_finding(shared_data: Path) -> None:
    assert run_live(*yard1(shared_data, offset_ms=5.0), SCANS)[0].findings == []


# --- without a recording --------------------------------------------------------------------------------------------

SECONDS = 24.0


def scan(stamp_ns: int) -> Scan:
    empty = np.zeros((0, 3), np.float32), np.zeros(0, np.int32), np.zeros(0, np.uint8), np.zeros(0, np.uint8)
    return Scan(stamp_ns, stamp_ns + 100_000_000, *empty)


def answered(robot: Robot, samples: ImuSamples, drive: made.Drive = made.WALK, **changes: object) -> LiveCheck:
    """Scans, samples and answers in order of time; every tenth answer comes with a jump of the map."""
    check = LiveCheck(robot, EdgeMetrics())
    motion = made.motion(drive, SECONDS)
    done = 0
    jump = se3.compose(se3.so3_exp(np.array([0.0, 0.0, 0.3])), np.array([5.0, 0.0, 0.0]))
    T_map_odom = np.eye(4)
    for k, (stamp_ns, T) in enumerate(zip(motion.stamps_ns.tolist(), motion.T_odom_lidar, strict=True)):
        upto = int(np.searchsorted(samples.stamps_ns, stamp_ns + 100_000_000))
        part = slice(done, upto)
        check.on_event(ImuSamples(samples.stamps_ns[part], samples.gyro_radps[part], samples.accel_mps2[part]))
        done = upto
        check.on_event(scan(stamp_ns))
        if k % 10 == 9:
            T_map_odom = jump @ T_map_odom
        fields = {"state": 2, "rejected": "", **changes}
        reply = OdometryReply(
            k + 1,
            stamp_ns,
            T_map_odom @ T,
            T_map_odom,
            np.eye(6),
            fields["state"],
            np.zeros((0, 6)),
            fields["rejected"],
        )
        check.on_answer(Answer(reply, False, None, 0.01))
    check.finish()
    return check


def test_corrections_of_the_map_are_no_motion() -> None:
    assert answered(made.robot(), made.samples(made.WALK, SECONDS)).findings == []


@pytest.mark.parametrize("scans", [True, False], ids=["no answers", "no scans either"])
def test_hours_without_answers_do_not_fill_the_memory(scans: bool) -> None:
    check, rest, second_ns = LiveCheck(made.robot(), EdgeMetrics()), np.zeros((500, 3)), 1_000_000_000
    for second in range(3 * 3600):
        stamps_ns = second * second_ns + np.arange(500) * 2_000_000
        check.on_event(ImuSamples(stamps_ns, rest, rest))
        for tenth in range(10 if scans else 0):
            check.on_event(scan(second * second_ns + tenth * 100_000_000))
    assert sum(map(len, check._heard.samples)) <= check_module._MOST_SAMPLES + 1001 * 500
    assert len(check._heard.scans_ns) <= check_module._MOST_SCANS


def test_a_wrong_mounting_is_found_and_the_run_sends_people_to_the_command() -> None:
    check = answered(made.robot(made.turned(2, 6.0)), made.samples(made.WALK, SECONDS))
    (finding,) = check.findings
    assert finding.where == "T_lidar_imu"
    assert "splitslam check" in finding.expected


def test_a_service_that_is_lost_tests_no_mounting_and_the_log_says_so_once(caplog: pytest.LogCaptureFixture) -> None:
    check = answered(made.robot(made.turned(2, 40.0)), made.samples(made.WALK, SECONDS), state=6)
    assert problems(check.findings) == []
    assert "lost" in check.findings[0].what
    ((event, fields),) = said(caplog)
    assert event == "robot lost"
    assert "splitslam check" in fields["expected"]


def test_without_answers_stamps_units_and_gravity_are_still_looked_at() -> None:
    samples = made.samples(made.WALK, SECONDS)
    wrong = ImuSamples(samples.stamps_ns, samples.gyro_radps, samples.accel_mps2 / made.G)
    check = answered(made.robot(rate_hz=100.0), wrong, rejected="no map")
    assert sorted(f.where for f in problems(check.findings)) == ["/imu linear_acceleration", "imu.rate_hz"]


def test_an_imu_that_says_nothing_is_a_finding() -> None:
    nothing = ImuSamples(np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 3)))
    assert [f.where for f in answered(made.robot(), nothing).findings] == ["imu"]


def test_a_robot_without_imu_has_its_scans_checked() -> None:
    robot = made.robot().model_copy(update={"imu": None})
    late = robot.model_copy(update={"lidar": robot.lidar.model_copy(update={"rate_hz": 20.0})})
    nothing = ImuSamples(np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 3)))
    assert answered(robot, nothing).findings == []
    assert [f.where for f in answered(late, nothing).findings] == ["lidar.rate_hz"]


def test_a_check_that_fails_does_not_end_the_run(monkeypatch: pytest.MonkeyPatch, caplog) -> None:
    monkeypatch.setattr("edge_agent.check.judge", lambda *_: 1 / 0)
    assert answered(made.robot(), made.samples(made.WALK, SECONDS)).findings == []
    assert any("check failed" in record.message for record in caplog.records)
