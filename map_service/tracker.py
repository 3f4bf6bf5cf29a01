"""Scan-to-map tracking of one session, in the frame `local` of its local map.

`local` is continuous: graph corrections never move the tracker, they move `map` against `local` (see pipeline.py),
until a rebuild of the local map takes the corrected keyframes over.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from map_service.local_map import LocalMap
from map_service.registration import Prediction, Registration, RegistrationResult
from map_service.settings import TrackerSettings
from map_service.types import State
from splitslam import se3
from splitslam.features import FeatureFrame, FeatureSet

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """The tracker's answer: T_local_lidar (4, 4), how the registration went (None for the first frame)."""

    T_local_lidar: Array
    registration: RegistrationResult | None
    state: State
    keyframe: bool
    corners_lidar: NDArray[np.float32]
    surfs_lidar: NDArray[np.float32]
    first_again: tuple[NDArray[np.float32], NDArray[np.float32]] | None = None  # keyframe 0, deskewed again


@dataclass(slots=True, eq=False)
class TrackerState:
    """All that must survive a restart, besides the keyframes."""

    T_local_lidar: Array
    T_local_keyframe: Array
    stamp_ns: int
    frames: int
    delta_velocity_mps: Array
    bad_frames: int


class Tracker:
    """Predicts, registers, decides on keyframes and feeds the local map."""

    def __init__(self, settings: TrackerSettings, redeskew: bool) -> None:
        self.settings = settings
        self.redeskew = redeskew
        self.local_map = LocalMap(settings.local_map)
        self.registration = Registration(settings.registration)
        self.state: TrackerState | None = None
        self._first: FeatureFrame | None = None

    def process(self, frame: FeatureFrame) -> Track:
        """Tracks one frame; the caller inserts the keyframe into the local map (`insert`)."""
        if self.state is None:
            return self._begin(frame)
        state = self.state
        result = self._align(frame, state)
        first_again = None
        if state.frames == 1 and not frame.motion.velocity_known and self.redeskew:
            result, first_again = self._bootstrap(frame, state, result)
        self._first = None
        return replace(self._accept(frame, state, result), first_again=first_again)

    def _begin(self, frame: FeatureFrame) -> Track:
        T = se3.compose(se3.level_rotation(-frame.motion.gravity_lidar), np.zeros(3))
        self.state = TrackerState(T, T, frame.stamp_ns, 1, np.zeros(3), 0)
        self._first = frame
        return Track(T, None, State.INITIALISING, True, frame.corners.points_lidar, frame.surfs.points_lidar)

    def _align(self, frame: FeatureFrame, state: TrackerState) -> RegistrationResult:
        motion = frame.motion
        interval_s = max((frame.stamp_ns - state.stamp_ns) * 1e-9, 1e-3)
        # while the edge does not know its velocity, the error of one scan is the error of the next
        base = np.zeros(3) if motion.velocity_known or not self.redeskew else state.delta_velocity_mps
        T_prev_lidar = motion.T_prev_lidar.copy()
        T_prev_lidar[:3, 3] += base * interval_s
        velocity_sigma = float(np.sqrt(motion.covariance[3, 3])) / interval_s
        if base.any():
            velocity_sigma = min(velocity_sigma, self.settings.start_acceleration_mps2 * 2 * interval_s)
        covariance = motion.covariance.copy()
        covariance[3:, 3:] = np.eye(3) * (velocity_sigma * interval_s) ** 2
        covariance += np.diag(np.repeat([self.settings.pose_rotation_rad**2, self.settings.pose_translation_m**2], 3))
        prediction = Prediction(
            state.T_local_lidar @ T_prev_lidar, np.linalg.inv(covariance), interval_s, velocity_sigma
        )
        result = self.registration.align(
            self.local_map,
            _shifted(frame.corners, base),
            _shifted(frame.surfs, base),
            (frame.corners.t_offset_ns * 1e-9, frame.surfs.t_offset_ns * 1e-9),
            prediction,
            self.redeskew,
        )
        return replace(result, delta_velocity_mps=result.delta_velocity_mps + base)

    def _bootstrap(self, frame: FeatureFrame, state: TrackerState, result: RegistrationResult):
        """A robot that starts moving: the first scan was taken with the velocity that the second one reveals."""
        first = self._first
        if first is None:  # restored from the store between the two scans
            return result, None
        points = first.corners.points_lidar, first.surfs.points_lidar
        for _ in range(self.settings.bootstrap_iterations):
            dv = result.delta_velocity_mps
            points = _shifted(first.corners, dv), _shifted(first.surfs, dv)
            self.local_map.clear()
            self.insert(0, state.T_local_keyframe, *points)
            state.delta_velocity_mps = dv
            result = self._align(frame, state)
            if np.linalg.norm(result.delta_velocity_mps - dv) < 0.02:
                break
        return result, points

    def _accept(self, frame: FeatureFrame, state: TrackerState, result: RegistrationResult) -> Track:
        s = self.settings
        share = result.inliers / max(result.features, 1)
        good = result.inliers >= s.min_inliers and share >= s.min_inlier_share
        T = result.T_local_lidar
        if not good:  # nothing to hold on to: the edge's motion carries the pose
            T = state.T_local_lidar @ frame.motion.T_prev_lidar
        bad_frames = 0 if good else state.bad_frames + 1
        moved = se3.inv(state.T_local_keyframe) @ T
        new_ground = np.linalg.norm(moved[:3, 3]) > s.keyframe_m or se3.angle(moved) > s.keyframe_rad
        keyframe = bool(frame.dense and good and new_ground)
        if bad_frames > s.lost_frames:
            status = State.LOST
        elif not good or len(result.degenerate_axes):
            status = State.DEGENERATE
        elif not frame.motion.velocity_known:
            status = State.INITIALISING
        else:
            status = State.TRACKING
        dv = result.delta_velocity_mps if good else np.zeros(3)
        self.state = TrackerState(
            T, T if keyframe else state.T_local_keyframe, frame.stamp_ns, state.frames + 1, dv, bad_frames
        )
        dv = dv if self.redeskew else np.zeros(3)
        return Track(T, result, status, keyframe, _shifted(frame.corners, dv), _shifted(frame.surfs, dv))

    def insert(
        self, index: int, T_local_lidar: Array, corners_lidar: NDArray[np.float32], surfs_lidar: NDArray[np.float32]
    ) -> None:
        """Adds keyframe `index` to the local map."""
        self.local_map.insert(index, T_local_lidar, corners_lidar, surfs_lidar)

    def move(self, T_new_local: Array) -> None:
        """`local` is renamed: everything the tracker holds moves along."""
        if self.state is not None:
            T = se3.orthonormalised(T_new_local @ self.state.T_local_lidar)
            self.state = replace(
                self.state, T_local_lidar=T, T_local_keyframe=T_new_local @ self.state.T_local_keyframe
            )


def _shifted(features: FeatureSet, delta_velocity_mps: Array) -> NDArray[np.float32]:
    """Deskewed again for another velocity: p' = p + dv * t, first order, exact for a velocity error."""
    if not delta_velocity_mps.any():
        return features.points_lidar
    shift = (features.t_offset_ns * 1e-9)[:, None] * delta_velocity_mps
    return (features.points_lidar + shift).astype(np.float32)
