"""A pipeline that only counts: frame `seq` lies at x = number of frames mapped so far, m.

So a trajectory with x == seq at every frame says that each was mapped exactly once. The payload says what shall
happen: see `payload`.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from map_service.cloud import encode_cloud
from map_service.clouds import Fetch
from map_service.database import StoreError
from map_service.hello import SessionRequest
from map_service.seen import MapSeen, ScanSeen
from map_service.settings import PipelineSettings
from map_service.types import (
    Commit,
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
from splitslam.wire import session_pb2 as pb

KEYFRAME_EVERY = 5
FINAL_SHIFT_M = 100.0
POINTS_LIDAR = np.array([[1, 0, 0], [0, 2, 0], [0, 0.01, 0]], np.float32)


def payload(does: str = "map", **values: Any) -> bytes:
    """does: map | corrupt | raise | unsettled | crash (once=) | away (once=) | sleep (seconds=)."""
    return json.dumps({"does": does, **values}).encode()


def at(x_m: float) -> np.ndarray:
    T = np.eye(4)
    T[0, 3] = x_m
    return T


class FakePipeline:
    """A keyframe each 5 frames; finishing moves every keyframe by 100 m, as a loop would."""

    def __init__(self, snapshot: Snapshot | None) -> None:
        state = json.loads(snapshot.tracker) if snapshot else {"mapped": 0, "keyframes": []}
        if state.get("later"):
            raise StateVersionError("tracker state of version 9, expected one of (1, 2)")
        self.mapped, self.keyframes = state["mapped"], state["keyframes"]
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
        x_m = float(self.mapped)
        if keyframe:
            index = len(self.keyframes)
            self.keyframes.append(x_m)
            self.new_keyframes.append(KeyframeRecord(index, seq, stamp_ns, at(x_m), made_cloud()))
            self.factors.append(FactorRecord(index, "odometry" if index else "prior", b"f"))
        newest = len(self.keyframes) - 1
        pose = at(x_m - self.keyframes[newest])
        self.frames.append(FrameRecord(seq, stamp_ns, newest, pose, at(x_m), int(State.TRACKING)))
        none = np.zeros((0, 6))
        return MapAnswer(seq, stamp_ns, at(x_m), at(0.5), np.eye(6), State.TRACKING, none, None, keyframe, 1.0)

    def settle(self) -> float | None:
        """All was done at once; "unsettled" fails now."""
        if self.failing:
            raise RuntimeError("told to, after the answer")
        return None

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
                time.sleep(frame["seconds"])

    @property
    def commit_due(self) -> bool:
        return bool(self.new_keyframes)

    def take_commit(self) -> Commit:
        state = {"mapped": self.mapped, "keyframes": self.keyframes}
        commit = Commit(-1, -1, self.frames, self.new_keyframes, self.factors, self.moved, json.dumps(state).encode())
        self.frames, self.new_keyframes, self.factors, self.moved = [], [], [], []
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
        self.keyframes = [x_m + FINAL_SHIFT_M for x_m in self.keyframes]
        self.moved = [(i, at(x_m)) for i, x_m in enumerate(self.keyframes)]

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
