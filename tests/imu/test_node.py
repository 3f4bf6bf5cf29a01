from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from edge_agent.imu import make_imu_node
from edge_agent.imu.constant_velocity import ConstantVelocityNode
from edge_agent.imu.settings import ImuSettings
from edge_agent.types import OdometryReply
from splitslam import se3
from splitslam.robot import robot_from_yaml
from splitslam.scan import ImuSamples
from tests.imu.made import SCAN_NS, START_NS, Drive, make_node, play


def motion_errors(drive: Drive, seconds: float, rate_hz: float = 200.0, after: int = 50, **settings):
    """Errors (m, rad) of T_prev_lidar after the start phase, and the node."""
    node = make_node(rate_hz, **settings)
    T_imu_lidar = se3.inv(node.robot.T_lidar_imu)
    errors = []
    for k, _, motion, _ in play(node, drive, seconds, rate_hz):
        if k >= after:
            a, b = (drive.T_odom_imu(t) @ T_imu_lidar for t in ((k - 1) * 0.1, k * 0.1))
            error = se3.inv(se3.inv(a) @ b) @ motion.T_prev_lidar
            errors.append((np.linalg.norm(error[:3, 3]), se3.angle(error)))
    return np.array(errors), node


def test_a_robot_that_stands_first_is_predicted_to_a_millimetre_and_its_biases_are_found():
    drive = Drive(still_s=2.0)
    errors, node = motion_errors(drive, 15.0)
    assert np.median(errors[:, 0]) < 0.001
    assert np.median(errors[:, 1]) < 2e-4
    assert node._anchor is not None
    np.testing.assert_allclose(node._anchor.bias[:3], drive.gyro_bias, atol=5e-4)


def test_a_moving_start_is_caught_up_with():
    errors, node = motion_errors(Drive(speed_mps=8.0), 12.0)
    assert np.median(errors[:, 0]) < 0.01
    assert node.resets == 0


def test_answers_of_two_seconds_ago_do_not_make_a_velocity_known_while_down_is_not():
    """A start in motion without a service: 0.1 rad of tilt are 2 m/s after two seconds of integration."""
    node, drive, known = make_node(), Drive(speed_mps=2.0), []
    T_imu_lidar = se3.inv(node.robot.T_lidar_imu)
    for k, _, motion, _ in play(node, drive, 8.0, delay=20):
        a, b = (drive.T_odom_imu(t) @ T_imu_lidar for t in ((k - 1) * 0.1, k * 0.1))
        error_m = np.linalg.norm((se3.inv(se3.inv(a) @ b) @ motion.T_prev_lidar)[:3, 3])
        sigma_m = float(np.sqrt(np.linalg.eigvalsh(motion.covariance[3:, 3:])[-1]))
        assert k == 0 or error_m < 4.0 * sigma_m
        if motion.velocity_known:
            known.append(k)
            assert sigma_m <= 0.031
    assert 21 < known[0] < 40
    assert known == list(range(known[0], known[-1] + 1))


def test_a_10_hz_imu_is_enough_to_predict_a_scan():
    errors, _ = motion_errors(Drive(speed_mps=5.0, wobble_rad=0.02), 15.0, rate_hz=10.0)
    assert np.median(errors[:, 0]) < 0.04
    assert np.median(errors[:, 1]) < 0.01


