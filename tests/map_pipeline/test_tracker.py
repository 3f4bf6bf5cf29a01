from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from map_service.settings import TrackerSettings
from map_service.tracker import Tracker
from map_service.types import State
from splitslam import se3
from splitslam.features import FeatureFrame, FeatureSet, Knots, Motion
from tests.map_pipeline.naive import room

SCAN_NS = 100_000_000
STEP = se3.exp(np.array([0, 0, 0.03, 0.12, 0.02, 0]))
KNOTS = Knots(np.array([0, SCAN_NS]), np.zeros((2, 3)), np.zeros((2, 3)))


def features(points: np.ndarray, t_offset_ns: np.ndarray | None = None) -> FeatureSet:
    n = len(points)
    offsets = np.zeros(n, np.int32) if t_offset_ns is None else t_offset_ns.astype(np.int32)
    return FeatureSet(
        points.astype(np.float32), np.zeros(n, np.uint8), np.zeros(n, np.uint16), offsets, np.zeros(n, np.uint8)
    )


def frame(
    seq: int, T_map_lidar: np.ndarray, rng: np.random.Generator, *, known: bool = True, skew=None
) -> FeatureFrame:
    """What the robot sees of the room at T_map_lidar; `skew` (3,): a velocity that nothing was told of."""
    surfs, corners = room(rng, 2500, 0.02)
    back = se3.inv(T_map_lidar)
    sets = []
    for points in (corners, surfs):
        lidar = points @ back[:3, :3].T + back[:3, 3]
        offsets = rng.integers(0, SCAN_NS, len(lidar))
        if skew is not None:
            lidar = lidar - (offsets * 1e-9)[:, None] * skew
        sets.append(features(lidar, offsets))
    sigma = 0.02 if known else 1.0
    motion = Motion(
        STEP if known else np.eye(4), np.diag(np.repeat([1e-3**2, sigma**2], 3)), np.zeros(3), KNOTS,
        np.array([0, 0, -1.0]), 0.02, known,
    )  # fmt: skip
    return FeatureFrame(seq, seq * SCAN_NS, True, motion, sets[0], sets[1])


def drive(seqs: list[int], **options) -> tuple[Tracker, list[float], list[State]]:
    tracker, rng = Tracker(TrackerSettings(), redeskew=True), np.random.default_rng(1)
    T0 = se3.compose(np.eye(3), np.array([-1.0, -0.5, 1.2]))
    errors, states = [], []
    for seq in seqs:
        T = T0 @ np.linalg.matrix_power(STEP, seq - 1)
        track = tracker.process(frame(seq, T, rng, **options))
        if track.keyframe:
            tracker.insert(seq, track.T_local_lidar, track.corners_lidar, track.surfs_lidar)
        errors.append(float(np.linalg.norm((se3.inv(T0 @ track.T_local_lidar) @ T)[:3, 3])))
        states.append(track.state)
    return tracker, errors, states


def test_a_drive_through_the_room_is_tracked_to_a_centimetre():
    tracker, errors, states = drive(list(range(1, 25)))
    assert max(errors) < 0.02
    assert states[0] == State.INITIALISING
    assert set(states[1:]) == {State.TRACKING}
    assert len(tracker.local_map.keyframes) >= 2


def test_rejected_frames_leave_a_hole_that_is_bridged():
    _, errors, states = drive([1, 2, 3, 4, 5, 6, 11, 12, 13])
    assert max(errors) < 0.03
    assert states[-1] == State.TRACKING


def test_a_moving_start_is_put_together_and_the_first_keyframe_is_deskewed_again():
    velocity = STEP[:3, 3] / 0.1
    tracker, rng = Tracker(TrackerSettings(), redeskew=True), np.random.default_rng(2)
    T0 = se3.compose(np.eye(3), np.array([-1.0, -0.5, 1.2]))
    straight = se3.compose(np.eye(3), STEP[:3, 3])
    for seq in (1, 2, 3):
        T = T0 @ np.linalg.matrix_power(straight, seq - 1)
        track = tracker.process(frame(seq, T, rng, known=False, skew=velocity))
        if seq == 1:
            tracker.insert(0, track.T_local_lidar, track.corners_lidar, track.surfs_lidar)
        if seq == 2:
            assert track.first_again is not None
            assert track.registration is not None
            np.testing.assert_allclose(track.registration.delta_twist[3:], velocity, atol=0.1)
    assert np.linalg.norm((se3.inv(T0 @ track.T_local_lidar) @ T)[:3, 3]) < 0.02
    assert track.state == State.INITIALISING


def test_with_nothing_to_see_the_edge_s_motion_carries_on_until_lost():
    tracker, _, _ = drive([1, 2, 3])
    nothing = features(np.zeros((0, 3)))
    rng = np.random.default_rng(3)
    assert tracker.state is not None
    before = tracker.state.T_local_lidar
    states = []
    for seq in range(4, 18):
        blind = frame(seq, np.eye(4), rng)
        track = tracker.process(FeatureFrame(seq, blind.stamp_ns, True, blind.motion, nothing, nothing))
        states.append(track.state)
        assert not track.keyframe
    np.testing.assert_allclose(track.T_local_lidar, before @ np.linalg.matrix_power(STEP, 14), atol=1e-6)
    assert states[0] == State.DEGENERATE
    assert states[-1] == State.LOST


