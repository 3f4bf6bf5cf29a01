"""What a session hands to its store, and how it is made again from there."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from map_service.clouds import Cloud
from map_service.drift import MapDrift
from map_service.graph import PoseGraph
from map_service.growing import Poses
from map_service.keyframes import Keyframe, Keyframes
from map_service.pipeline_statistics import outcomes
from map_service.tracker_state import TrackerState
from map_service.types import Commit, FrameRecord, KeyframeRecord, MapAnswer, Snapshot, StateVersionError
from splitslam import se3

if TYPE_CHECKING:
    from map_service.pipeline import MapPipeline

Array = NDArray[np.float64]
_VERSION = 2
_READ = (1, 2)  # 1: sessions that a service of 0.1.0 began
# m, and rad in entries of the rotation: so far a keyframe has to move to be written again. Each fix moves all a little.
_MOVED = np.where(np.arange(16).reshape(4, 4) % 4 == 3, 1e-3, 1e-4)
_MOVED_AT_LAST = 1e-3  # share of that, once the session has ended


class CommitLog:
    """Collects what is new since the last commit."""

    def __init__(self) -> None:
        self.last_seq = 0
        self._frames: list[FrameRecord] = []
        self._frames_again: dict[int, Array] = {}
        self._keyframes: list[KeyframeRecord] = []
        self._factors = 0
        self._stored = Poses()  # of keyframes, as the store has them
        self._first_ns = 0
        self._outcomes: Counter[tuple[str, str]] = Counter()  # as they were told last
        self.exact = False  # are poses to be stored as they are, however little they have moved?

    def frame(self, answer: MapAnswer, T_map_lidar: Array, keyframe: int, T_map_keyframe: Array) -> FrameRecord:
        """Notes an answered frame, where it is by now, and the keyframe that this is told by."""
        record = FrameRecord(
            answer.seq,
            answer.stamp_ns,
            keyframe,
            se3.inv(T_map_keyframe) @ T_map_lidar,
            answer.T_map_lidar,
            int(answer.state),
        )
        if not self._frames:
            self._first_ns = answer.stamp_ns
        self._frames.append(record)
        return record

    def keyframe(self, keyframe: Keyframe, T_map_lidar: Array) -> None:
        """Notes a keyframe that is new, or new again (the store replaces it)."""
        cloud = keyframe.cloud.encoded()
        self._keyframes.append(KeyframeRecord(keyframe.index, keyframe.seq, keyframe.stamp_ns, T_map_lidar, cloud))
        if keyframe.index == len(self._stored):
            self._stored.append(T_map_lidar)

    def place_again(self, poses: dict[int, Array]) -> None:
        """Notes new T_keyframe_lidar (4, 4) by seq, of frames that a commit has taken or will take."""
        self._frames = [replace(f, T_keyframe_lidar=poses.get(f.seq, f.T_keyframe_lidar)) for f in self._frames]
        waiting = {f.seq for f in self._frames}
        self._frames_again |= {seq: T for seq, T in poses.items() if seq not in waiting}

    def due(self, frames: int, seconds: float) -> bool:
        """Is it time to commit?"""
        if not self._frames:
            return False
        age_s = (self._frames[-1].stamp_ns - self._first_ns) * 1e-9
        return len(self._frames) >= frames or age_s >= seconds

    def take(
        self, graph: PoseGraph, tracker: bytes, places: list[tuple[int, bytes]], outcomes: Counter[tuple[str, str]]
    ) -> Commit:
        """Hands over everything new and starts again; `places` are the new ones, `outcomes` counts since the start."""
        stored, now = self._stored.matrices, graph.poses.matrices
        limit = _MOVED * (_MOVED_AT_LAST if self.exact else 1.0)
        indices = np.flatnonzero((np.abs(stored - now) > limit).any(axis=(1, 2)))
        moved = [(int(i), now[i].copy()) for i in indices]
        stored[indices] = now[indices]
        last_seq = self._frames[-1].seq if self._frames else self.last_seq
        factors = graph.records_from(self._factors)
        again, new = sorted(self._frames_again.items()), dict(outcomes - self._outcomes)
        news = self._frames, self._keyframes, factors, moved, tracker, places, again, new
        commit = Commit(self.last_seq, last_seq, *news)
        self.last_seq, self._factors, self._outcomes = last_seq, graph.record_count, outcomes
        self._frames, self._keyframes, self._frames_again = [], [], {}
        return commit

    def resume(self, snapshot: Snapshot, outcomes: Counter[tuple[str, str]]) -> None:
        """Continues after what the store has; `outcomes` are counted already."""
        self._outcomes = outcomes
        self.last_seq, self._factors = snapshot.last_seq, len(snapshot.factors)
        self._stored = Poses(k.T_map_lidar for k in snapshot.keyframes)

    def stored(self, seq: int, graph: PoseGraph) -> None:
        """Frames up to `seq` are in the store: factors need not be kept for it."""
        if seq >= self.last_seq:
            graph.let_go_records(self._factors)


def dump(pipeline: MapPipeline) -> bytes:
    """The pipeline's small state, versioned JSON."""
    state = pipeline.tracker.state
    if state is None:
        return json.dumps({"v": _VERSION, "empty": True}).encode()
    return json.dumps(
        {
            "v": _VERSION,
            "T_local_lidar": state.T_local_lidar.tolist(),
            "T_local_keyframe": state.T_local_keyframe.tolist(),
            "stamp_ns": state.stamp_ns,
            "frames": state.frames,
            "twist": state.twist.tolist(),
            "base_twist": state.base_twist.tolist(),
            "bad_frames": state.bad_frames,
            "twist_spread": state.twist_spread.tolist(),
            "carried_sigma": state.carried_sigma.tolist(),
            "doubt": pipeline.tracker.doubt.dump(),
            "carried": pipeline.tracker.carried.dump(),
            "found": pipeline.uncertainty.found,
            "reference": pipeline.ground.reference,
            "slip": pipeline.uncertainty.drift.slip.tolist(),
            "T_map_local": pipeline.map_frame.T_map_local.tolist(),
            "T_map_odom": pipeline.map_frame.T_map_odom.tolist(),
            "gnss": None if pipeline.gnss is None else pipeline.gnss.dump(),
            "leveller": pipeline.leveller.dump(),
            "loops": pipeline.stats.loops,
            "gnss_factors": pipeline.stats.gnss_factors,
            "gravity_factors": pipeline.stats.gravity_factors,
            "corrections": pipeline.stats.corrections,
            "largest_correction_m": pipeline.stats.largest_correction_m,
            "closer": None if pipeline.closer is None else pipeline.closer.dump(),
        }
    ).encode()


