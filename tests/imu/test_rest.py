"""A robot that has not moved yet knows where down is, also where its LiDAR does not see whether it drives off."""

from __future__ import annotations

import numpy as np
import pytest

from edge_agent.imu.buffer import ImuWindow
from edge_agent.imu.filter import MotionFilter
from edge_agent.imu.rest import AtRest, Rest
from edge_agent.imu.settings import ImuSettings
from edge_agent.imu.state import ImuNoise, NavigationState
from splitslam import se3
from tests import tolerances as bars
from tests.imu.made import SCAN_NS, START_NS, G

NOISE = ImuNoise(1.2e-4, 2.5e-4, 2e-5, 2e-4)
STEP_NS = 2_000_000
ALONG = np.array([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0]])


def window(k: int, rng: np.random.Generator, force_mps2: np.ndarray, shake_mps2: float = 5e-3) -> ImuWindow:
    """The IMU between scans k - 1 and k; force_mps2: (3,) or (N, 3)."""
    stamps_ns = START_NS + (k - 1) * SCAN_NS + np.arange(0, SCAN_NS + 1, STEP_NS)
    shake = rng.normal(0.0, shake_mps2, (len(stamps_ns), 3))
    return ImuWindow(stamps_ns, rng.normal(0.0, 2.7e-3, shake.shape), force_mps2 + shake)


def forward_mps2(seconds: float, rest: Rest | None) -> float:
    """After so long at rest in a place without anything to see along x: the acceleration that the filter believes in.

    It has begun 30 mrad askew. Along x answers are the filter's own prediction; they say so, give or take 0.1 rad.
    """
    rng = np.random.default_rng(3)
    force = np.array([0.02, -0.01, G + 0.01])  # the bias is of a good IMU
    known = MotionFilter(ImuSettings(), G)
    askew = se3.compose(se3.so3_exp(np.array([0.0, 0.03, 0.0])), np.zeros(3))
    state = NavigationState(START_NS, askew, np.zeros(3), np.zeros(6), np.eye(3) * 100.0, 0.1)
    known.start(state, np.eye(4), 0.1)
    came_m = 0.0
    for k in range(1, round(seconds * 10) + 1):
        now = window(k, rng, force)
        T_server_imu = se3.exp(rng.normal(size=6) * np.repeat([3e-4, 4e-3], 3))
        came_m += float(known.state.velocity_mps[0]) * 0.1 if k > 3 else 0.0
        T_server_imu[0, 3] += came_m
        axis = ALONG.copy()
        axis[0, 4] = rng.normal(0.0, 0.1)
        at_rest = None if rest is None else rest.seen(now)
        known.add(START_NS + k * SCAN_NS, T_server_imu, now, NOISE, axis if k > 3 else ALONG[:0], None, at_rest)
    R, bias = known.state.T_odom_imu[:3, :3], known.state.bias
    return float((R @ (force - bias[3:]))[0])


def test_it_knows_where_down_is_where_nothing_is_seen_along_the_road():
    assert abs(forward_mps2(2.0, Rest())) < bars.REST_ACCELERATION_MPS2
    assert abs(forward_mps2(2.0, None)) > 3 * bars.REST_ACCELERATION_MPS2, "the place is one where it matters"


def test_a_start_that_creeps_is_not_taken_for_rest():
    rng, rest, told = np.random.default_rng(1), Rest(), []
    for k in range(1, 41):  # from scan 20 on up to 0.4 m/s2, more and more
        now = window(k, rng, np.array([0.0, 0.0, G]))
        u = np.clip((now.stamps_ns - START_NS - 19 * SCAN_NS) / 5e9, 0.0, 1.0)
        now.accel_mps2[:, 0] += 6.0 * (u * (1.0 - u)) ** 2
        told.append(rest.seen(now))
    assert told[10] is not None
    assert rest.over
    assert told[-1] is None
    assert max(abs(each.accel_mps2[0]) for each in told if each is not None) < bars.REST_ACCELERATION_MPS2


@pytest.mark.parametrize("what", ["a bumpy road", "a turn", "a brake", "a steady curve"])
def test_a_start_in_motion_is_not_taken_for_rest(what: str):
    rng, rest = np.random.default_rng(1), Rest()
    for k in range(1, 21):
        now = window(k, rng, np.array([0.0, 0.0, G]), 1.0 if what == "a bumpy road" else 5e-3)
        t_s = (now.stamps_ns - START_NS) * 1e-9
        if what == "a turn":
            now.gyro_radps[:, 2] += 0.1 * np.sin(t_s)
        if what == "a steady curve":  # 20 m/s on a radius of 800 m
            now.gyro_radps[:, 2] += 0.025
            now.accel_mps2[:, 1] += 0.5
        if what == "a brake":
            now.accel_mps2[:, 0] -= np.minimum(t_s, 1.0)
        assert rest.seen(now) is None
    assert rest.over


def test_a_hand_that_sways_is_at_rest_and_less_exact():
    rng, still, swaying = np.random.default_rng(1), Rest(), Rest()
    last: list[AtRest | None] = [None, None]
    for k in range(1, 21):
        sway = np.array([*rng.normal(0.0, 0.02, 2), 0.0])
        last = [rest.seen(window(k, rng, [0.0, 0.0, G] + sway * (rest is swaying))) for rest in (still, swaying)]
    calm, hand = last
    assert calm is not None
    assert hand is not None
    assert hand.sigma_mps2 > calm.sigma_mps2


def test_a_long_rest_takes_no_more_memory_than_a_short_one():
    rng, rest = np.random.default_rng(1), Rest()
    for k in range(1, 200):
        assert rest.seen(window(k, rng, np.array([0.0, 0.0, G]))) is not None or k <= 5
    assert len(rest._accel) < 100
