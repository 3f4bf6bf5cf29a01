from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from map_service.gnss import GnssGate, Place
from map_service.settings import GnssSettings
from splitslam import se3
from splitslam.scan import GnssFix
from splitslam.sim.gnss import enu_to_wgs84

ORIGIN = (35.5, 139.6, 30.0)
YAW = 2.2
R_ENU_MAP = se3.so3_exp(np.array([0.0, 0.0, YAW]))
JUMP = np.array([12.0, -9.0, 0.0])


def fix_at(position_m: np.ndarray, t_s: float, sigma_m: float = 0.5, status: int = 0) -> GnssFix:
    latitude, longitude, altitude = map(float, enu_to_wgs84((R_ENU_MAP @ position_m)[None], ORIGIN)[0])
    return GnssFix(round(t_s * 1e9), latitude, longitude, altitude, np.eye(3) * sigma_m**2, status)


def way(t_s: float, speed_mps: float = 1.5) -> np.ndarray:
    """Round a yard of 20 m (walking) or a block of 40 m."""
    radius_m = 20.0 if speed_mps < 5.0 else 40.0
    turned = t_s * speed_mps / radius_m
    return radius_m * np.array([np.cos(turned), np.sin(turned), 0.0])


def place_at(position_m: np.ndarray) -> Place:
    return Place(0, np.zeros(3), position_m, np.eye(4))


def drive(
    gate: GnssGate, until_s: float, fault=lambda t_s: np.zeros(3), since_s=0.0, sigma_m=0.5, speed_mps=1.5
) -> list:
    """One fix each 0.2 s, noise-free; returns (t_s, measurement) of what was used."""
    used = []
    for k in range(round(since_s * 5), round(until_s * 5)):
        t = k / 5 + 0.05
        position = way(t, speed_mps)
        offered = gate.offer(fix_at(position + R_ENU_MAP.T @ fault(t), t, sigma_m), place_at(position))
        used += [(m.fix.stamp_ns * 1e-9, m) for m in offered]
    return used


def test_bad_fixes_are_counted_by_reason_and_none_becomes_a_factor():
    gate, here = GnssGate(GnssSettings()), place_at(np.zeros(3))
    good = fix_at(np.zeros(3), 5.0)
    bad = {
        "no_fix": [
            replace(good, status=-1),
            replace(good, latitude_deg=float("nan")),
            replace(good, latitude_deg=91.0),
        ],
        "covariance": [replace(good, covariance_enu_m2=np.eye(3) * 400.0), replace(good, covariance_enu_m2=-np.eye(3))],
    }
    for fixes in bad.values():
        for fix in fixes:
            assert gate.offer(fix, here) == []
    gate.offer(good, here)
    gate.offer(good, here)
    gate.offer(replace(good, stamp_ns=good.stamp_ns - 1), here)
    assert gate.rejected == {"no_fix": 3, "covariance": 2, "duplicate": 1, "out_of_order": 1}
    assert len(gate.waiting) == 1


def test_every_fix_offered_is_used_or_rejected_for_a_reason_or_waits():
    gate = GnssGate(GnssSettings())
    used = drive(gate, 60.0, lambda t: JUMP * (20 < t < 26) + JUMP * (t > 55))
    assert gate.waiting
    assert len(used) + sum(gate.rejected.values()) + len(gate.waiting) == 300


def test_the_datum_is_found_once_five_metres_are_covered_and_knows_the_heading():
    gate = GnssGate(GnssSettings())
    assert not drive(gate, 3.0)
    (_, first), *_ = drive(gate, 6.0, since_s=3.0)
    T = first.T_enu_map
    assert np.arctan2(T[1, 0], T[0, 0]) == pytest.approx(YAW, abs=0.02)
    enu_origin = R_ENU_MAP @ way(0.05)  # `enu` begins at the first fix
    np.testing.assert_allclose(T[:3, 3], -enu_origin, atol=0.5)


@pytest.mark.parametrize("covariance", [None, np.zeros((3, 3))])
def test_a_receiver_that_says_nothing_about_its_noise_is_taken_for_a_poor_one(covariance):
    gate = GnssGate(GnssSettings())
    used = []
    for k in range(300):
        t = k / 5
        used += gate.offer(replace(fix_at(way(t), t), covariance_enu_m2=covariance), place_at(way(t)))
    assert used
    assert all((m.weight.sigmas_m >= 3.0).all() for m in used)


