"""Scan-to-map tracking of one session, in the frame `local` of its local map.

`local` is continuous: graph corrections never move the tracker, they move `map` against `local` (see pipeline.py),
until a rebuild of the local map takes the corrected keyframes over.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from map_service.carried import Carried, CarriedScans, Later
from map_service.doubt import Doubt, Verdict
from map_service.settings import TrackerSettings
from map_service.types import State
from map_service.wide_search import Fit, Place, WideSearch
from splitslam import se3
from splitslam.features import FeatureFrame, FeatureSet
from splitslam.registration.align import Prediction, Registration, RegistrationResult, deskew_again
from splitslam.registration.local_map import LocalMap

Array = NDArray[np.float64]
NO_IMU_SIGMA_RAD = 0.4  # an edge without an IMU says it does not know where down is


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """The tracker's answer: T_local_lidar (4, 4), how the registration went (None for the first frame).

    T_found_carried (4, 4): by which `local` jumped for the robot when it was found after having been lost.
    placed: the scans that were carried until then, where they belong.
    """

    T_local_lidar: Array
    registration: RegistrationResult | None
    state: State
    keyframe: bool
    corners_lidar: NDArray[np.float32]
    surfs_lidar: NDArray[np.float32]
    first_again: tuple[NDArray[np.float32], NDArray[np.float32]] | None = None  # keyframe 0, deskewed again
    T_found_carried: Array | None = None
    placed: tuple[Carried, ...] = ()


@dataclass(slots=True, eq=False)
class TrackerState:
    """All that must survive a restart, besides the keyframes."""

    T_local_lidar: Array
    T_local_keyframe: Array
    stamp_ns: int
    frames: int
    twist: Array  # of the newest motion, rad/s and m/s, frame `lidar`
    base_twist: Array  # zero, but while the first two scans are put together
    bad_frames: int
    seq: int
    hole_s: float = 0.0  # time bridged by the last twist instead of measured motion
    carried_sigma: Array = field(default_factory=lambda: np.zeros(6))  # of the motion since the last frame with points


class Tracker:
    """Predicts, registers, decides on keyframes and feeds the local map."""

    def __init__(self, settings: TrackerSettings, redeskew: bool) -> None:
        self.settings = settings
        self.redeskew = redeskew
        self.local_map = LocalMap(settings.local_map)
        self.registration = Registration(settings.registration)
        self.search = WideSearch(settings.search, self.registration)
        self.doubt = Doubt(settings.doubt)
        self.carried = CarriedScans()
        self.state: TrackerState | None = None
        self._start_accelerations = np.repeat([settings.start_rotation_radps2, settings.start_acceleration_mps2], 3)
        self._first: FeatureFrame | None = None

    def process(self, frame: FeatureFrame) -> Track:
        """Tracks one frame; the caller inserts the keyframe into the local map (`insert`)."""
        if self.state is None:
            return self._begin(frame)
        state = self._across_a_hole(frame, self.state)
        if not (frame.dense or len(frame.corners) or len(frame.surfs)):
            return self._follow(frame, state)
        if self.doubt.state.lost:
            return self._look_around(frame, self.state, state)
        result = self._align(frame, state)
        first_again = None
        if state.frames == 1 and not frame.motion.velocity_known and self.redeskew:
            result, first_again = self._bootstrap(frame, state, result)
        self._first = None
        verdict = self.doubt.weigh(Fit.of(result))
        if self._unseen(frame) and state.frames > 1 and self.doubt.can_tell(Fit.of(result)):
            return self._appear(frame, state, result)
        if verdict != Verdict.TRUSTED and self._is_elsewhere(frame, state, result):
            return self._carry(frame, state, result)
        if verdict == Verdict.REFUSED:
            return self._carry(frame, state, result)
        self.carried.clear()
        track = self._accept(frame, state, result, trusted=verdict != Verdict.DOUBTED)
        return replace(track, first_again=first_again)

    def _begin(self, frame: FeatureFrame) -> Track:
        T = se3.compose(se3.level_rotation(-frame.motion.gravity_lidar), np.zeros(3))
        self.state = TrackerState(T, T, frame.stamp_ns, 1, np.zeros(6), np.zeros(6), 0, frame.seq)
        self._first = frame
        return Track(T, None, State.INITIALISING, True, frame.corners.points_lidar, frame.surfs.points_lidar)

    def _across_a_hole(self, frame: FeatureFrame, state: TrackerState) -> TrackerState:
        """The state carried on over frames that were rejected: the next frame's motion starts where they were."""
        missing = frame.seq - state.seq - 1
        if missing <= 0:
            return state
        gap_ns = (frame.stamp_ns - state.stamp_ns) * missing // (missing + 1)
        T = state.T_local_lidar @ se3.exp(state.twist * gap_ns * 1e-9)
        return replace(state, T_local_lidar=T, stamp_ns=state.stamp_ns + gap_ns, hole_s=gap_ns * 1e-9)

    def _follow(self, frame: FeatureFrame, state: TrackerState) -> Track:
        """A frame without points: the edge's motion carries the pose, and the next registration knows how far.

        The sigmas add up: what is wrong is mostly the velocity, the same way all the time.
        """
        motion = frame.motion
        T = state.T_local_lidar @ motion.T_prev_lidar
        sigma = state.carried_sigma + np.sqrt(np.diagonal(motion.covariance))
        lost = self.doubt.state.lost
        covariance = self.doubt.carry(motion.T_prev_lidar, motion.covariance) if lost else np.diag(sigma**2)
        interval_s = max((frame.stamp_ns - state.stamp_ns) * 1e-9, 1e-3)
        self.state = replace(
            state,
            T_local_lidar=T,
            stamp_ns=frame.stamp_ns,
            frames=state.frames + 1,
            twist=se3.log(motion.T_prev_lidar) / interval_s,
            seq=frame.seq,
            hole_s=0.0,
            carried_sigma=sigma,
        )
        if lost:
            self.carried.add(frame, T)
        result = RegistrationResult.without_features(T, covariance)
        status = State.TRACKING if motion.velocity_known else State.INITIALISING
        if lost or sigma[3:].max() > self.settings.carried_m:
            status = State.LOST if lost else State.DEGENERATE
        return Track(T, result, status, False, frame.corners.points_lidar, frame.surfs.points_lidar)

    def _align(self, frame: FeatureFrame, state: TrackerState) -> RegistrationResult:
        motion, s = frame.motion, self.settings
        interval_s = max((frame.stamp_ns - state.stamp_ns) * 1e-9, 1e-3)
        sigmas = np.sqrt(np.maximum(np.diag(motion.covariance), 1e-12)) / interval_s
        base = self._base_twist(frame, state, interval_s)
        if base.any():  # what remains is how the twist changes from one scan to the next
            sigmas = np.minimum(sigmas, self._start_accelerations * interval_s)
        T_prev_lidar = motion.T_prev_lidar @ se3.exp(base * interval_s)
        floors = np.repeat([s.pose_rotation_rad, s.pose_translation_m], 3)
        floors = floors + 0.5 * state.hole_s**2 * self._start_accelerations
        information = np.diag(1.0 / ((sigmas * interval_s + state.carried_sigma) ** 2 + floors**2))
        prediction = Prediction(
            state.T_local_lidar @ T_prev_lidar, information, interval_s, float(sigmas[:3].max()), sigmas[3:]
        )
        # after a hole the prediction's error says nothing about this scan
        again = self.redeskew and not state.hole_s and not state.carried_sigma.any()
        return self._register(frame, prediction, base, again)

    def _register(self, frame: FeatureFrame, prediction: Prediction, base: Array, again: bool) -> RegistrationResult:
        """base (6,): what the scan is deskewed by before, on top of the edge's twist; again: and while it converges."""
        result = self.registration.align(
            self.local_map,
            _again(frame.corners, base),
            _again(frame.surfs, base),
            (_seconds(frame.corners), _seconds(frame.surfs)),
            prediction,
            again,
        )
        return replace(result, delta_twist=result.delta_twist + base)

    def _base_twist(self, frame: FeatureFrame, state: TrackerState, interval_s: float) -> Array:
        """What to add to the edge's twist before registering: nothing, unless the server knows better.

        It does while the edge has no velocity yet, and always when there is no IMU: the edge's twist is then two
        scans old, the server's one.
        """
        inertial = frame.motion.gravity_sigma_rad < NO_IMU_SIGMA_RAD
        if not self.redeskew or state.frames < 2 or (inertial and frame.motion.velocity_known):
            return state.base_twist
        base = state.twist - se3.log(frame.motion.T_prev_lidar) / interval_s
        if inertial:
            base[:3] = 0.0
        return base

    def _bootstrap(self, frame: FeatureFrame, state: TrackerState, result: RegistrationResult):
        """A robot that starts moving: the first scan was taken with the velocity that the second one reveals."""
        first = self._first
        if first is None:  # restored from the store between the two scans
            return result, None
        points = first.corners.points_lidar, first.surfs.points_lidar
        for _ in range(self.settings.bootstrap_iterations):
            delta = result.delta_twist
            points = _again(first.corners, delta), _again(first.surfs, delta)
            self.local_map.clear()
            self.insert(0, state.T_local_keyframe, *points)
            state.base_twist = delta
            result = self._align(frame, state)
            if np.linalg.norm((result.delta_twist - delta) * self.settings.registration.scale) < 0.02:
                break
        return result, points

    def _unseen(self, frame: FeatureFrame) -> bool:
        """Did nobody measure how the robot came to this scan?"""
        return bool(frame.motion.covariance[3:, 3:].diagonal().max() > self.settings.unseen_m**2)

    # --- doubt ------------------------------------------------------------------------------------------------

    def _is_elsewhere(self, frame: FeatureFrame, state: TrackerState, result: RegistrationResult) -> bool:
        """A doubted scan is looked for around its place; if it belongs elsewhere, the robot is lost, or found there."""
        places = self.search.places(self.local_map, frame, state.T_local_lidar @ frame.motion.T_prev_lidar)
        here = self.search.at(self.local_map, frame, result.T_local_lidar)
        if not self.doubt.is_elsewhere(here, places):
            return False
        self.doubt.lose(state.T_local_lidar)
        self.doubt.consider(places)
        return True

    def _appear(self, frame: FeatureFrame, state: TrackerState, result: RegistrationResult) -> Track:
        """Nobody saw how the robot came here: however well the scan fits at once, the next ones have to agree."""
        places = self.search.places(self.local_map, frame, result.T_local_lidar)
        self.doubt.lose(state.T_local_lidar)
        self.doubt.consider([self.search.at(self.local_map, frame, result.T_local_lidar), *places])
        return self._carry(frame, state, result)

    def _look_around(self, frame: FeatureFrame, before: TrackerState, state: TrackerState) -> Track:
        """Lost: follows the places where the robot may be, and looks for more; `state` is `before` across a hole."""
        doubt = self.doubt
        T_carried = state.T_local_lidar @ frame.motion.T_prev_lidar
        moved = se3.inv(before.T_local_lidar) @ state.T_local_lidar
        there = [replace(state, T_local_lidar=h.T_local_lidar @ moved) for h in doubt.state.hypotheses]
        results = [self._align(frame, at) for at in there]
        found = doubt.confirm([Place(r.T_local_lidar, Fit.of(r)) for r in results])
        if found is not None:
            doubt.found()
            track = self._accept(frame, replace(there[found], bad_frames=0), results[found])
            placed = self._place_carried(frame, T_carried)
            return replace(track, T_found_carried=track.T_local_lidar @ se3.inv(T_carried), placed=placed)
        if (centre := doubt.next_centre(T_carried)) is not None:
            doubt.consider(self.search.places(self.local_map, frame, centre))
        return self._carry(frame, state, results[0] if results else self._align(frame, state))

    def _carry(self, frame: FeatureFrame, state: TrackerState, result: RegistrationResult) -> Track:
        """The edge's motion carries a pose that is not believed: no keyframe, no axis observed, metres of doubt."""
        doubt, motion = self.doubt, frame.motion
        T = state.T_local_lidar @ motion.T_prev_lidar
        covariance = doubt.carry(motion.T_prev_lidar, motion.covariance)
        if self._unseen(frame):  # how those before it were carried has nothing to do with it
            self.carried.clear()
        self.carried.add(frame, T)
        result = replace(result, T_local_lidar=T, covariance=covariance, degenerate_axes=np.eye(6))
        status = State.DEGENERATE
        if doubt.state.lost:
            status = State.LOCALISING if any(h.confirmed > 0 for h in doubt.state.hypotheses) else State.LOST
        interval_s = max((frame.stamp_ns - state.stamp_ns) * 1e-9, 1e-3)
        self.state = replace(
            state,
            T_local_lidar=T,
            stamp_ns=frame.stamp_ns,
            frames=state.frames + 1,
            twist=se3.log(motion.T_prev_lidar) / interval_s,
            base_twist=np.zeros(6),
            seq=frame.seq,
            hole_s=0.0,
            carried_sigma=np.zeros(6),
        )
        return Track(T, result, status, False, frame.corners.points_lidar, frame.surfs.points_lidar)

    def _place_carried(self, found: FeatureFrame, T_carried: Array) -> tuple[Carried, ...]:
        """The scans before `found`, which has just been accepted and had been carried to T_carried (4, 4)."""
        assert self.state is not None
        newest = Later(found, self.state.stamp_ns, self.state.T_local_lidar, self.state.twist)
        placed = tuple(self.carried.placed(newest, T_carried, self._place_before))
        self.carried.clear()
        return placed

    def _place_before(self, frame: FeatureFrame, later: Later) -> Array | None:
        """`_align` backwards in time: the pose of a scan by the one after it, None where the map denies it."""
        assert later.frame is not None
        interval_s = max((later.stamp_ns - frame.stamp_ns) * 1e-9, 1e-3)
        after, motion, s = later.frame.motion, frame.motion, self.settings
        T_this_later, base = after.T_prev_lidar, np.zeros(6)
        sigmas = np.sqrt(np.maximum(np.diag(after.covariance), 1e-12)) / interval_s
        if not after.velocity_known:  # the way is the server's to know; the turn the IMU's, if there is one
            T_this_later = se3.exp(later.twist * interval_s)
            if after.gravity_sigma_rad < NO_IMU_SIGMA_RAD:
                T_this_later[:3, :3] = after.T_prev_lidar[:3, :3]
            sigmas = np.minimum(sigmas, self._start_accelerations * interval_s)
        if self.redeskew and not motion.velocity_known:
            base[3:] = later.twist[3:] - motion.velocity_lidar_mps
        T = later.T_local_lidar @ se3.inv(T_this_later)
        if not (len(frame.corners) or len(frame.surfs)):
            return T
        floors = np.repeat([s.pose_rotation_rad, s.pose_translation_m], 3)
        information = np.diag(1.0 / ((sigmas * interval_s) ** 2 + floors**2))
        prediction = Prediction(T, information, interval_s, float(sigmas[:3].max()), sigmas[3:])
        result = self._register(frame, prediction, base, self.redeskew)
        return result.T_local_lidar if self.doubt.fits(Fit.of(result)) else T

    # --- outcome ----------------------------------------------------------------------------------------------

    def _accept(
        self, frame: FeatureFrame, state: TrackerState, result: RegistrationResult, trusted: bool = True
    ) -> Track:
        s = self.settings
        share = result.inliers / max(result.features, 1)
        good = result.inliers >= s.min_inliers and share >= s.min_inlier_share
        T = result.T_local_lidar
        if not good:  # nothing to hold on to: the edge's motion carries the pose
            T = state.T_local_lidar @ frame.motion.T_prev_lidar
            result = replace(result, T_local_lidar=T, degenerate_axes=np.eye(6))
        bad_frames = 0 if good else state.bad_frames + 1
        moved = se3.inv(state.T_local_keyframe) @ T
        new_ground = np.linalg.norm(moved[:3, 3]) > s.keyframe_m or se3.angle(moved) > s.keyframe_rad
        keyframe = bool(frame.dense and good and trusted and new_ground)
        if bad_frames > s.lost_frames:
            self.doubt.lose(T)
            status = State.LOST
        elif not good or len(result.degenerate_axes):
            status = State.DEGENERATE
        elif not frame.motion.velocity_known:
            status = State.INITIALISING
        else:
            status = State.TRACKING
        interval_s = max((frame.stamp_ns - state.stamp_ns) * 1e-9, 1e-3)
        twist = se3.log(se3.inv(state.T_local_lidar) @ T) / interval_s
        self.state = TrackerState(
            T,
            T if keyframe else state.T_local_keyframe,
            frame.stamp_ns,
            state.frames + 1,
            twist,
            np.zeros(6),
            bad_frames,
            frame.seq,
        )
        delta = result.delta_twist if good and self.redeskew else np.zeros(6)
        return Track(T, result, status, keyframe, _again(frame.corners, delta), _again(frame.surfs, delta))

    def insert(
        self, index: int, T_local_lidar: Array, corners_lidar: NDArray[np.float32], surfs_lidar: NDArray[np.float32]
    ) -> None:
        """Adds keyframe `index` to the local map."""
        self.local_map.insert(index, T_local_lidar, corners_lidar, surfs_lidar)

    def move(self, T_new_local: Array) -> None:
        """`local` is renamed: everything the tracker holds moves along."""
        self.doubt.move(T_new_local)
        self.carried.move(T_new_local)
        if self.state is not None:
            T = se3.orthonormalised(T_new_local @ self.state.T_local_lidar)
            self.state = replace(
                self.state, T_local_lidar=T, T_local_keyframe=T_new_local @ self.state.T_local_keyframe
            )


def _again(features: FeatureSet, delta_twist: Array) -> NDArray[np.float32]:
    """The points (N, 3), deskewed again for another twist."""
    if not delta_twist.any():
        return features.points_lidar
    points = features.points_lidar.astype(np.float64)
    return deskew_again(points, _seconds(features), delta_twist).astype(np.float32)


def _seconds(features: FeatureSet) -> Array:
    return np.multiply(features.t_offset_ns, 1e-9, dtype=np.float64)