@pytest.mark.parametrize("drive", [Drive(still_s=2.0), Drive(speed_mps=8.0)], ids=["still", "moving"])
def test_the_doubt_of_where_down_is_falls_and_stays_honest(drive):
    T_imu_lidar = se3.inv(make_node().robot.T_lidar_imu)
    errors, sigmas = [], []
    for k, _, motion, _ in play(make_node(), drive, 20.0):
        down = (drive.T_odom_imu(k * 0.1) @ T_imu_lidar)[:3, :3].T @ np.array([0.0, 0.0, -1.0])
        errors.append(np.arccos(np.clip(down @ motion.gravity_lidar, -1.0, 1.0)))
        sigmas.append(motion.gravity_sigma_rad)
    assert sigmas[-1] < 0.5 * sigmas[0]
    late = slice(len(errors) // 2, None)
    assert np.mean(np.array(errors[late]) < 3.0 * np.array(sigmas[late])) > 0.95


def test_the_pose_comes_at_imu_rate_and_never_steps():
    node = make_node(200.0)
    drive = Drive(still_s=2.0)
    stamps, positions = [], []
    for _, _, _, poses in play(node, drive, 10.0):
        if poses is not None:
            stamps.extend(poses.stamps_ns)
            positions.extend(poses.positions_m)
    steps_ns = np.diff(stamps)
    assert set(steps_ns[1:]) == {5_000_000}
    speed = np.linalg.norm(np.diff(positions, axis=0), axis=1) / (steps_ns * 1e-9)
    assert speed.max() < 1.5 * drive.speed_mps + 0.2
    assert node.jumps["odom_max_m"] < 0.002
    assert node.jumps["odom_max_deg"] < 0.03


def test_how_fast_the_robot_turns_is_what_the_last_two_answers_say():
    node, drive = make_node(), Drive(speed_mps=3.0)
    for k, _, _, _ in play(node, drive, 5.0):
        pass
    before, after = (drive.T_odom_imu(0.1 * answered)[:3, :3] for answered in (k - 3, k - 2))
    expected = se3.so3_log(before.T @ after) / 0.1
    np.testing.assert_allclose(node.imu.rate_radps(), expected, atol=0.1 * float(np.linalg.norm(expected)))
    assert np.linalg.norm(expected) > 0.1


def test_poses_that_come_later_are_those_that_would_have_come_at_once():
    drive, nodes = Drive(speed_mps=2.0), (make_node(), make_node())
    stamps = START_NS + np.arange(200) * 5_000_000
    values = [np.array(v) for v in zip(*(drive.imu((ns - START_NS) * 1e-9) for ns in stamps), strict=True)]
    runs = [ImuSamples(stamps[a:b], values[0][a:b], values[1][a:b]) for a, b in ((0, 25), (25, 45), (45, 47), (47, 65))]
    given, motions = [], []
    for node, later in zip(nodes, (False, True), strict=True):
        node.add_imu(runs[0])
        node.motion_over(START_NS, START_NS + SCAN_NS)
        poses = [node.add_imu(runs[1]), node.add_imu(runs[2], later)]
        motion = node.motion_over(START_NS + SCAN_NS, START_NS + 2 * SCAN_NS)
        given.append([*poses, node.add_imu(runs[3])])
        assert len(given[-1][1].stamps_ns) == (0 if later else 2)
        motions.append(motion.T_prev_lidar)
    at_once, later = (np.concatenate([p.positions_m for p in poses]) for poses in given)
    np.testing.assert_allclose(at_once, later, atol=1e-12)
    np.testing.assert_array_equal(*motions)
    assert len(later) == 40


def test_without_answers_the_pose_goes_on():
    node = make_node(200.0)
    count = 0
    for _, _, motion, poses in play(node, Drive(still_s=2.0), 3.0, answers=False):
        count += 0 if poses is None else len(poses.stamps_ns)
        assert np.isfinite(motion.T_prev_lidar).all()
        assert not motion.velocity_known
    assert count > 500


def test_a_late_or_rejected_answer_changes_nothing():
    node = make_node(200.0)
    for k, _, _, _ in play(node, Drive(still_s=2.0), 4.0):
        last = k
    before = node._anchor
    for rejected, age in (("corrupt", 1), ("", 30)):
        far = se3.compose(np.eye(3), np.array([50.0, 0, 0]))
        stamp = START_NS + (last - age) * SCAN_NS
        node.on_odometry(OdometryReply(last - age, stamp, far, np.eye(4), np.eye(6), 2, np.zeros((0, 6)), rejected))
    assert node._anchor is before


def test_poses_that_a_lost_service_carried_do_not_start_the_node():
    """They say that the robot stands; it drives at 1 m/s, and a velocity that is sure and wrong bends what follows."""
    node = make_node(200.0)
    original = node.on_odometry
    lost_until = 8

    def answer(reply: OdometryReply) -> None:
        if reply.seq <= lost_until:
            reply = replace(reply, T_map_lidar=np.eye(4), degenerate_axes=np.eye(6), state=6)
        original(reply)

    node.on_odometry = answer  # type: ignore[method-assign]
    known = [k for k, _, motion, _ in play(node, Drive(still_s=0.0), 3.0) if motion.velocity_known]
    assert known[0] == lost_until + 3  # two answers, two scans late each
    assert node.state == 2


def test_a_minute_without_answers_costs_no_scan_more_than_the_last_ones_and_an_old_answer_changes_nothing():
    node, drive, history_s = make_node(200.0), Drive(still_s=2.0), ImuSettings().history_s
    old: list[OdometryReply] = []
    original = node.on_odometry
    node.on_odometry = old.append  # type: ignore[method-assign]
    samples = [len(node.imu) for _ in play(node, drive, 3 * history_s)]
    assert max(samples) < 200.0 * (history_s + 2.0)
    for reply in old:
        original(replace(reply, T_map_lidar=np.eye(4)))
        if reply.stamp_ns < START_NS + int(18e9):
            assert not node._started


def test_a_jump_of_the_map_moves_t_map_odom_and_not_t_odom_lidar():
    node, drive = make_node(200.0), Drive(still_s=2.0)
    jump = se3.compose(se3.so3_exp(np.array([0, 0, 0.3])), np.array([4.0, -2.0, 0.5]))
    original = node.on_odometry

    def corrected(reply):  # the service closes a loop at scan 60
        from dataclasses import replace

        if reply.seq > 60:
            reply = replace(reply, T_map_lidar=jump @ reply.T_map_lidar, T_map_odom=jump)
        original(reply)

    node.on_odometry = corrected  # type: ignore[method-assign]
    maps = []
    for _ in play(node, drive, 10.0):
        maps.append(node.T_map_odom)
    assert node.jumps["odom_max_m"] < 0.002
    assert np.linalg.norm((se3.inv(jump) @ maps[-1])[:3, 3]) < 0.05
    assert np.linalg.norm(maps[50][:3, 3]) < 0.05


@pytest.mark.parametrize("enabled", [True, False])
def test_without_an_imu_the_last_twist_goes_on(enabled):
    bare = robot_from_yaml("imu: null")
    node = make_imu_node(bare if enabled else make_node().robot, ImuSettings(), enabled)
    assert isinstance(node, ConstantVelocityNode)
    step = se3.exp(np.array([0, 0, 0.02, 0.15, 0, 0]))
    T = np.eye(4)
    poses = []
    for k in range(20):
        start = START_NS + k * SCAN_NS
        if k >= 2:
            node.on_odometry(
                OdometryReply(k - 1, start - 2 * SCAN_NS, poses[k - 2], np.eye(4), np.eye(6), 2, np.zeros((0, 6)))
            )
        motion = node.motion_over(start, start + SCAN_NS)
        poses.append(T)
        T = T @ step
    np.testing.assert_allclose(motion.T_prev_lidar, step, atol=1e-6)
    np.testing.assert_allclose(motion.knots.translation_m[-1], step[:3, 3], atol=1e-3)
    assert np.linalg.norm((node.T_map_odom @ node.T_odom_lidar_at(start) @ se3.inv(poses[-1]))[:3, 3]) < 1e-6


def test_a_pose_is_not_believed_along_what_the_lidar_did_not_observe():
    node, drive = make_node(200.0), Drive(still_s=2.0)
    original = node.on_odometry
    along = np.array([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0]])

    def told(reply):  # from scan 60 on it slides away forwards, and says so
        from dataclasses import replace

        if reply.seq > 60:
            slide = se3.compose(np.eye(3), np.array([0.03 * (reply.seq - 60), 0.0, 0.0]))
            reply = replace(reply, T_map_lidar=reply.T_map_lidar @ slide, degenerate_axes=along)
        original(reply)

    node.on_odometry = told  # type: ignore[method-assign]
    T_imu_lidar = se3.inv(node.robot.T_lidar_imu)
    for k, _, motion, _ in play(node, drive, 10.0):
        a, b = (drive.T_odom_imu(t) @ T_imu_lidar for t in ((k - 1) * 0.1, k * 0.1))
        error = se3.inv(se3.inv(a) @ b) @ motion.T_prev_lidar
        if k > 60:
            assert abs(error[0, 3]) < 0.01
            assert np.linalg.norm(error[1:3, 3]) < 0.003


def test_a_second_without_answers_costs_centimetres():
    node, drive = make_node(200.0), Drive(still_s=2.0)
    original = node.on_odometry
    node.on_odometry = lambda reply: None if reply.seq % 30 >= 20 else original(reply)  # type: ignore[method-assign]
    T_imu_lidar = se3.inv(node.robot.T_lidar_imu)
    errors, before = [], None
    for k, stamp_ns, _, _ in play(node, drive, 20.0):
        T = node.T_odom_lidar_at(stamp_ns)
        if k >= 60 and k % 30 == 21:
            before = k, T
        if before is not None and k - before[0] == 10:
            a, b = (drive.T_odom_imu(t * 0.1) @ T_imu_lidar for t in (before[0], k))
            error = se3.inv(se3.inv(a) @ b) @ se3.inv(before[1]) @ T
            errors.append(np.linalg.norm(error[:3, 3]))
    assert len(errors) >= 4
    assert np.median(errors) < 0.02
