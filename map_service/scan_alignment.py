"""A scan against the local map: where it should be by the motion, and where it is by its points.

The edge's motion is the start and a measurement; where the edge does not know its velocity yet, the server's own last
one takes its place, and the points are deskewed again by it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from map_service.carried import Later
from map_service.settings import TrackerSettings
from map_service.tracker_state import TrackerState
from splitslam import se3
from splitslam.features import FeatureFrame, FeatureSet
from splitslam.registration.align import Prediction, Registration, RegistrationResult, deskew_again
from splitslam.registration.local_map import LocalMap

Array = NDArray[np.float64]
NO_IMU_SIGMA_RAD = 0.4  # an edge without an IMU says it does not know where down is


class ScanAlignment:
    """Predicts and registers."""

    def __init__(
        self, settings: TrackerSettings, registration: Registration, local_map: LocalMap, redeskew: bool
    ) -> None:
        self._registration, self._local_map = registration, local_map
        self._redeskew = redeskew
        self._floors = np.repeat([settings.pose_rotation_rad, settings.pose_translation_m], 3)
        self._start_accelerations = np.repeat([settings.start_rotation_radps2, settings.start_acceleration_mps2], 3)

    def forward(self, frame: FeatureFrame, state: TrackerState) -> RegistrationResult:
        """The scan after `state`, from the edge's motion."""
        motion = frame.motion
        interval_s = max((frame.stamp_ns - state.stamp_ns) * 1e-9, 1e-3)
        sigmas = np.sqrt(np.maximum(np.diag(motion.covariance), 1e-12)) / interval_s
        base = self._base_twist(frame, state, interval_s)
        T_prev_lidar, floors = motion.T_prev_lidar, self._floors
        if base.any():  # what remains is how the twist changes from one scan to the next
            sigmas = np.minimum(sigmas, self._start_accelerations * interval_s)
            T_prev_lidar = T_prev_lidar @ se3.exp(base * interval_s)
        if state.hole_s:
            floors = floors + 0.5 * state.hole_s**2 * self._start_accelerations
        information = np.diag(1.0 / ((sigmas * interval_s + state.carried_sigma) ** 2 + floors**2))
        prediction = Prediction(
            state.T_local_lidar @ T_prev_lidar, information, interval_s, float(sigmas[:3].max()), sigmas[3:]
        )
        # after a hole the prediction's error says nothing about this scan
        again = self._redeskew and not state.hole_s and not state.carried_sigma.any()
        return self._register(frame, prediction, base, again)

    def _register(self, frame: FeatureFrame, prediction: Prediction, base: Array, again: bool) -> RegistrationResult:
        """base (6,): what the scan is deskewed by before, on top of the edge's twist; again: and while it converges."""
        result = self._registration.align(
            self._local_map,
            deskewed_again(frame.corners, base),
            deskewed_again(frame.surfs, base),
            (_seconds(frame.corners), _seconds(frame.surfs)),
            prediction,
            again,
        )
        return replace(result, delta_twist=result.delta_twist + base) if base.any() else result

    def _base_twist(self, frame: FeatureFrame, state: TrackerState, interval_s: float) -> Array:
        """What to add to the edge's twist before registering: nothing, unless the server knows better.

        It does while the edge has no velocity yet, and always when there is no IMU: the edge's twist is then two
        scans old, the server's one.
        """
        if not self._knows_better(frame, state):
            return state.base_twist
        base = state.twist - se3.log(frame.motion.T_prev_lidar) / interval_s
        if _inertial(frame):
            base[:3] = 0.0
        return base

    def _knows_better(self, frame: FeatureFrame, state: TrackerState) -> bool:
        known = _inertial(frame) and frame.motion.velocity_known
        return self._redeskew and state.frames >= 2 and not known

    def deskew_doubted(
        self, frame: FeatureFrame, state: TrackerState, result: RegistrationResult, twist_spread: Array
    ) -> RegistrationResult:
        """The result, of a scan after `state`, with what its deskew may have put the pose off by.

        The server's twist is that of the way to the scan, not of the scan itself: it is off by what a twist changes
        from one to the next, twist_spread (6,), squared. A point is then off by that for its time, in the mean alike.
        """
        if not self._knows_better(frame, state) or not result.features:
            return result
        times_s = np.concatenate([_seconds(frame.corners), _seconds(frame.surfs)])
        variances = twist_spread * float(times_s.mean()) ** 2
        if _inertial(frame):
            variances[:3] = 0.0
        return replace(result, covariance=result.covariance + np.diag(variances))

    def backward(self, frame: FeatureFrame, later: Later) -> RegistrationResult:
        """The scan before one that is placed, from that one's motion backwards in time."""
        assert later.frame is not None
        interval_s = max((later.stamp_ns - frame.stamp_ns) * 1e-9, 1e-3)
        after, motion = later.frame.motion, frame.motion
        T_this_later, base = after.T_prev_lidar, np.zeros(6)
        sigmas = np.sqrt(np.maximum(np.diag(after.covariance), 1e-12)) / interval_s
        if not after.velocity_known:  # the way is the server's to know; the turn the IMU's, if there is one
            T_this_later = se3.exp(later.twist * interval_s)
            if after.gravity_sigma_rad < NO_IMU_SIGMA_RAD:
                T_this_later[:3, :3] = after.T_prev_lidar[:3, :3]
            sigmas = np.minimum(sigmas, self._start_accelerations * interval_s)
        if self._redeskew and not motion.velocity_known:
            base[3:] = later.twist[3:] - motion.velocity_lidar_mps
        T = later.T_local_lidar @ se3.inv(T_this_later)
        if not (len(frame.corners) or len(frame.surfs)):
            return RegistrationResult.without_features(T, after.covariance)
        information = np.diag(1.0 / ((sigmas * interval_s) ** 2 + self._floors**2))
        prediction = Prediction(T, information, interval_s, float(sigmas[:3].max()), sigmas[3:])
        return self._register(frame, prediction, base, self._redeskew)


def _inertial(frame: FeatureFrame) -> bool:
    return frame.motion.gravity_sigma_rad < NO_IMU_SIGMA_RAD


def deskewed_again(features: FeatureSet, delta_twist: Array) -> NDArray[np.float32]:
    """The points (N, 3), deskewed again for another twist."""
    if not delta_twist.any():
        return features.points_lidar
    return deskew_again(features.points_lidar, _seconds(features), delta_twist)


def _seconds(features: FeatureSet) -> Array:
    return np.multiply(features.t_offset_ns, 1e-9, dtype=np.float64)