def turning(seq: int, T: np.ndarray, yaw_radps: float, rng: np.random.Generator) -> FeatureFrame:
    """Without an IMU, as one who turns at yaw_radps while the scan is taken, and who deskews by no motion at all."""
    seen = frame(seq, T, rng)

    def skewed(points: FeatureSet) -> FeatureSet:
        angle = -yaw_radps * points.t_offset_ns * 1e-9
        x, y, z = points.points_lidar.T
        turned = np.column_stack([np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y, z])
        return features(turned, points.t_offset_ns)

    covariance = np.diag(np.repeat([0.05**2, 0.05**2], 3))
    motion = replace(seen.motion, T_prev_lidar=np.eye(4), covariance=covariance, gravity_sigma_rad=0.5)
    return replace(seen, motion=motion, corners=skewed(seen.corners), surfs=skewed(seen.surfs))


def test_a_head_turn_without_an_imu_is_doubted_by_what_the_deskew_is_off():
    """A scan is deskewed by the motion before it: at 4 rad/s2 its points lie 20 mrad off in the mean."""
    tracker, rng = Tracker(TrackerSettings(), redeskew=True), np.random.default_rng(1)
    T0, yaw_rad = se3.compose(np.eye(3), np.array([-1.0, -0.5, 1.2])), 0.0
    in_sigmas, errors_rad = [], []
    for seq in range(1, 22):
        T = T0 @ se3.exp(np.array([0, 0, yaw_rad, 0, 0, 0]))
        now_radps = 0.0 if seq < 8 else 0.4 * (seq - 7) if seq < 15 else 0.4 * (21 - seq)
        track = tracker.process(turning(seq, T, now_radps, rng))
        if track.keyframe:
            tracker.insert(seq, track.T_local_lidar, track.corners_lidar, track.surfs_lidar)
        if track.registration is not None:
            error = se3.log(se3.inv(T0 @ track.T_local_lidar) @ T)[2]
            errors_rad.append(abs(error))
            in_sigmas.append(error / np.sqrt(track.registration.covariance[2, 2]))
        yaw_rad += now_radps * SCAN_NS * 1e-9
    assert max(errors_rad) > 0.01  # it does happen
    assert np.mean(np.square(in_sigmas)) < 2.0
    assert max(errors_rad[:6]) < 0.002


def bare(frame: FeatureFrame) -> FeatureFrame:
    nothing = features(np.zeros((0, 3)))
    return replace(frame, dense=False, corners=nothing, surfs=nothing)


def test_frames_that_carry_the_motion_alone_are_followed_and_the_next_registration_knows_how_far():
    """The edge's motion is off by 1 mm a scan; every fourth scan has points, and finds the pose again."""
    tracker, _, _ = drive([1, 2, 3])
    rng = np.random.default_rng(4)
    T0 = se3.compose(np.eye(3), np.array([-1.0, -0.5, 1.2]))
    drift = se3.exp(np.array([0, 0, 0, 0.001, 0, 0]))
    errors, sigmas = [], []
    for seq in range(4, 25):
        T = T0 @ np.linalg.matrix_power(STEP, seq - 1)
        whole = frame(seq, T, rng)
        whole = replace(whole, motion=replace(whole.motion, T_prev_lidar=STEP @ drift))
        track = tracker.process(whole if seq % 4 == 0 else bare(whole))
        assert track.state == State.TRACKING
        assert track.registration is not None
        assert len(track.registration.degenerate_axes) == (0 if seq % 4 == 0 else 6)
        if track.keyframe:
            assert seq % 4 == 0
            tracker.insert(seq, track.T_local_lidar, track.corners_lidar, track.surfs_lidar)
        errors.append(float(np.linalg.norm((se3.inv(T0 @ track.T_local_lidar) @ T)[:3, 3])))
        sigmas.append(float(np.sqrt(track.registration.covariance[3, 3])))
    assert max(errors) < 0.02
    assert sigmas[1] < sigmas[2] < sigmas[3]  # seq 5, 6, 7
    assert sigmas[4] < sigmas[1]


def test_without_points_for_long_the_pose_is_called_degenerate_and_found_again():
    tracker, _, _ = drive([1, 2, 3])
    rng = np.random.default_rng(5)
    T0 = se3.compose(np.eye(3), np.array([-1.0, -0.5, 1.2]))
    states = []
    for seq in range(4, 14):
        T = T0 @ np.linalg.matrix_power(STEP, seq - 1)
        whole = frame(seq, T, rng)
        states.append(tracker.process(whole if seq == 13 else bare(whole)).state)
    assert states[0] == State.TRACKING
    assert states[-2] == State.DEGENERATE
    assert states[-1] == State.TRACKING


@pytest.mark.parametrize("redeskew", [True, False])
def test_moving_the_frame_moves_everything(redeskew):
    tracker, _, _ = drive([1, 2, 3])
    assert tracker.state is not None
    before = tracker.state
    T = se3.exp(np.array([0, 0, 1.0, 5, 6, 7]))
    tracker.move(T)
    np.testing.assert_allclose(tracker.state.T_local_lidar, T @ before.T_local_lidar, atol=1e-9)
    np.testing.assert_allclose(tracker.state.T_local_keyframe, T @ before.T_local_keyframe, atol=1e-9)
