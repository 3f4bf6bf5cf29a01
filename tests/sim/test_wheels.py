"""Wheel odometry against the motion it measures."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from rosbags.rosbag1 import Reader
from rosbags.typesys import Stores, get_typestore

from splitslam import se3
from splitslam.sim import DRIVES, simulate
from splitslam.sim.spec import Perturbations, WheelSpec
from splitslam.sim.trajectory import drive_trajectory
from splitslam.sim.wheels import T_body_lidar, simulate_wheels
from splitslam.sim.world import make_world

PERFECT = WheelSpec(scale_error=0.0, speed_noise_mps=0.0, yaw_rate_noise_radps=0.0)
SPEC = replace(DRIVES["twins"], duration_s=32.0)
TRAJECTORY = drive_trajectory(SPEC, make_world(SPEC.world).place)


def test_perfect_wheels_add_up_to_the_way_of_the_body() -> None:
    samples = simulate_wheels(SPEC, PERFECT, TRAJECTORY)
    T_lidar_body = se3.inv(T_body_lidar(SPEC))
    start, end = (TRAJECTORY.T_world_lidar(t) @ T_lidar_body for t in (0.0, SPEC.duration_s))
    moved = se3.inv(start) @ end
    np.testing.assert_allclose(samples.pose[-1, :2], moved[:2, 3], atol=0.05)
    assert np.linalg.norm(moved[:2, 3]) > 15.0
    assert samples.pose[-1, 2] == pytest.approx(np.arctan2(moved[1, 0], moved[0, 0]), abs=0.02)


def test_the_speed_is_the_derivative_of_the_body_s_position_along_its_axis() -> None:
    samples = simulate_wheels(SPEC, PERFECT, TRAJECTORY)
    T_lidar_body = se3.inv(T_body_lidar(SPEC))
    h = 1e-4
    for k in range(0, len(samples.speed_mps), 97):
        t = k / PERFECT.rate_hz
        before, now, after = (TRAJECTORY.T_world_lidar(t + d) @ T_lidar_body for d in (-h, 0.0, h))
        velocity = now[:3, :3].T @ (after[:3, 3] - before[:3, 3]) / (2 * h)
        turned = se3.so3_log(before[:3, :3].T @ after[:3, :3]) / (2 * h)
        assert samples.speed_mps[k] == pytest.approx(velocity[0], abs=1e-5)
        assert samples.yaw_rate_radps[k] == pytest.approx(turned[2], abs=1e-5)


def test_scale_error_and_noise_are_those_of_the_spec() -> None:
    perfect = simulate_wheels(SPEC, PERFECT, TRAJECTORY).speed_mps
    fast = perfect > 1.9
    scales = []
    for seed in range(40):
        told = simulate_wheels(replace(SPEC, seed=seed), WheelSpec(), TRAJECTORY).speed_mps
        scales.append((told[fast] / perfect[fast]).mean() - 1.0)
    assert np.std(scales) == pytest.approx(0.01, rel=0.35)
    still = perfect < 1e-9
    told = simulate_wheels(SPEC, WheelSpec(), TRAJECTORY).speed_mps
    assert told[still].std() == pytest.approx(WheelSpec().speed_noise_mps, rel=0.25)


def test_wheels_spin_and_drag_in_episodes() -> None:
    grip = simulate_wheels(SPEC, PERFECT, TRAJECTORY).speed_mps
    slipping = replace(SPEC, perturbations=Perturbations(wheel_slip=0.5))
    share = simulate_wheels(slipping, PERFECT, TRAJECTORY).speed_mps / np.maximum(grip, 1e-9) - 1.0
    t_s = np.arange(len(grip)) / PERFECT.rate_hz
    moving = grip > 0.1
    for start, by in ((6.0, 0.5), (16.0, -0.5), (26.0, 0.5)):
        during = (t_s > start) & (t_s < start + 1.5) & moving
        assert during.sum() > 50
        np.testing.assert_allclose(share[during], by, atol=1e-9)
    np.testing.assert_allclose(share[(t_s > 8.0) & (t_s < 15.9) & moving], 0.0, atol=1e-9)


def test_the_recording_and_the_robot_file_have_wheels_only_when_asked_for(tmp_path: Path) -> None:
    spec = replace(DRIVES["corridor"], duration_s=1.0)
    for wheels in (None, WheelSpec()):
        made = simulate(replace(spec, wheels=wheels), tmp_path)
        robot = yaml.safe_load(made.robot_path.read_text())
        store = get_typestore(Stores.ROS1_NOETIC)
        with Reader(made.bag_path) as bag:
            found = [c for c in bag.connections if c.topic == "/wheel/odom"]
            messages: list[Any] = (
                [store.deserialize_ros1(raw, c.msgtype) for c, _, raw in bag.messages(found)] if found else []
            )
        if wheels is None:
            assert "wheels" not in robot
            assert not messages
        else:
            assert robot["wheels"] == {"topic": "/wheel/odom"}
            assert np.array(robot["T_body_lidar"])[:3, 3] == pytest.approx((0.0, 0.0, spec.path.height_m))
            assert len(messages) == 50
            assert {m.child_frame_id for m in messages} == {"base_link"}
            stamps = [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in messages]
            assert set(np.diff(stamps)) == {20_000_000}


def _of(bag: Reader, connections: list[Any]) -> Iterator[tuple[Any, int, bytes]]:
    return bag.messages(connections) if connections else iter(())
