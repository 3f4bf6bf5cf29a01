from __future__ import annotations

import numpy as np
import pytest

from edge_agent.ros import tf_buffer
from edge_agent.ros.codec import Codec
from edge_agent.ros.tf_buffer import TfBuffer, transform_of
from splitslam import se3

S = 1_000_000_000


def pose(x: float, yaw: float = 0.0) -> np.ndarray:
    return se3.compose(se3.so3_exp(np.array([0.0, 0.0, yaw])), np.array([x, 0.0, 0.0]))


def tree() -> TfBuffer:
    """odom -> base_footprint moves at 1 m/s and turns at 1 rad/s; the rest is fixed."""
    buffer = TfBuffer()
    for k in range(5):
        buffer.add("odom", "base_footprint", k * S, pose(float(k), float(k)))
    buffer.add("base_footprint", "base_link", 0, pose(0.0, 0.5), fixed=True)
    buffer.add("base_link", "velodyne", 0, pose(0.3), fixed=True)
    buffer.add("base_link", "imu_link", 0, pose(-0.1, np.pi), fixed=True)
    return buffer


def test_a_chain_is_multiplied_and_interpolated_in_between():
    found = tree().lookup("odom", "base_link", 1_500_000_000)
    assert found is not None
    np.testing.assert_allclose(found, pose(1.5, 2.0), atol=1e-12)


def test_two_branches_meet_at_their_common_frame():
    found = tree().lookup("velodyne", "imu_link")
    assert found is not None
    np.testing.assert_allclose(found, se3.inv(pose(0.3)) @ pose(-0.1, np.pi), atol=1e-12)


def test_a_chain_is_followed_downwards_as_well():
    found = tree().lookup("imu_link", "odom", 2 * S)
    assert found is not None
    np.testing.assert_allclose(found, se3.inv(pose(2.0, 2.5) @ pose(-0.1, np.pi)), atol=1e-12)


@pytest.mark.parametrize("stamp_ns", [-1, 4 * S + 1])
def test_nothing_is_said_of_times_that_are_not_known(stamp_ns: int):
    assert tree().lookup("odom", "base_link", stamp_ns) is None


def test_frames_that_are_not_connected_are_not_made_up():
    assert tree().lookup("odom", "camera", S) is None
    assert tree().lookup("world", "base_link", S) is None


def test_how_far_a_chain_is_known_is_what_its_slowest_link_says():
    buffer = tree()
    buffer.add("world", "odom", 3 * S, np.eye(4))
    assert buffer.newest_ns("velodyne") == 3 * S
    assert buffer.newest_ns("camera") is None


def test_a_slash_in_front_of_a_frame_is_the_same_frame():
    buffer = TfBuffer()
    buffer.add("/base_link", "/velodyne", 0, pose(1.0), fixed=True)
    assert buffer.lookup("base_link", "velodyne") is not None


def test_what_was_said_before_the_clock_was_set_back_is_forgotten():
    buffer = tree()
    buffer.add("odom", "base_footprint", S, pose(7.0))
    assert buffer.lookup("odom", "base_footprint", 4 * S) is None
    found = buffer.lookup("odom", "base_footprint", S)
    assert found is not None
    assert found[0, 3] == 7.0


def test_old_transforms_are_let_go():
    buffer = tree()
    for k in range(2000):
        buffer.add("odom", "base_footprint", (10 + k) * S // 10, pose(0.0))
    assert buffer.lookup("odom", "base_footprint", 20 * S) is None
    assert buffer.lookup("odom", "base_footprint", 200 * S) is not None


def test_a_circle_of_frames_ends_the_search():
    buffer = TfBuffer()
    buffer.add("a", "b", 0, pose(1.0), fixed=True)
    buffer.add("b", "a", 0, pose(1.0), fixed=True)
    assert buffer.lookup("c", "a") is None
    assert buffer.newest_ns("a") is None


@pytest.mark.parametrize("quat", [(0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 2.0), (float("nan"), 0.0, 0.0, 1.0)])
def test_what_is_no_rigid_transform_is_refused(quat: tuple[float, ...]):
    codec = Codec("cdr")
    vector = codec.make("geometry_msgs/msg/Vector3", 1.0, 2.0, 3.0)
    rotation = codec.make("geometry_msgs/msg/Quaternion", *quat)
    assert transform_of(codec.make("geometry_msgs/msg/Transform", vector, rotation)) is None


def test_frames_that_are_named_once_and_never_again_make_room_and_the_robots_own_stay():
    buffer = tree()
    for k in range(5 * tf_buffer._MOST_FRAMES):
        buffer.add("odom", f"track_{k}", (5 + k) * S // 100, pose(1.0))
        if k % 1000 == 0:
            buffer.add("odom", "base_footprint", 5 * S + k, pose(2.0))
    assert len(buffer._edges) == tf_buffer._MOST_FRAMES
    assert buffer.lookup("odom", "base_link", 5 * S) is not None
    assert buffer.lookup("velodyne", "imu_link") is not None
    assert buffer.parent("track_0") is None


def test_fixed_frames_without_end_are_bounded_as_well():
    buffer = TfBuffer()
    for k in range(2 * tf_buffer._MOST_FRAMES):
        buffer.add("map", f"marker_{k}", 0, pose(1.0), fixed=True)
    assert len(buffer._edges) == tf_buffer._MOST_FRAMES
    assert buffer.parent(f"marker_{2 * tf_buffer._MOST_FRAMES - 1}") == "map"
