"""Wheels on the edge: they hold what the LiDAR does not see, are left out when they slip, and spoil nothing."""

from __future__ import annotations

import numpy as np
import pytest

from edge_agent.imu.wheel_factor import WheelFactors, WheelVelocity
from splitslam import se3
from tests import tolerances as bars
from tests.imu.made import Drive
from tests.imu.made_wheels import PoorImu, Service, Wheels, make_node, play

DRIVE = Drive(still_s=2.0, wobble_rad=0.02)
BROKEN = Service(until_s=12.0, noise_m=0.005)
BLIND = Service(blind_s=12.0, noise_m=0.005)
IMU = PoorImu(noise_mps2=0.1, ramp_mps3=0.005)  # a phone's, and it warms up


def drive(wheels: Wheels | None, service: Service, seconds: float = 22.0, since_s: float = 11.5, **description):
    return play(make_node(wheels is not None, **description), DRIVE, seconds, wheels, service, IMU, since_s)


def along(played) -> float:
    """Drift along the way at the end, m."""
    return abs(float(played.drift_m[max(played.drift_m)][0]))


def largest(played) -> float:
    return max(float(np.linalg.norm(drift)) for drift in played.drift_m.values())


@pytest.fixture(scope="module")
def imu_alone():
    return {service: drive(None, service) for service in (BROKEN, BLIND)}


@pytest.mark.parametrize("service", [BROKEN, BLIND], ids=["no answers", "nothing seen along the way"])
def test_wheels_hold_the_drift_where_the_lidar_does_not(service, imu_alone):
    aided = drive(Wheels(scale=0.01), service)
    assert along(aided) < 0.3 * along(imu_alone[service])
    gone_m = DRIVE.speed_mps * 10.0
    assert along(aided) < bars.WHEELS_DRIFT_SHARE * gone_m


@pytest.mark.parametrize("slip_mps", [1.5, -1.5], ids=["spinning", "locked"])
@pytest.mark.parametrize("service", [BROKEN, BLIND], ids=["no answers", "nothing seen along the way"])
def test_wheels_that_slip_are_left_out_for_as_long(service, slip_mps, imu_alone):
    slipping = Wheels(scale=0.01, slip_mps=lambda t: slip_mps if 14.0 < t < 17.0 else 0.0)
    aided = drive(slipping, service)
    assert along(aided) < 0.5 * along(imu_alone[service])  # believed, they alone would be 4.5 m off
    if service is BLIND:
        assert aided.node.reckoning.wheels is not None
        assert 28 <= aided.node.reckoning.wheels.slips <= 33


def test_what_lidar_and_imu_see_is_not_spoilt_by_a_wrong_wheel_size():
    alone = drive(None, Service(noise_m=0.005), since_s=5.0)
    for scale in (-0.02, 0.02):
        aided = drive(Wheels(scale=scale), Service(noise_m=0.005), since_s=5.0)
        assert np.median(list(aided.motion_m.values())) < 1.1 * np.median(list(alone.motion_m.values()))
        assert largest(aided) < 1.1 * largest(alone)


def test_the_wheels_scale_is_found_while_the_lidar_sees():
    wheels = drive(Wheels(scale=0.015), Service(noise_m=0.005), since_s=5.0).node.reckoning.wheels
    assert wheels is not None
    factors = wheels.factors
    assert abs(factors.scale - 0.015) < 3 * factors.scale_sigma
    assert factors.scale_sigma < 0.006


def test_a_robot_that_starts_in_motion_knows_its_speed_from_the_first_reading():
    for wheels, within_m in ((None, np.inf), (Wheels(), 0.15)):
        played = play(make_node(wheels is not None), Drive(speed_mps=8.0, wobble_rad=0.02), 1.0, wheels, since_s=0.05)
        first_m = played.motion_m[min(played.motion_m)]
        assert (first_m > 0.6) if wheels is None else (first_m < within_m)


def test_the_pose_does_not_step_when_wheels_come_go_and_slip():
    slipping = Wheels(scale=0.02, slip_mps=lambda t: 2.0 if t % 5.0 < 1.0 else 0.0)
    for service in (BROKEN, BLIND, Service(noise_m=0.005)):
        jumps = drive(slipping, service).node.jumps
        assert jumps["odom_max_m"] < bars.ODOM_STEP_M
        assert jumps["odom_max_deg"] < bars.ODOM_STEP_DEG


def test_the_doubt_about_the_motion_is_neither_decorative_nor_boundless():
    played = drive(Wheels(scale=0.01), BLIND)
    ratios = np.array([played.motion_m[t] ** 2 / (3 * played.sigma_m[t] ** 2) for t in played.motion_m])
    assert 0.1 < ratios.mean() < 2.0


def test_readings_that_stop_leave_the_node_as_without_wheels():
    node = make_node(True)
    original = node.add_wheels
    node.add_wheels = lambda samples: original(samples) if len(node.output._history) < 1000 else None  # type: ignore
    stopped = play(node, DRIVE, 12.0, Wheels(), Service(noise_m=0.005), since_s=9.0)
    none = play(make_node(False), DRIVE, 12.0, None, Service(noise_m=0.005), since_s=9.0)
    assert np.median(list(stopped.motion_m.values())) < 1.1 * np.median(list(none.motion_m.values()))


def test_the_derivatives_of_the_wheel_factor_are_those_of_its_error():
    rng = np.random.default_rng(4)
    geometry = np.column_stack([se3.so3_exp(rng.normal(size=3)), rng.normal(size=3)])
    wheel = WheelVelocity(
        np.array([0, 2]), np.array([1.3, 0.0]), np.array([0.1, 0.2]), np.array([True, False]), rng.normal(size=3)
    )
    factors = WheelFactors(geometry, 0.01)
    R, v, b = se3.so3_exp(rng.normal(size=3)), rng.normal(size=3), rng.normal(0, 0.1, 3)

    def error(d: np.ndarray) -> np.ndarray:
        return factors.error(wheel, se3.so3_exp(d[:3]) @ R, v + d[3:6], b + d[6:9], 0.02 + d[9])[0]

    h = 1e-6
    numeric = np.column_stack([(error(h * e) - error(-h * e)) / (2 * h) for e in np.eye(10)])
    np.testing.assert_allclose(factors.error(wheel, R, v, b, 0.02)[1], numeric, atol=1e-7)
