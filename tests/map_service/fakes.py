"""A pipeline that only counts: frame `seq` lies at x = number of frames mapped so far, m.

So a trajectory with x == seq at every frame says that each was mapped exactly once. The payload says what shall
happen: see `payload`.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from map_service.cloud import encode_cloud
from map_service.clouds import Fetch
from map_service.database import StoreError
from map_service.happenings import Happened, LoopAccepted, MapMove
from map_service.hello import SessionRequest
from map_service.seen import MapSeen, ScanSeen
from map_service.settings import PipelineSettings
from map_service.types import (
    Cause,
    Commit,
    CorrectionRecord,
    FactorRecord,
    FrameRecord,
    KeyframeRecord,
    MapAnswer,
    Snapshot,
    State,
    StateVersionError,
)
from splitslam.errors import DataError
from splitslam.scan import GnssFix
from splitslam.stack.process import wait_until
from splitslam.wire import session_pb2 as pb

KEYFRAME_EVERY = 5
FINAL_SHIFT_M = 100.0
POINTS_LIDAR = np.array([[1, 0, 0], [0, 2, 0], [0, 0.01, 0]], np.float32)


def payload(does: str = "map", **values: Any) -> bytes:
    """does: map | corrupt | raise | unsettled | crash (once=) | away (once=) | sleep (seconds=) | correct (by_m=) |
    wait (begun=, over=): makes the first file, goes on when there is the other; a test need not hurry."""
    return json.dumps({"does": does, **values}).encode()


def at(x_m: float) -> np.ndarray:
    T = np.eye(4)
    T[0, 3] = x_m
    return T


class FakePipeline:
    """A keyframe each 5 frames; "correct" moves every keyframe, as a loop would, and finishing does so by 100 m."""

    def __init__(self, snapshot: Snapshot | None) -> None:
        state = json.loads(snapshot.tracker) if snapshot else {"mapped": 0, "keyframes": [], "shift_m": 0.0}
        if state.get("later"):
            raise StateVersionError("tracker state of version 9, expected one of (1, 2)")
        self.mapped, self.keyframes, self.shift_m = state["mapped"], state["keyframes"], state["shift_m"]
        self.map_version = snapshot.map_version if snapshot else 1
        self.happened: list[Happened] = []
        self.due_m = self.told_m = 0.0  # correction that the next settling makes, that the next answer tells
        self.newest = (0, 0)  # seq and stamp
        self.frames: list[FrameRecord] = []
        self.new_keyframes: list[KeyframeRecord] = []
        self.factors: list[FactorRecord] = []
        self.failing = False
        self.seen_points = 2
        self.moved: list[tuple[int, np.ndarray]] = []

    def answer(self, frame: dict[str, Any], fixes: Sequence[GnssFix]) -> MapAnswer:
        self._act(frame)
        seq, stamp_ns = frame["seq"], frame["stamp_ns"]
        self.seen_points = frame.get("points", 2)
        keyframe = self.mapped % KEYFRAME_EVERY == 0
        self.mapped += 1
        x_m = float(self.mapped) + self.shift_m
        self.newest = seq, stamp_ns
        told = CorrectionRecord(Cause.LOOP, self.told_m, 0.0) if self.told_m else None
        self.due_m, self.told_m = frame.get("by_m", 0.0), 0.0
        if keyframe:
            index = len(self.keyframes)
            self.keyframes.append(x_m)
            self.new_keyframes.append(KeyframeRecord(index, seq, stamp_ns, at(x_m), made_cloud()))
            self.factors.append(FactorRecord(index, "odometry" if index else "prior", b"f"))
        newest = len(self.keyframes) - 1
        pose = at(x_m - self.keyframes[newest])
        self.frames.append(FrameRecord(seq, stamp_ns, newest, pose, at(x_m), int(State.TRACKING)))
        none = np.zeros((0, 6))
        return MapAnswer(
            *(seq, stamp_ns, at(x_m), at(0.5), np.eye(6), State.TRACKING, none, told, keyframe, 1.0),
            map_version=self.map_version,
        )

    def settle(self) -> float | None:
        """All was done at once but for a correction; "unsettled" fails now."""
        if self.failing:
            raise RuntimeError("told to, after the answer")
        if self.due_m:
            self.shift_m, self.told_m = self.shift_m + self.due_m, self.due_m
            self._move(self.due_m)
            self.due_m = 0.0
        return None

    def _move(self, by_m: float) -> None:
        before = np.array([at(x_m) for x_m in self.keyframes]).reshape(-1, 4, 4)
        self.keyframes = [x_m + by_m for x_m in self.keyframes]
        self.new_keyframes = [replace(k, T_map_lidar=at(self.keyframes[k.index])) for k in self.new_keyframes]
        self.moved = [(i, at(x_m)) for i, x_m in enumerate(self.keyframes)]
        self.map_version += 1
        (seq, stamp_ns), cause = self.newest, Cause.LOOP
        move = MapMove(self.map_version, seq + 1, cause, by_m, 0.0, before)
        self.happened += [
            Happened(seq, stamp_ns, LoopAccepted(0, len(before) - 1, by_m, 0.0)),
            Happened(seq, stamp_ns, move),
        ]

    def _act(self, frame: dict[str, Any]) -> None:
        match frame["does"]:
            case "crash":
                if not os.path.exists(frame["once"]):
                    open(frame["once"], "w").close()
                    os._exit(9)
            case "away":
                if not os.path.exists(frame["once"]):
                    open(frame["once"], "w").close()
                    raise StoreError("a cloud cannot be fetched")
            case "unsettled":
                self.failing = True
            case "raise":
                raise RuntimeError("told to")
            case "sleep":
                if "begun" in frame:
                    open(frame["begun"], "w").close()
                time.sleep(frame["seconds"])
            case "wait":
                open(frame["begun"], "w").close()
                wait_until(lambda: os.path.exists(frame["over"]), 60.0, "the end of a frame that waits")

    @property
    def commit_due(self) -> bool:
        return bool(self.new_keyframes)

    def take_commit(self) -> Commit:
        state = {"mapped": self.mapped, "keyframes": self.keyframes, "shift_m": self.shift_m}
        news = self.frames, self.new_keyframes, self.factors, self.moved, json.dumps(state).encode()
        commit = Commit(-1, -1, *news, happened=self.happened, map_version=self.map_version)
        self.frames, self.new_keyframes, self.factors, self.moved, self.happened = [], [], [], [], []
        return commit

    def stored(self, seq: int, fetch: Fetch) -> None:
        """Keeps nothing for the store."""

    def seen(self, newest_fixes: int) -> tuple[ScanSeen, MapSeen]:
        """As many corners as the newest frame said, matched with what is a metre above them; a surf without a match."""
        corners = np.tile(np.array([self.mapped, 0, 0], np.float32), (self.seen_points, 1))
        surfs, nothing = np.array([[0, self.mapped, 0]], np.float32), np.full((1, 3), np.nan, np.float32)
        newest = len(self.keyframes) - 1
        scan = ScanSeen(newest, 1.5, corners, surfs, corners + np.array([0, 0, 1], np.float32), nothing)
        poses = np.array([at(x_m) for x_m in self.keyframes]).reshape(-1, 4, 4)
        loops = [(0, newest)] if newest > 1 else []
        fixes = self.keyframes[:1]
        return scan, MapSeen(poses, loops, np.zeros(len(fixes), np.int64), np.array([[x, 0.0, 2.0] for x in fixes]))

    def finish(self) -> None:
        self.settle()
        self._move(FINAL_SHIFT_M)

    def statistics(self) -> dict[str, Any]:
        return {"mapped": self.mapped, "keyframes": len(self.keyframes), "map_ms": {"graph": {"mean": 1.0}}}


class FakeEngine:
    codec_version = 1

    def __init__(self, settings: PipelineSettings, loop_workers: int) -> None:
        pass

    def warm_up(self) -> None:
        pass

    def decode(self, frame: pb.Frame, request: SessionRequest) -> Any:
        content = json.loads(frame.payload)
        if content["does"] == "corrupt":
            raise DataError("corrupt", "told to")
        return {"seq": frame.seq, "stamp_ns": frame.stamp_ns, **content}

    def create(self, request: SessionRequest, snapshot: Snapshot | None) -> FakePipeline:
        return FakePipeline(snapshot)

    def pool_cpu_ns(self) -> int:
        return 0

    def close(self) -> None:
        pass


def made_cloud() -> bytes:
    """Encoded; surfs alone."""
    n = len(POINTS_LIDAR)
    nothing = POINTS_LIDAR[:0]
    intensity = np.arange(n, dtype=np.uint8)
    return encode_cloud(nothing, POINTS_LIDAR, intensity[:0], intensity)
