"""Commits with made content, for tests of the store."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np

from map_service.happenings import Happened, MapMove
from map_service.rows import SessionCommit
from map_service.store import Opening
from map_service.types import Cause, Commit, FactorRecord, FrameRecord, KeyframeRecord
from splitslam import se3
from tests.map_service.fakes import made_cloud

JSON = json.dumps({"v": 1}).encode()
OPENING = Opening("r/1", "r", "1", "site", "", "robot: {}")


def pose(seed: int) -> np.ndarray:
    return se3.exp(np.random.default_rng(seed).normal(size=6))


def entry(previous: int, last: int, *, keyframes: tuple[int, ...] = (), **changes) -> SessionCommit:
    """Frames previous + 1 .. last on keyframe 0."""
    seqs = range(previous + 1, last + 1)
    commit = Commit(
        previous,
        last,
        [FrameRecord(seq, 1000 * seq, 0, pose(seq), pose(seq + 100), 2) for seq in seqs],
        [KeyframeRecord(k, previous + 1, 1000 * (previous + 1), pose(1000 + k), bytes([k])) for k in keyframes],
        [FactorRecord(k, "loop" if k else "prior", b"factor") for k in keyframes],
        [],
        f"tracker {last}".encode(),
        [(k, f"place {k}".encode()) for k in keyframes],
    )
    return replace(SessionCommit(commit, {seq: pose(seq + 200) for seq in seqs}), **changes)


def with_move(made: SessionCommit, version: int, keyframes: int = 1) -> SessionCommit:
    """The same, and version `version` of the map begins after it; the one before had so many keyframes."""
    poses = np.tile(np.eye(4), (keyframes, 1, 1))
    last = made.commit.last_seq
    move = Happened(last, last, MapMove(version, last + 1, Cause.GNSS, 0.02, 0.0, poses))
    return replace(made, commit=replace(made.commit, happened=[move], map_version=version))


def sound() -> SessionCommit:
    """Frames 1 to 9 but for 5 and 6, of which 8 was rejected; two keyframes and a loop."""
    made = entry(0, 9, keyframes=(0, 1), holes=[(7, 4)], rejected=[(8, 8000, "corrupt")])
    commit = replace(
        made.commit,
        frames=[frame for frame in made.commit.frames if frame.seq not in (5, 6, 8)],
        keyframes=[replace(k, cloud=made_cloud()) for k in made.commit.keyframes],
        factors=[FactorRecord(i, kind, JSON) for i, kind in enumerate(("prior", "odometry", "loop"))],
        tracker=JSON,
    )
    return replace(made, commit=commit)
