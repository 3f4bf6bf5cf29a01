"""The simulated IMU and GNSS against physics, and every perturbation as a switch of its own."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from splitslam import se3
from splitslam.errors import InputError
from splitslam.sim.faults import FAULTS
from splitslam.sim.gnss import enu_to_wgs84, simulate_gnss
from splitslam.sim.imu import T_lidar_imu, simulate_imu, stated_T_lidar_imu
from splitslam.sim.lidar import Vlp16
from splitslam.sim.spec import DriveSpec, ImuSpec, Perturbations, WheelSpec, WorldSpec
from splitslam.sim.trajectory import drive_trajectory, make_trajectory
from splitslam.sim.wheels import simulate_wheels
from splitslam.sim.world import make_world
from tests.sim.drives import SHORT

PERFECT = ImuSpec(
    gyro_noise_radps_rthz=0.0,
    accel_noise_mps2_rthz=0.0,
    gyro_walk_radps2_rthz=0.0,
    accel_walk_mps3_rthz=0.0,
    gyro_bias_radps=0.0,
    accel_bias_mps2=0.0,
)
WORLD = make_world(SHORT.world)


def test_a_perfect_imu_integrates_to_the_truth() -> None:
    spec = replace(SHORT, imu=PERFECT, duration_s=5.0)
    trajectory = make_trajectory(spec.path, WORLD.place, spec.duration_s)
    T_lidar = T_lidar_imu(spec.imu)
    samples = simulate_imu(spec, trajectory)
    T = trajectory.T_world_lidar(0.0) @ T_lidar
    R, p, v = T[:3, :3], T[:3, 3], np.zeros(3)
    gravity = np.array([0.0, 0.0, -spec.gravity_mps2])
    dt = 1.0 / spec.imu.rate_hz
    steps = int(spec.duration_s * spec.imu.rate_hz)
    for k in range(steps):
        omega = (samples.gyro_radps[k] + samples.gyro_radps[k + 1]) / 2
        R_next = R @ se3.so3_exp(omega * dt)
        a = (R @ samples.accel_mps2[k] + R_next @ samples.accel_mps2[k + 1]) / 2 + gravity
        p, v, R = p + v * dt + a * dt * dt / 2, v + a * dt, R_next
    truth = trajectory.T_world_lidar(steps * dt) @ T_lidar
    assert np.linalg.norm(p - truth[:3, 3]) < 0.01
    assert se3.angle(R.T @ truth[:3, :3]) < 1e-3
    assert np.linalg.norm(truth[:3, 3] - T[:3, 3]) > 4.0


def test_velocities_and_accelerations_are_the_derivatives_of_the_pose() -> None:
    trajectory = make_trajectory(SHORT.path, WORLD.place, SHORT.duration_s)
    t_s, h = np.linspace(0.2, 2.8, 40), 1e-5
    before, now, after = (trajectory.motion(t_s + d) for d in (-h, 0.0, h))
    turned = [se3.so3_log(a.T @ b) / (2 * h) for a, b in zip(before.R_world_lidar, after.R_world_lidar, strict=True)]
    np.testing.assert_allclose(now.omega_radps, turned, atol=1e-6)
    np.testing.assert_allclose(now.alpha_radps2, (after.omega_radps - before.omega_radps) / (2 * h), atol=1e-5)
    np.testing.assert_allclose(now.velocity_mps, (after.position_m - before.position_m) / (2 * h), atol=1e-7)
    np.testing.assert_allclose(now.acceleration_mps2, (after.velocity_mps - before.velocity_mps) / (2 * h), atol=1e-5)


def test_imu_noise_has_the_density_of_the_robot_file() -> None:
    spec = replace(SHORT, duration_s=20.0, path=replace(SHORT.path, stand_s=25.0, head_turns=()))
    samples = simulate_imu(spec, make_trajectory(spec.path, WORLD.place, spec.duration_s))
    white = np.diff(samples.gyro_radps, axis=0).std() / np.sqrt(2)
    assert white / np.sqrt(spec.imu.rate_hz) == pytest.approx(spec.imu.gyro_noise_radps_rthz, rel=0.05)
    white = np.diff(samples.accel_mps2, axis=0).std() / np.sqrt(2)
    assert white / np.sqrt(spec.imu.rate_hz) == pytest.approx(spec.imu.accel_noise_mps2_rthz, rel=0.05)


def test_fixes_are_metres_from_the_datum() -> None:
    datum = (35.5552, 139.6555, 30.0)
    metres = np.array([[0.0, 0.0, 0.0], [100.0, 0.0, 0.0], [0.0, 100.0, 0.0], [0.0, 0.0, 7.0]])
    latitude, longitude, altitude = (enu_to_wgs84(metres, datum) - np.array(datum)).T
    sin2 = np.sin(np.radians(datum[0])) ** 2
    curve = np.sqrt(1.0 - 6.69437999014e-3 * sin2)  # radii of curvature of WGS84 at the datum
    north_m = (6_378_137.0 * (1.0 - 6.69437999014e-3) / curve**3 + datum[2]) * np.radians(latitude)
    east_m = (6_378_137.0 / curve + datum[2]) * np.cos(np.radians(datum[0])) * np.radians(longitude)
    np.testing.assert_allclose(np.stack([east_m, north_m, altitude], axis=1), metres, atol=2e-3)


def test_a_drive_can_start_in_motion() -> None:
    path = replace(SHORT.path, stand_s=0.0, accel_s=0.0)
    start = make_trajectory(path, WORLD.place, 2.0).motion(np.array([0.0]))
    assert np.linalg.norm(start.velocity_mps) == pytest.approx(path.speed_mps, rel=0.1)


def test_an_open_path_must_be_long_enough() -> None:
    path = replace(SHORT.path, closed=False, waypoints_m=((0, -8), (2, -8), (3, -8), (4, -8), (5, -8), (6, -8)))
    with pytest.raises(ValueError, match="open path"):
        make_trajectory(path, WORLD.place, 60.0)


def test_an_unknown_world_is_named() -> None:
    with pytest.raises(InputError, match=r"'moon'.*campus"):
        make_world(WorldSpec(kind="moon"))


SWITCHES: dict[str, tuple[float, set[str]]] = {
    "walking_people": (6, {"lidar"}),
    "laser_bias_m": (0.02, {"lidar"}),
    "incidence_bias_m": (0.02, {"lidar"}),
    "mixed_pixels_mrad": (3.0, {"lidar"}),
    "glass": (1.0, {"lidar"}),
    "blocked_deg": (180.0, {"lidar"}),
    "scans_lost": (0.5, {"lidar"}),
    "imu_rate_hz": (100.0, {"imu"}),
    "imu_random_mounting": (1, {"imu", "robot"}),
    "imu_time_offset_s": (0.01, {"imu"}),
    "imu_time_jitter_s": (0.001, {"imu"}),
    "imu_scale": (0.01, {"imu"}),
    "imu_misalignment_deg": (1.0, {"imu"}),
    "imu_vibration_mps2": (1.0, {"imu"}),
    "imu_dropout_s": (0.2, {"imu"}),
    "extrinsic_error_deg": (2.0, {"robot"}),
    "gnss_jump_m": (15.0, {"gnss"}),
    "wheel_slip": (0.5, {"wheels"}),
    "kidnap_m": (5.0, {"lidar", "imu", "gnss", "wheels"}),
}
_DETAILS = {"gnss_jump_at_s": 0.5, "imu_dropout_at_s": 0.5, "kidnap_at_s": (0.75,)}


def _streams(spec: DriveSpec) -> dict[str, bytes]:
    trajectory = drive_trajectory(spec, WORLD.place)
    imu = simulate_imu(spec, trajectory)
    sweeps = list(Vlp16(spec, WORLD, trajectory).sweeps())
    fixes = simulate_gnss(spec, trajectory)
    wheels = simulate_wheels(spec, WheelSpec(), trajectory)
    return {
        "lidar": b"".join(sweep.range_m.tobytes() for sweep in sweeps),
        "imu": imu.stamps_ns.tobytes() + imu.gyro_radps.tobytes() + imu.accel_mps2.tobytes(),
        "gnss": np.array([(fix.latitude_deg, fix.longitude_deg, fix.altitude_m) for fix in fixes]).tobytes(),
        "wheels": wheels.speed_mps.tobytes() + wheels.yaw_rate_radps.tobytes(),
        "robot": stated_T_lidar_imu(spec).tobytes(),
    }


@pytest.fixture(scope="module")
def clean_streams() -> dict[str, bytes]:
    return _streams(SECOND)


# A second of the drive at walking pace, so that what happens at a certain time happens in it.
SECOND = replace(SHORT, duration_s=1.0, path=replace(SHORT.path, stand_s=0.1, accel_s=0.3))


@pytest.mark.parametrize("name", SWITCHES)
def test_a_perturbation_changes_its_own_streams_and_no_other(
    name: str, clean_streams: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("splitslam.sim.wheels._FIRST_SLIP_S", 0.2)
    value, changed = SWITCHES[name]
    faults = replace(Perturbations(), **_DETAILS, **{name: value})
    after = _streams(replace(SECOND, perturbations=faults))
    assert {stream for stream in after if clean_streams[stream] != after[stream]} == changed


def test_every_perturbation_has_its_switch_tested_and_its_name() -> None:
    switches = {field.name for field in fields(Perturbations)} - {*_DETAILS, "gnss_jump_over_s"}
    assert switches == set(SWITCHES)
    assert switches == {fault.field for fault in FAULTS.values()}


def test_jittered_stamps_stay_in_order_and_are_late() -> None:
    faults = Perturbations(imu_time_offset_s=0.01, imu_time_jitter_s=0.004)
    spec = replace(SHORT, perturbations=faults)
    trajectory = make_trajectory(spec.path, WORLD.place, spec.duration_s)
    stamps = simulate_imu(spec, trajectory).stamps_ns
    late_s = (stamps - simulate_imu(SHORT, trajectory).stamps_ns) * 1e-9
    assert (np.diff(stamps) > 0).all()
    assert late_s.min() >= 0.01
    assert late_s.mean() < 0.02
