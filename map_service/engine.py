"""What a worker computes with: decoding a frame and building a session's pipeline.

The seam of this service: `SlamEngine` is the product, tests give a worker another class by its dotted path.
"""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from typing import Any, Protocol

from map_service.clouds import Fetch
from map_service.hello import SessionRequest
from map_service.seen import MapSeen, ScanSeen
from map_service.settings import PipelineSettings
from map_service.types import Commit, MapAnswer, Snapshot
from splitslam.features import FeatureFrame
from splitslam.scan import GnssFix
from splitslam.wire import session_pb2 as pb

DEFAULT_ENGINE = "map_service.engine:SlamEngine"


class Pipeline(Protocol):
    """One session's map, single writer (map_service/pipeline.py)."""

    @property
    def commit_due(self) -> bool: ...
    def answer(self, frame: FeatureFrame, fixes: Sequence[GnssFix]) -> MapAnswer: ...
    def settle(self) -> float | None: ...
    def take_commit(self) -> Commit: ...
    def stored(self, seq: int, fetch: Fetch) -> None: ...
    def seen(self, newest_fixes: int) -> tuple[ScanSeen | None, MapSeen]: ...
    def finish(self) -> None: ...
    def statistics(self) -> dict[str, Any]: ...


class Engine(Protocol):
    """Shared by the sessions of one worker; used by its pipeline thread only."""

    codec_version: int

    def warm_up(self) -> None:
        """Load and compile everything, so that the first frame does not wait."""
        ...

    def decode(self, frame: pb.Frame, request: SessionRequest) -> FeatureFrame:
        """Raises DataError for a frame that cannot be used."""
        ...

    def create(self, request: SessionRequest, snapshot: Snapshot | None) -> Pipeline:
        """A new session's pipeline, or one that goes on after `snapshot`."""
        ...

    def pool_cpu_ns(self) -> int:
        """CPU time of the processes it has started, so far."""
        ...

    def close(self) -> None: ...


def load_engine(path: str, settings: PipelineSettings, loop_workers: int) -> Engine:
    """The engine named by `module:Class`."""
    module, _, name = path.partition(":")
    return getattr(importlib.import_module(module), name)(settings, loop_workers)


class SlamEngine:
    """splitslam.codec, MapPipeline and a pool of processes that verify loops."""

    def __init__(self, settings: PipelineSettings, loop_workers: int) -> None:
        from map_service.loop_pool import LoopPool
        from map_service.pipeline import MapPipeline
        from splitslam import codec

        self.codec_version = codec.CODEC_VERSION
        self._decode = codec.decode
        self._pipeline = MapPipeline
        self._settings = settings
        self._pool = LoopPool(loop_workers)

    def warm_up(self) -> None:
        from map_service.warm_up import warm_up

        self._pool.start()
        warm_up(self)

    def decode(self, frame: pb.Frame, request: SessionRequest) -> FeatureFrame:
        return self._decode(frame.payload, frame.seq, frame.stamp_ns, frame.dense, request.beam_elevations_rad)

    def create(self, request: SessionRequest, snapshot: Snapshot | None) -> Pipeline:
        parts = (request.robot, self._settings, self._pool, request.disable, request.deskew)
        return self._pipeline(*parts) if snapshot is None else self._pipeline.restore(*parts, snapshot)

    def pool_cpu_ns(self) -> int:
        return self._pool.cpu_ns()

    def close(self) -> None:
        self._pool.close()
