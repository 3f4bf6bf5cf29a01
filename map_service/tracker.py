"""Scan-to-map tracking of one session, in the frame `local` of its local map.

`local` is continuous: graph corrections never move the tracker, they move `map` against `local` (see pipeline.py),
until a rebuild of the local map takes the corrected keyframes over.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from map_service.carried import Carried, CarriedScans, Later
from map_service.doubt import Doubt, Verdict
from map_service.scan_alignment import ScanAlignment, deskewed_again
from map_service.settings import TrackerSettings
from map_service.tracker_state import TrackerState
from map_service.types import State
from map_service.wide_search import Fit, Place, WideSearch
from splitslam import se3
from splitslam.features import FeatureFrame
from splitslam.registration.align import Registration, RegistrationResult
from splitslam.registration.local_map import LocalMap

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """The tracker's answer: T_local_lidar (4, 4), how the registration went (None for the first frame).

    T_found_carried (4, 4): by which `local` jumped for the robot when it was found after having been lost.
    placed: the scans that were carried until then, where they belong.
    """

    T_local_lidar: Array
    registration: RegistrationResult | None
    state: State
    keyframe: bool  # it has moved far enough to be one
    corners_lidar: NDArray[np.float32]
    surfs_lidar: NDArray[np.float32]
    first_again: tuple[NDArray[np.float32], NDArray[np.float32]] | None = None  # keyframe 0, deskewed again
    T_found_carried: Array | None = None
    placed: tuple[Carried, ...] = ()


class Tracker:
    """Predicts, registers, decides on keyframes and feeds the local map."""

    def __init__(self, settings: TrackerSettings, redeskew: bool) -> None:
        self.settings = settings
        self.redeskew = redeskew
        self.local_map = LocalMap(settings.local_map)
        self.registration = Registration(settings.registration)
        self._alignment = ScanAlignment(settings, self.registration, self.local_map, redeskew)
        self.search = WideSearch(settings.search, self.registration)
        self.doubt = Doubt(settings.doubt)
        self.carried = CarriedScans()
        self.state: TrackerState | None = None
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
        result = self._alignment.forward(frame, state)
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
        return track if first_again is None else replace(track, first_again=first_again)

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

    def _bootstrap(self, frame: FeatureFrame, state: TrackerState, result: RegistrationResult):
        """A robot that starts moving: the first scan was taken with the velocity that the second one reveals."""
        first = self._first
        if first is None:  # restored from the store between the two scans
            return result, None
        points = first.corners.points_lidar, first.surfs.points_lidar
        for _ in range(self.settings.bootstrap_iterations):
            delta = result.delta_twist
            points = deskewed_again(first.corners, delta), deskewed_again(first.surfs, delta)
            self.local_map.clear()
            self.insert(0, state.T_local_keyframe, *points)
            state.base_twist = delta
            result = self._alignment.forward(frame, state)
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
        self.doubt.consider(places, self.search.at(self.local_map, frame, result.T_local_lidar))
        return self._carry(frame, state, result)

    def _look_around(self, frame: FeatureFrame, before: TrackerState, state: TrackerState) -> Track:
        """Lost: follows the places where the robot may be, and looks for more; `state` is `before` across a hole."""
        doubt = self.doubt
        T_carried = state.T_local_lidar @ frame.motion.T_prev_lidar
        moved = se3.inv(before.T_local_lidar) @ state.T_local_lidar
        there = [replace(state, T_local_lidar=h.T_local_lidar @ moved) for h in doubt.state.hypotheses]
        results = [self._alignment.forward(frame, at) for at in there]
        found = doubt.confirm([Place(r.T_local_lidar, Fit.of(r)) for r in results])
        if found is not None:
            doubt.found()
            track = self._accept(frame, replace(there[found], bad_frames=0), results[found])
            placed = self._place_carried(frame, T_carried)
            return replace(track, T_found_carried=track.T_local_lidar @ se3.inv(T_carried), placed=placed)
        if (centre := doubt.next_centre(T_carried)) is not None:
            doubt.consider(self.search.places(self.local_map, frame, centre))
        return self._carry(frame, state, results[0] if results else self._alignment.forward(frame, state))

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
        """The pose of a scan by the one after it; None where the map denies it."""
        result = self._alignment.backward(frame, later)
        return result.T_local_lidar if not result.features or self.doubt.fits(Fit.of(result)) else None

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
        twist, spread = se3.log(se3.inv(state.T_local_lidar) @ T) / interval_s, state.twist_spread
        if state.frames > 1:
            spread = spread + s.twist_spread_gain * ((twist - state.twist) ** 2 - spread)
        result = self._alignment.deskew_doubted(frame, state, result, spread)
        self.state = TrackerState(
            T,
            T if keyframe else state.T_local_keyframe,
            frame.stamp_ns,
            state.frames + 1,
            twist,
            np.zeros(6),
            bad_frames,
            frame.seq,
            twist_spread=spread,
        )
        # only a keyframe's points are asked for again
        delta = result.delta_twist if keyframe and self.redeskew else np.zeros(6)
        return Track(
            T, result, status, keyframe, deskewed_again(frame.corners, delta), deskewed_again(frame.surfs, delta)
        )

    def insert(
        self, index: int, T_local_lidar: Array, corners_lidar: NDArray[np.float32], surfs_lidar: NDArray[np.float32]
    ) -> None:
        """Adds keyframe `index` to the local map; T_local_lidar (4, 4), features (N, 3)."""
        self.local_map.insert(index, T_local_lidar, corners_lidar, surfs_lidar)

    def refer(self, T_local_keyframe: Array) -> None:
        """The keyframe (4, 4) from which on new ground is measured, where that is not the scan at hand."""
        assert self.state is not None
        self.state = replace(self.state, T_local_keyframe=T_local_keyframe)

    def move(self, T_new_local: Array) -> None:
        """`local` is renamed, by T_new_local (4, 4): everything the tracker holds moves along."""
        self.doubt.move(T_new_local)
        self.carried.move(T_new_local)
        if self.state is not None:
            T = se3.orthonormalised(T_new_local @ self.state.T_local_lidar)
            self.state = replace(
                self.state, T_local_lidar=T, T_local_keyframe=T_new_local @ self.state.T_local_keyframe
            )
