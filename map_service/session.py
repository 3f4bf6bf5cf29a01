"""One session in its worker: frames applied once and in order, answers kept, commits composed.

Synchronous and single-threaded: the worker's thread is the single writer of every session it holds.
"""

from __future__ import annotations

import time
from collections import OrderedDict, deque
from dataclasses import replace
from functools import partial

import numpy as np

from map_service import messages
from map_service.accounts import SessionAccounts
from map_service.channel import RobotStanding
from map_service.commits import CommitLog
from map_service.diary import Diary
from map_service.engine import Engine, Pipeline
from map_service.hello import WIRE_VERSION, SessionRequest
from map_service.rows import SessionCommit
from map_service.seen import MapSeen, ScanSeen
from map_service.store import OpenedSession, Store, StoredAnswer
from map_service.tally import Tally
from map_service.types import Commit, State
from splitslam import __version__
from splitslam.errors import DataError
from splitslam.wire import session_pb2 as pb
from splitslam.wire import types_pb2 as types_pb

KEPT_ANSWERS = 256
WELCOME_POSES = 10


class SequenceGapError(Exception):
    """A frame that is not the next one: the robot replays from `expected`."""

    def __init__(self, expected: int, got: int) -> None:
        super().__init__(f"expected seq {expected}, got {got}")


