"""The paper's Map node, one instance = one session, single writer, no threads, no RPC.

frame -> registration against the local map (eq. 3) -> answer -> keyframe -> factor graph: LiDAR odometry, GNSS, loop
closures -> corrected keyframes, which the next answer tells. Two frames make corrections harmless to what runs: the
tracker lives in `local`, and T_map_local takes every correction, until the map has bent too much and the local map is
built again.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from map_service import persistence
from map_service.chronicle import Chronicle
from map_service.closing import LoopCloser
from map_service.clouds import Fetch
from map_service.fixes import FixPlacer, Passage
from map_service.gnss import GnssGate
from map_service.graph import PoseGraph
from map_service.ground import MappedGround
from map_service.keyframes import Keyframes
from map_service.levelling import Leveller
from map_service.loop_gate import Chain
from map_service.loops import LoopVerifier
from map_service.map_frame import MapFrame
from map_service.pipeline_statistics import Moment, PipelineStatistics, effort, outcomes, report
from map_service.seen import MapSeen, ScanSeen, map_seen, scan_seen
from map_service.settings import PipelineSettings
from map_service.surroundings import Surroundings
from map_service.tracker import Track, Tracker
from map_service.types import Cause, Commit, CorrectionRecord, FrameRecord, MapAnswer, Snapshot
from map_service.uncertainty import Uncertainty
from map_service.wide_search import Fit
from splitslam import se3
from splitslam.features import FeatureFrame
from splitslam.robot import Robot
from splitslam.scan import GnssFix

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class _Open:
    """A frame that was answered and is not yet in the map. stages: when it began, was registered, was answered."""

    frame: FeatureFrame
    fixes: Sequence[GnssFix]
    passage: Passage
    answer: MapAnswer
    stages: tuple[Moment, Moment, Moment]


class MapPipeline:
    """Everything one session knows. `disable` holds "loops", "gnss", "imu"; `deskew` is the edge's back end."""

    def __init__(
        self,
        robot: Robot,
        settings: PipelineSettings,
        verifier: LoopVerifier,
        disable: frozenset[str] = frozenset(),
        deskew: str = "cpu",
    ) -> None:
        self.robot, self.settings = robot, settings
        self.tracker = Tracker(settings.tracker, redeskew=deskew not in ("off", "rotation"))
        self.graph = PoseGraph(settings.graph)
        self.keyframes = Keyframes()
        self.gnss = None if "gnss" in disable or robot.gnss is None else GnssGate(settings.gnss)
        self._placer: FixPlacer | None = None
        if self.gnss is not None and robot.gnss is not None:
            self._placer = FixPlacer(self.gnss, robot.gnss.t_lidar_antenna_m, settings.gnss.spacing_m)
        self.leveller = Leveller(settings.level)
        self.closer = None if "loops" in disable else LoopCloser(settings.loops, verifier)
        self.uncertainty = Uncertainty(settings, self.graph.drifts)
        self.ground = MappedGround(settings.ground)
        self.surroundings = Surroundings(settings.tracker.local_map)
        self.map_frame = MapFrame(settings, self.surroundings)
        self._correction: CorrectionRecord | None = None  # that the next answer tells
        self._open: _Open | None = None
        self.frames: list[FrameRecord] = []  # since the start or the restart, but for what the store has
        self.mapped = 0
        self.stats = PipelineStatistics()
        self.chronicle = Chronicle(settings.graph)
        self.log = persistence.CommitLog()

    def process(self, frame: FeatureFrame, fixes: Sequence[GnssFix] = ()) -> MapAnswer:
        """Maps one frame; frames come once and in order."""
        answer = self.answer(frame, fixes)
        self.settle()
        return answer

    def answer(self, frame: FeatureFrame, fixes: Sequence[GnssFix] = ()) -> MapAnswer:
        """Where the robot is. What the frame means for the map is left to `settle`, which is due before the next one.

        What that corrects is told with the next answer.
        """
        self.settle()
        started = time.perf_counter(), time.thread_time()
        before = self.tracker.state
        track = self.tracker.process(frame)
        registered = time.perf_counter(), time.thread_time()
        self.chronicle.frame(frame.seq, frame.stamp_ns)
        self.uncertainty.follow(before, track, frame.motion.covariance, self.keyframes.T_local)
        if track.T_found_carried is not None:
            self._correction = self._found(track, track.T_found_carried)
        keyframe = track.keyframe and not self._on_mapped_ground(frame, track)
        passage = Passage(before, track, frame.stamp_ns, self.map_frame.T_map_local, self.map_frame.T_map_odom)
        answer = self._answer(frame, track, keyframe, started, registered)
        stages = started, registered, (time.perf_counter(), time.thread_time())
        self._open = _Open(frame, fixes, passage, answer, stages)
        return answer

    def settle(self) -> float | None:
        """Takes the frame that was answered last into the map; thread CPU time of the graph's part of it, s.

        None: there is nothing to do.
        """
        if self._open is None:
            return None
        done, self._open = self._open, None
        frame, answer, passage, track = done.frame, done.answer, done.passage, done.passage.track
        began = time.perf_counter(), time.thread_time()
        if track.first_again is not None:
            self.keyframes.replace_first(*track.first_again)
            self.log.keyframe(self.keyframes[0], self.graph.poses[0])
            self.fill_local_map()  # with what is kept of its points, so that they can be taken out again
        if answer.keyframe:
            self._add_keyframe(frame, track)
        cause = self._level(frame) if answer.keyframe else None
        cause = self._add_fixes(done.fixes, passage) or cause
        cause = self._apply_loops(frame.seq) or cause
        if cause:
            self._correction = self._correct(cause)
        self.map_frame.go_on(self.tracker, self.keyframes, self.graph.poses)
        state, reference = self.tracker.state, self.ground.reference
        assert state is not None
        T_map_lidar = self.map_frame.T_map_local @ state.T_local_lidar
        self.frames.append(self.log.frame(answer, T_map_lidar, reference, self.graph.poses[reference]))
        self.mapped += 1
        self.surroundings.follow(state.T_local_lidar[:3, 3], self.tracker.local_map, self.keyframes, self._corrected)
        return self.stats.frame(track, *done.stages, began, (time.perf_counter(), time.thread_time()))

    def _corrected(self) -> Array:
        """(n, 4, 4): the keyframes in `local`, where the graph has them."""
        return self.map_frame.poses_local(self.graph.poses)

    # --- graph ------------------------------------------------------------------------------------------------

    def _on_mapped_ground(self, frame: FeatureFrame, track: Track) -> bool:
        """Takes another keyframe as reference where one has seen this ground, and the scan says that it still is so."""
        r, s, doubt = track.registration, self.settings.ground, self.tracker.doubt
        if r is None or not r.features or doubt.state.changed or not doubt.as_usual(Fit.of(r), s.usual_share):
            return False
        covering = self.ground.covering(track.T_local_lidar, frame.stamp_ns, self.keyframes, self._chain())
        if covering is None:
            return False
        self.ground.reference = covering
        self.tracker.refer(self.keyframes.T_local(covering))
        return True

    def _add_keyframe(self, frame: FeatureFrame, track: Track) -> None:
        T_map_lidar = self.map_frame.T_map_local @ track.T_local_lidar
        index, follows = len(self.keyframes), self.ground.reference
        if track.registration is None:
            self.graph.add_first(T_map_lidar, self.leveller.begin(frame.motion, T_map_lidar[:3, :3]))
        else:
            motion = se3.inv(self.keyframes.T_local(follows)) @ track.T_local_lidar
            u, s = self.uncertainty, self.settings
            covariance = u.odometry(track, motion)
            joint = u.since_lost(s.graph)
            self.graph.add_odometry(T_map_lidar, motion, covariance + joint, u.pose(track), follows)
            if self.gnss is not None:
                self.gnss.moved(covariance + u.since_lost(s.tracker.doubt))
        self.uncertainty.found = False
        self.tracker.doubt.learnt()
        self.keyframes.add(frame, track, follows)
        self.ground.reference = index
        added = self.keyframes[index]
        self.tracker.insert(index, track.T_local_lidar, added.cloud.corners_lidar, added.cloud.surfs_lidar)
        self.map_frame.added(index, track.T_local_lidar)
        self.graph.optimise(corrected=False)
        self.chronicle.keyframe(T_map_lidar)
        self.log.keyframe(added, T_map_lidar)
        if self.closer is not None:
            self.closer.look(frame.seq, self.keyframes, self.graph.poses, self.graph.loops)

    def _chain(self) -> Chain:
        return Chain(self.graph.poses, self.keyframes.way_m(), self.graph.loops, self.keyframes.branches)

    def _found(self, track: Track, T_found_carried: Array) -> CorrectionRecord:
        """The robot stands elsewhere than it was carried: `odom` goes on as if nothing were, the jump is `map`'s."""
        self.map_frame.jump(T_found_carried)
        self.uncertainty.found = True
        self._place_again(track)
        moved = se3.inv(track.T_local_lidar) @ T_found_carried @ track.T_local_lidar
        correction = CorrectionRecord.of(Cause.RELOCALISE, moved)
        self.stats.correction(correction)
        self.chronicle.relocalised(self.graph.poses.matrices, correction)
        return correction

    def _place_again(self, track: Track) -> None:
        """The scans that were carried while the robot was lost, as the map has them now; their answers are given."""
        T_keyframe_local = se3.inv(self.graph.poses[self.ground.reference]) @ self.map_frame.T_map_local
        again = {scan.seq: T_keyframe_local @ scan.T_local_lidar for scan in track.placed}
        self.log.place_again(again)
        for i in range(len(self.frames) - 1, -1, -1):
            if (T := again.get(self.frames[i].seq)) is None:
                break
            self.frames[i] = replace(self.frames[i], T_keyframe_lidar=T)

    def _level(self, frame: FeatureFrame) -> Cause | None:
        """A step towards level, when `map` is not; the cause is `registration`, whose tilt has drifted or began so."""
        if not self.leveller.level(frame.motion, len(self.keyframes) - 1, self.graph):
            return None
        self.stats.gravity_factors += 1
        return Cause.REGISTRATION

    def _add_fixes(self, fixes: Sequence[GnssFix], passage: Passage) -> Cause | None:
        if self._placer is None or self.gnss is None:
            return None
        added = self._placer.add(fixes, passage, self.graph, self.ground.reference)
        self.stats.gnss_factors += added
        self.chronicle.data(self.graph, self.gnss)
        return Cause.GNSS if added else None

    def _apply_loops(self, seq: int, everything: bool = False) -> Cause | None:
        if self.closer is None or not self.closer.has_due(seq, everything):
            return None
        admitted = self.closer.due(seq, self._chain(), everything)
        self.chronicle.loops(admitted, self.graph.poses)
        for a in admitted:
            scale = max(1.0, a.correction_m / self.settings.loops.translation_sigma_m)
            self.graph.add_loop(a.loop.older, a.loop.newer, a.loop.T_older_newer, a.loop.covariance, scale)
            self.stats.loops += 1
        return Cause.LOOP if admitted else None

    def _correct(self, cause: Cause) -> CorrectionRecord | None:
        """Optimises with the new factors and moves `map` against `local`; the tracker feels nothing."""
        before = self.graph.poses.matrices.copy()
        self.graph.optimise(corrected=True, far=cause != Cause.GNSS)
        self.chronicle.corrected(before, self.graph.poses.matrices, cause)
        poses, s = self.graph.poses, self.settings.graph
        moved = self.map_frame.correct(self.ground.reference, self.keyframes, poses)
        self.map_frame.renew_if_bent(self.tracker, self.keyframes, poses)
        correction = CorrectionRecord.of(cause, moved)
        if correction.translation_m < s.report_m and correction.rotation_rad < s.report_rad:
            return None
        self.stats.correction(correction)
        return correction

    def fill_local_map(self) -> None:
        """Every keyframe within the radius of the robot. Raises CloudsAwayError."""
        state = self.tracker.state
        assert state is not None
        self.surroundings.fill(state.T_local_lidar[:3, 3], self.tracker.local_map, self.keyframes)

    # --- answers ----------------------------------------------------------------------------------------------

    def _answer(
        self, frame: FeatureFrame, track: Track, keyframe: bool, started: Moment, registered: Moment
    ) -> MapAnswer:
        r, correction = track.registration, self._correction
        T_map_lidar, self._correction = self.map_frame.T_map_local @ track.T_local_lidar, None
        return MapAnswer(
            seq=frame.seq,
            stamp_ns=frame.stamp_ns,
            T_map_lidar=T_map_lidar,
            T_map_odom=self.map_frame.T_map_odom,
            covariance=self.uncertainty.pose(track) + self.graph.turned(T_map_lidar),
            state=track.state,
            degenerate_axes=np.zeros((0, 6)) if r is None else r.degenerate_axes,
            correction=correction,
            keyframe=keyframe,
            registration_ms=(registered[0] - started[0]) * 1e3,
            effort=effort(track, registered[1] - started[1]),
            map_version=self.chronicle.map_version,
        )

    def seen(self, newest_fixes: int) -> tuple[ScanSeen | None, MapSeen]:
        """For those who watch: the scan that waits for `settle`, if there is one, and the map without it."""
        scan = None
        if self._open is not None:
            answer = self._open.answer
            keyframe = len(self.keyframes) if answer.keyframe else self.ground.reference
            scan = scan_seen(self.tracker, self._open.passage.track, keyframe, answer.registration_ms)
        return scan, map_seen(self.graph, newest_fixes)

    def finish(self) -> None:
        """End of the session: loops still under verification are waited for and applied."""
        self.settle()
        if self.graph.poses and (cause := self._apply_loops(0, everything=True)):
            self._correct(cause)
        self.log.exact = True

    def trajectory(self) -> list[tuple[int, int, Array]]:
        """(seq, stamp_ns, T_map_lidar) of the frames that are here and not in the store, by the graph of now."""
        self.settle()
        poses = self.graph.poses
        return [(f.seq, f.stamp_ns, poses[f.keyframe] @ f.T_keyframe_lidar) for f in self.frames]

    def statistics(self) -> dict:
        """Counts and times for reports and metrics (JSON-ready)."""
        self.settle()
        return report(self)

    # --- persistence ------------------------------------------------------------------------------------------

    @property
    def commit_due(self) -> bool:
        """Every second of recording time, or 20 frames."""
        return self.log.due(self.settings.commit_frames, self.settings.commit_s)

    def take_commit(self) -> Commit:
        """Everything since the previous commit."""
        self.settle()
        places = [] if self.closer is None else self.closer.take_places()
        commit = self.log.take(self.graph, persistence.dump(self), places, outcomes(self))
        return replace(commit, happened=self.chronicle.take(), map_version=self.chronicle.map_version)

    def stored(self, seq: int, fetch: Fetch) -> None:
        """Frames up to `seq` are in the store, and clouds can be had from there: memory is for what is near."""
        self.surroundings.stored = seq, fetch
        self.log.stored(seq, self.graph)
        self.frames = [f for f in self.frames if f.seq > seq]

    @classmethod
    def restore(
        cls,
        robot: Robot,
        settings: PipelineSettings,
        verifier: LoopVerifier,
        disable: frozenset[str],
        deskew: str,
        snapshot: Snapshot,
    ) -> MapPipeline:
        """A session as its store knows it, ready for frame `snapshot.last_seq + 1`."""
        pipeline = cls(robot, settings, verifier, disable, deskew)
        persistence.load(pipeline, snapshot)
        return pipeline