@pytest.mark.parametrize("sigma_m", [0.5, 0.02])
@pytest.mark.parametrize("jump", [JUMP, np.array([0.0, 0.0, 15.0])])
def test_a_jump_is_rejected_and_the_fixes_after_it_are_used_again(jump, sigma_m):
    gate = GnssGate(GnssSettings())
    used = [t for t, _ in drive(gate, 60.0, lambda t: jump * (30.0 < t < 36.0), sigma_m=sigma_m)]
    assert not [t for t in used if 30.0 < t < 36.0]
    assert max(used) > 55.0
    assert gate.rejected["gated"] >= 6
    assert len(gate.data) == 1


def test_a_jump_that_stays_becomes_a_datum_of_its_own_and_coming_back_is_noticed():
    gate = GnssGate(GnssSettings())
    used = drive(gate, 140.0, lambda t: JUMP * (40.0 < t < 100.0))
    data = {m.datum: [t for t, n in used if n.datum == m.datum] for _, m in used}
    assert sorted(data) == [0, 1]
    assert not [t for t in data[0] if 40.0 < t < 100.0]
    assert min(data[1]) > 40.0
    assert max(data[1]) < 100.0
    assert max(data[0]) > 130.0


@pytest.mark.parametrize("sigma_m", [0.5, 0.02])
def test_a_wrong_start_does_not_shut_the_gate(sigma_m):
    gate = GnssGate(GnssSettings())
    used = drive(gate, 90.0, lambda t: JUMP * (t < 20.0), sigma_m=sigma_m)
    assert [m.datum for t, m in used if t > 40.0]
    assert all(m.datum == 1 for t, m in used if t > 40.0)


@pytest.mark.parametrize("begins_s", [0.3, 0.5, 0.7, 0.9])
@pytest.mark.parametrize("aside_rad", np.arange(0.0, 6.2, 0.4))
def test_a_jump_as_long_as_the_way_is_not_taken_for_a_turn(begins_s, aside_rad):
    gate = GnssGate(GnssSettings())
    jump = 15.0 * np.array([np.cos(aside_rad), np.sin(aside_rad), 0.0])
    used = drive(gate, 4.0, lambda t: jump * (t > begins_s), speed_mps=10.0)
    assert used
    for _, m in used:
        assert np.arctan2(m.T_enu_map[1, 0], m.T_enu_map[0, 0]) == pytest.approx(YAW, abs=0.2)


def test_a_fast_ramp_is_noticed_at_once_by_the_nearest_fixes():
    gate = GnssGate(GnssSettings())
    ramp = np.array([0.4, -0.3, 0.0])
    used = drive(gate, 50.0, lambda t: ramp * (t - 30.0) * (30.0 < t < 36.0), sigma_m=0.02, speed_mps=10.0)
    off_m = [0.5 * (t - 30.0) for t, _ in used if 30.0 < t < 36.0]
    assert max(off_m, default=0.0) < 0.5
    assert max(t for t, _ in used) > 48.0


@pytest.mark.parametrize("sigma_m", [0.5, 0.02])
def test_a_creeping_error_is_left_behind(sigma_m):
    gate = GnssGate(GnssSettings())
    used = drive(gate, 70.0, lambda t: np.clip(t - 30.0, 0.0, 30.0) * np.array([0.4, -0.3, 0.0]), sigma_m=sigma_m)
    off = [0.5 * min(t - 30.0, 30.0) for t, m in used if t > 30.0 and m.datum == 0]
    assert max(off, default=0.0) < 3.0 * 2.0**0.5 * 2.0 * sigma_m + 0.2


def test_a_receiver_that_flatters_itself_is_believed_in_the_end_but_weakly():
    gate, rng = GnssGate(GnssSettings()), np.random.default_rng(2)
    noise = {round(k / 5 + 0.05, 2): rng.normal(0, 0.15, 3) for k in range(3000)}
    used = drive(gate, 600.0, lambda t: noise[round(t, 2)], sigma_m=0.02)
    assert len(used) > 20
    assert np.median([m.weight.sigmas_m[0] for _, m in used[-10:]]) > 0.05


def test_a_gate_restored_half_way_decides_as_if_nothing_had_happened():
    straight, halved = GnssGate(GnssSettings()), GnssGate(GnssSettings())

    def fault(t: float) -> np.ndarray:
        return JUMP * (28.0 < t < 33.0)

    expected = drive(straight, 60.0, fault)
    seen = drive(halved, 30.0, fault)
    again = GnssGate(GnssSettings())
    again.load(json.loads(json.dumps(halved.dump())))
    seen += drive(again, 60.0, fault, since_s=30.0)
    assert [(t, m.weight.sigmas_m.tolist()) for t, m in seen] == [(t, m.weight.sigmas_m.tolist()) for t, m in expected]
    assert again.rejected == straight.rejected
