"""Perturbations by name, and what the ones of IMU, GNSS and clock do."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np
import pytest

from splitslam import se3
from splitslam.errors import InputError
from splitslam.sim import ALL_MIDDLE, SWEEP
from splitslam.sim.faults import FAULTS, parse
from splitslam.sim.gnss import simulate_gnss
from splitslam.sim.imu import T_lidar_imu, carried_imu, simulate_imu, stated_T_lidar_imu, true_imu
from splitslam.sim.spec import Perturbations
from splitslam.sim.trajectory import make_trajectory
from splitslam.sim.world import make_world
from tests.sim.drives import SHORT

WORLD = make_world(SHORT.world)
LONG = replace(SHORT, duration_s=30.0)
TRAJECTORY = make_trajectory(LONG.path, WORLD.place, LONG.duration_s)


def _changed(faults: Perturbations) -> dict[str, object]:
    clean = asdict(Perturbations())
    return {field: value for field, value in asdict(faults).items() if value != clean[field]}


def test_the_sweep_turns_on_one_switch_at_a_time() -> None:
    assert len(SWEEP) == sum(len(fault.strengths) for fault in FAULTS.values())
    for name, faults in SWEEP.items():
        fault = FAULTS[name.partition("=")[0]]
        assert _changed(faults) == {fault.field: float(name.partition("=")[2])}
        assert parse(name) == faults


def test_the_middle_setting_has_every_fault_a_robot_lives_with_at_once() -> None:
    assert set(_changed(ALL_MIDDLE)) == {fault.field for fault in FAULTS.values() if fault.middle}
    assert parse("middle") == ALL_MIDDLE
    assert {FAULTS[name].middle for name in ("imu-dropout", "scans-lost", "blocked", "kidnap", "wheel-slip")} == {0.0}


def test_names_add_up_and_a_later_one_wins() -> None:
    assert parse("none") == parse("") == Perturbations()
    assert parse("people=5, laser-bias=0.03") == Perturbations(walking_people=5, laser_bias_m=0.03)
    assert parse("laser-bias") == Perturbations(laser_bias_m=FAULTS["laser-bias"].strengths[0])
    assert parse("middle,glass=0") == replace(ALL_MIDDLE, glass=0.0)


@pytest.mark.parametrize("text", ["people=1.5", "glass=-1", "laser-bias=", "imu-offset=nan", "kidnap=inf", "fog"])
def test_a_strength_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="--perturb"):
        parse(text)


def test_an_imu_dropout_is_a_hole_and_nothing_else() -> None:
    whole = simulate_imu(LONG, TRAJECTORY)
    holed = simulate_imu(replace(LONG, perturbations=Perturbations(imu_dropout_s=1.0)), TRAJECTORY)
    gap_s = np.diff(holed.stamps_ns) * 1e-9
    assert np.sort(gap_s)[-2:] == pytest.approx([0.002, 1.002])
    assert (holed.stamps_ns[np.argmax(gap_s)] - LONG.start_ns) * 1e-9 == pytest.approx(19.998)
    kept = np.isin(whole.stamps_ns, holed.stamps_ns)
    np.testing.assert_array_equal(whole.gyro_radps[kept], holed.gyro_radps)


def test_a_slower_imu_is_slower_in_recording_and_robot_file() -> None:
    spec = replace(SHORT, perturbations=Perturbations(imu_rate_hz=100.0))
    assert set(np.diff(simulate_imu(spec, TRAJECTORY).stamps_ns)) == {10_000_000}
    assert carried_imu(spec).rate_hz == 100.0


def test_a_random_mounting_is_stated_as_it_is_and_another_with_each_seed() -> None:
    mounted = [replace(SHORT, seed=seed, perturbations=Perturbations(imu_random_mounting=1)) for seed in (1, 2, 3)]
    t_s = np.linspace(0.6, 2.9, 50)
    usual = [a @ stated_T_lidar_imu(SHORT)[:3, :3].T for a in true_imu(SHORT, TRAJECTORY, t_s)]
    turned_by = []
    for spec in mounted:
        R = stated_T_lidar_imu(spec)[:3, :3]
        for measured, expected in zip(true_imu(spec, TRAJECTORY, t_s), usual, strict=True):
            np.testing.assert_allclose(measured @ R.T, expected, atol=1e-9)
        turned_by.append(R)
    apart = [se3.angle(turned_by[0].T @ R) for R in turned_by[1:]]
    assert min(apart) > 0.2


def test_an_extrinsic_error_turns_what_the_robot_file_says_by_that_angle() -> None:
    for degrees in (0.5, 2.0):
        spec = replace(SHORT, perturbations=Perturbations(extrinsic_error_deg=degrees))
        off = T_lidar_imu(spec.imu)[:3, :3].T @ stated_T_lidar_imu(spec)[:3, :3]
        assert np.degrees(se3.angle(off)) == pytest.approx(degrees, rel=1e-6)


def test_scale_and_misalignment_change_readings_in_proportion() -> None:
    still = replace(LONG, duration_s=2.0, path=replace(LONG.path, stand_s=9.0))
    trajectory = make_trajectory(still.path, WORLD.place, still.duration_s)
    off = []
    for seed in range(30):
        clean, scaled = (
            simulate_imu(replace(still, seed=seed, perturbations=Perturbations(imu_scale=s)), trajectory).accel_mps2[0]
            for s in (0.0, 0.01)
        )
        up = int(np.argmax(np.abs(clean)))
        off.append(scaled[up] / clean[up] - 1.0)
    assert np.std(off) == pytest.approx(0.01, rel=0.4)


def test_vibration_is_a_37_hz_shake_of_the_given_amplitude_while_moving() -> None:
    clean, shaken = (
        simulate_imu(replace(LONG, perturbations=Perturbations(imu_vibration_mps2=a)), TRAJECTORY).accel_mps2
        for a in (0.0, 2.0)
    )
    shake = (shaken - clean)[5_000:10_000, 0]
    assert np.abs(shake).max() == pytest.approx(2.0, rel=0.01)
    spectrum = np.abs(np.fft.rfft(shake))
    assert np.fft.rfftfreq(len(shake), 1 / 500.0)[np.argmax(spectrum)] == pytest.approx(37.0, abs=0.1)
    assert np.abs((shaken - clean)[:200]).max() < 1e-5, "it stands still at first"


def test_the_gnss_jump_is_fifteen_metres_for_six_seconds() -> None:
    usual, jumped = (
        simulate_gnss(replace(LONG, perturbations=Perturbations(gnss_jump_m=m)), TRAJECTORY) for m in (0.0, 15.0)
    )
    t_s = np.array([(fix.stamp_ns - LONG.start_ns) * 1e-9 for fix in usual])
    to_m = np.radians(6_371_000.0) * np.array([1.0, np.cos(np.radians(usual[0].latitude_deg))])
    moved = np.array([(b.latitude_deg - a.latitude_deg, b.longitude_deg - a.longitude_deg)
                      for a, b in zip(usual, jumped, strict=True)]) * to_m  # fmt: skip
    off_m = np.linalg.norm(moved, axis=1)
    during = (t_s > 19.99) & (t_s < 25.99)
    np.testing.assert_allclose(off_m[during], 15.0, rtol=0.005)
    assert during.sum() == 30
    assert off_m[~during].max() < 1e-6