def load(pipeline: MapPipeline, snapshot: Snapshot) -> None:
    """Puts a stored session into a fresh pipeline."""
    data = json.loads(snapshot.tracker)
    if data["v"] not in _READ:
        raise StateVersionError(f"tracker state of version {data['v']}, expected one of {_READ}")
    if data.get("empty"):
        return
    poses = [k.T_map_lidar for k in snapshot.keyframes]
    pipeline.graph = PoseGraph.restore(pipeline.settings.graph, list(snapshot.factors), poses)
    pipeline.uncertainty.drift = MapDrift(pipeline.graph.drifts)
    pipeline.uncertainty.drift.slip = np.array(data.get("slip", np.zeros((6, 6))))
    pipeline.map_frame.T_map_local = np.array(data["T_map_local"])
    pipeline.map_frame.T_map_odom = np.array(data["T_map_odom"])
    back = se3.inv(pipeline.map_frame.T_map_local)
    pipeline.keyframes = Keyframes(snapshot.fetch_clouds)
    for record in snapshot.keyframes:
        cloud = None if record.cloud is None else Cloud.decoded(record.cloud)
        T_local_lidar = back @ pipeline.graph.poses[record.index]
        follows = pipeline.graph.follows.get(record.index)
        pipeline.keyframes.append(record.seq, record.stamp_ns, T_local_lidar, cloud, follows)
    pipeline.ground.reference = int(data.get("reference", len(poses) - 1))
    pipeline.tracker.state = TrackerState(
        np.array(data["T_local_lidar"]),
        np.array(data["T_local_keyframe"]),
        int(data["stamp_ns"]),
        int(data["frames"]),
        np.array(data["twist"]),
        np.array(data["base_twist"]),
        int(data["bad_frames"]),
        snapshot.last_seq,
        twist_spread=np.array(data.get("twist_spread", np.zeros(6))),
        carried_sigma=np.array(data.get("carried_sigma", np.zeros(6))),
    )
    if "doubt" in data:  # sessions of 0.1.0 have none
        pipeline.tracker.doubt.load(data["doubt"])
        pipeline.tracker.carried.load(data.get("carried", []))
        pipeline.uncertainty.found = bool(data["found"])
    if pipeline.gnss is not None and data["gnss"] is not None:
        pipeline.gnss.load(data["gnss"])
    if "leveller" in data:
        pipeline.leveller.load(data["leveller"])
    if pipeline.closer is not None and data["closer"] is not None:
        pipeline.closer.load(data["closer"], snapshot.places, pipeline.keyframes, pipeline.graph.poses)
    pipeline.stats.loops = int(data["loops"])
    pipeline.stats.gnss_factors = int(data["gnss_factors"])
    pipeline.stats.gravity_factors = int(data.get("gravity_factors", 0))
    pipeline.stats.corrections = dict(data["corrections"])
    pipeline.stats.largest_correction_m = float(data["largest_correction_m"])
    pipeline.mapped = snapshot.mapped
    pipeline.chronicle.frame(snapshot.last_seq, int(data["stamp_ns"]))
    pipeline.chronicle.resume(snapshot.map_version, pipeline.graph.poses, len(pipeline.graph.data))
    pipeline.log.resume(snapshot, outcomes(pipeline))
    pipeline.fill_local_map()