class Session:
    """The state of one robot run; it outlives the robot's streams."""

    def __init__(
        self,
        request: SessionRequest,
        log: CommitLog,
        engine: Engine,
        store: Store,
        tally: Tally,
        accounts: SessionAccounts,
    ) -> None:
        """Opens what the store has of it: a rebuild when `log` starts after a frame. Raises StoreError."""
        self.request, self.log = request, log
        self.stream: int | None = None
        self.opened_s = self.touched_s = time.monotonic()
        self.state = State.INITIALISING
        self.accounts = accounts
        self.leaving = False  # the robot goes to another replica once all is durable
        self.settled = True  # has the pipeline done all that the frames answered so far mean for the map?
        self.finishing = False  # Bye was said, its commit is under way
        self.held: deque[pb.StreamRequest] = deque()  # what waits until the store has taken more of what is applied
        self._engine, self._store, self._tally = engine, store, tally
        self._answers: OrderedDict[int, pb.Odometry] = OrderedDict()
        self._poses: deque[types_pb.StampedPose] = deque(maxlen=WELCOME_POSES)
        self._T_map_odom = np.eye(4)
        self._mapped_ns = 0  # stamp of the newest frame that was mapped: stamps in the map rise
        self._covariance = np.full((6, 6), np.nan)
        self._new_T_map_odom: dict[int, np.ndarray] = {}
        self._new_covariance: dict[int, np.ndarray] = {}
        self._diary = Diary()
        self._new_rejected: list[tuple[int, int, str]] = []
        self._new_holes: list[tuple[int, int]] = []
        self._tracker = b""
        self._pipeline = self._build()

    def _build(self) -> Pipeline:
        if self.log.durable_seq == 0:
            return self._engine.create(self.request, None)
        snapshot = self._store.load(self.log.key)
        for answer in self._store.answers(self.log.key, last=WELCOME_POSES):
            if answer.T_map_lidar is not None and answer.T_map_odom is not None:
                self._poses.append(messages.stamped_pose(answer.seq, answer.stamp_ns, answer.T_map_lidar))
                self._T_map_odom, self.state = answer.T_map_odom, State(answer.state)
                self._mapped_ns = answer.stamp_ns
        self._tracker = snapshot.tracker
        # without a mapped frame there is no tracker state yet
        return self._engine.create(self.request, snapshot if snapshot.tracker else None)

    def standing(self) -> RobotStanding:
        """How it stands, for gauges by robot; may be asked by another thread."""
        rotation, position = (_largest_sigma(self._covariance[part, part]) for part in (slice(0, 3), slice(3, 6)))
        return RobotStanding(
            session_id=self.request.session_id,
            stream=self.stream,
            state=int(self.state),
            scans=self.log.applied_seq,
            last_stamp_ns=self._mapped_ns,
            opened_s=self.opened_s,
            undurable_frames=self.log.undurable,
            backlog_frames=self.accounts.backlog_frames,
            position_sigma_m=position,
            rotation_sigma_rad=rotation,
        )

    # -- streams ------------------------------------------------------------------------------------------------

    def take_over(self, request: SessionRequest, opened: OpenedSession) -> bool:
        """Go on for a new stream without a rebuild, if nobody else has owned the session in between."""
        log = self.log
        if log.broken or (opened.key, opened.epoch, opened.last_seq) != (log.key, log.epoch + 1, log.durable_seq):
            return False
        log.epoch, self.request = opened.epoch, request
        return True

    def welcome(self) -> pb.Welcome:
        return pb.Welcome(
            epoch=self.log.epoch,
            durable_seq=self.log.durable_seq,
            applied_seq=self.log.applied_seq,
            last_poses=self._poses,
            pose_map_odom=messages.transform_to_wire(self._T_map_odom),
            wire_version=WIRE_VERSION,
            codec_version=self._engine.codec_version,
            session_id=self.request.session_id,
            service_version=__version__,
            takes_dense=True,
        )

    # -- frames -------------------------------------------------------------------------------------------------

    def apply(self, frame: pb.Frame, *, poisoned: bool = False) -> pb.Odometry:
        """The answer to one frame. Raises SequenceGapError when it is not the next one.

        poisoned: the pipeline failed on this very frame before; it is rejected, so that the session goes on.
        """
        self.touched_s = time.monotonic()
        declared = 0 < frame.follows_seq <= self.log.applied_seq < frame.seq  # the robot dropped what is between
        if (frame.seq > self.log.applied_seq + 1 and not declared) or frame.seq == 0:
            self._tally.count("frames", "gap")
            raise SequenceGapError(self.log.applied_seq + 1, frame.seq)
        if frame.seq <= self.log.applied_seq:
            self._tally.count("frames", "duplicate")
            answer = self._duplicate(frame.seq)
        else:
            if missing := frame.seq - self.log.applied_seq - 1:
                self._tally.count("frames", "missing", by=missing)
                self._new_holes.append((frame.seq, self.log.applied_seq))
            self.settled = False
            with self.accounts.timed():
                answer = self._map_or_reject(frame, poisoned)
            self.log.applied_seq = frame.seq
            self._answers[frame.seq] = answer
            if len(self._answers) > KEPT_ANSWERS:
                self._answers.popitem(last=False)
        answer.applied_seq, answer.durable_seq = self.log.applied_seq, self.log.durable_seq
        return answer

    def settle(self) -> None:
        """After the answer is on its way: takes the frame into the map. Raises what the pipeline does."""
        if self.settled:
            return
        with self.accounts.timed():
            graph_s = self._pipeline.settle()
        if graph_s is not None:
            self._tally.observe("stage_seconds", graph_s, "graph")
        self.accounts.frame_done()
        self.settled = True

    def seen(self, newest_fixes: int) -> tuple[ScanSeen | None, MapSeen]:
        """For those who watch, between `apply` and `settle` with the scan itself. Raises what the pipeline does."""
        return self._pipeline.seen(newest_fixes)

    def _map_or_reject(self, frame: pb.Frame, poisoned: bool) -> pb.Odometry:
        try:
            if poisoned:
                raise DataError("failed", "the pipeline fails on it")
            return self._map(frame)
        except DataError as error:
            self._tally.count("frames", "rejected")
            self._tally.count("rejected", error.reason)
            self._new_rejected.append((frame.seq, frame.stamp_ns, error.reason))
            return self._rejection(frame.seq, frame.stamp_ns, error.reason)

    def _map(self, frame: pb.Frame) -> pb.Odometry:
        if not 1 <= frame.codec_version <= self._engine.codec_version:
            raise DataError("codec_version", f"{frame.codec_version}")
        if frame.stamp_ns <= self._mapped_ns:
            raise DataError("time", f"stamp {frame.stamp_ns} after {self._mapped_ns}")
        features = self._engine.decode(frame, self.request)
        fixes, unusable = messages.fixes_from_wire(list(frame.fixes))
        if unusable:
            self._tally.count("gnss", "unusable", by=unusable)
        result = self._pipeline.answer(features, fixes)
        self._mapped_ns = frame.stamp_ns
        answer = messages.odometry(result)
        self._diary.answered(result, self.state)
        self.state = result.state
        self._T_map_odom = self._new_T_map_odom[frame.seq] = result.T_map_odom
        self._poses.append(types_pb.StampedPose(seq=frame.seq, stamp_ns=frame.stamp_ns, pose=answer.pose_map_lidar))
        self._covariance = self._new_covariance[frame.seq] = result.covariance
        self._tally.mapped(result)
        return answer

    def _rejection(self, seq: int, stamp_ns: int, reason: str) -> pb.Odometry:
        T_map_odom = messages.transform_to_wire(self._T_map_odom)
        state = int(self.state)
        return pb.Odometry(seq=seq, stamp_ns=stamp_ns, pose_map_odom=T_map_odom, state=state, rejected=reason)  # type: ignore[arg-type]

    def _duplicate(self, seq: int) -> pb.Odometry:
        answer = pb.Odometry()
        kept = self._answers.get(seq)
        if kept is not None:
            answer.CopyFrom(kept)
        else:
            answer = self._from_store(self._store.answers(self.log.key, seq=seq)[0])
        answer.duplicate = True
        return answer

    def _from_store(self, stored: StoredAnswer) -> pb.Odometry:
        if stored.T_map_lidar is None or stored.T_map_odom is None:
            return self._rejection(stored.seq, stored.stamp_ns, stored.rejected)
        return pb.Odometry(
            seq=stored.seq,
            stamp_ns=stored.stamp_ns,
            pose_map_lidar=messages.transform_to_wire(stored.T_map_lidar),
            pose_map_odom=messages.transform_to_wire(stored.T_map_odom),
            state=stored.state,  # type: ignore[arg-type]
        )

    # -- commits ------------------------------------------------------------------------------------------------

    @property
    def commit_due(self) -> bool:
        """One commit at a time: while it is written the next one grows, so a slow store is not asked more often."""
        if self.log.waiting:
            return False
        return self.log.due() or (bool(self._new_T_map_odom) and self._pipeline.commit_due)

    def commit(self) -> None:
        """Hand everything applied since the last commit over to the store's thread."""
        if self.log.applied_seq > self.log.taken_seq:
            self._pipeline.stored(self.log.durable_seq, partial(self._store.clouds, self.log.key))
            self.log.put(self._compose(self.accounts.text_if_due(self._pipeline), finished=False))

    def finish(self) -> None:
        """The run is over: final optimisation, and a commit after which the session is read-only."""
        if self._tracker or self._new_T_map_odom:
            self._pipeline.finish()
        statistics = self.accounts.text(self._pipeline)
        self.log.put(self._compose(statistics, finished=True))
        self.finishing = True

    def _compose(self, statistics: str, *, finished: bool) -> SessionCommit:
        previous, last = self.log.taken_seq, self.log.applied_seq
        mapped = bool(self._new_T_map_odom) or (finished and bool(self._tracker))
        if mapped:  # seq is the session's own: it also counts the frames that the pipeline never saw
            commit = replace(self._pipeline.take_commit(), previous_seq=previous, last_seq=last)
            self._tracker = commit.tracker
        else:
            commit = Commit(previous, last, [], [], [], [], self._tracker)
        news = self._new_T_map_odom, self._new_rejected, self._new_holes, statistics, finished, self._new_covariance
        entry = SessionCommit(commit, *news, self._diary.take(commit, self._mapped_ns, finished=finished))
        self._new_T_map_odom, self._new_covariance, self._new_rejected, self._new_holes = {}, {}, [], []
        return entry


def _largest_sigma(covariance: np.ndarray) -> float:
    """Standard deviation along the worst axis of (3, 3); NaN while nothing is known."""
    if not np.isfinite(covariance).all():
        return float("nan")
    return float(np.sqrt(max(np.linalg.eigvalsh(covariance)[-1], 0.0)))
