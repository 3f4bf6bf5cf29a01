"""Records that pass between the pipeline (one session, single writer), the session and the store."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from splitslam import se3

if TYPE_CHECKING:
    from map_service.happenings import Happened


class State(IntEnum):
    """Same numbers as splitslam.v1.TrackingState."""

    INITIALISING = 1
    TRACKING = 2
    DEGENERATE = 3
    UNANCHORED = 4
    LOCALISING = 5
    LOST = 6


class Cause(IntEnum):
    """Same numbers as splitslam.v1.CorrectionCause."""

    LOOP = 1
    GNSS = 2
    RELOCALISE = 3
    REGISTRATION = 4


@dataclass(frozen=True, slots=True)
class CorrectionRecord:
    """One jump of T_map_odom."""

    cause: Cause
    translation_m: float
    rotation_rad: float

    @classmethod
    def of(cls, cause: Cause, moved: NDArray[np.float64]) -> CorrectionRecord:
        """moved: (4, 4), by which the robot's pose has jumped, in its own frame."""
        return cls(cause, float(np.linalg.norm(moved[:3, 3])), se3.angle(moved))


@dataclass(frozen=True, slots=True)
class Effort:
    """What placing a frame took: thread CPU time, s; its registration's steps, and how many of the features fitted.

    features: 0 for a frame that brought none. registered: false for the first frame, which makes the map.
    """

    registration_s: float
    registered: bool = False
    iterations: int = 0
    inliers: int = 0
    features: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class MapAnswer:
    """The pipeline's answer to one frame. Transforms (4, 4) float64; covariance (6, 6), right tangent, rot first."""

    seq: int
    stamp_ns: int
    T_map_lidar: NDArray[np.float64]
    T_map_odom: NDArray[np.float64]
    covariance: NDArray[np.float64]
    state: State
    degenerate_axes: NDArray[np.float64]  # (A, 6)
    correction: CorrectionRecord | None
    keyframe: bool
    registration_ms: float
    effort: Effort | None = None
    map_version: int = 1  # that T_map_lidar is in


@dataclass(frozen=True, slots=True, eq=False)
class FrameRecord:
    """A frame as stored: its pose relative to its keyframe and the answer that was given."""

    seq: int
    stamp_ns: int
    keyframe: int
    T_keyframe_lidar: NDArray[np.float64]
    T_map_lidar_online: NDArray[np.float64]
    state: int


@dataclass(frozen=True, slots=True, eq=False)
class KeyframeRecord:
    """A keyframe as stored. `cloud` is map_service.cloud's encoding (quantised corners + surfs); None: not loaded."""

    index: int
    seq: int
    stamp_ns: int
    T_map_lidar: NDArray[np.float64]
    cloud: bytes | None


@dataclass(frozen=True, slots=True)
class FactorRecord:
    """One factor of the graph; `payload` is graph.py's versioned encoding."""

    index: int
    kind: str  # "prior" | "odometry" | "gnss" | "loop" | "gravity"
    payload: bytes


@dataclass(frozen=True, slots=True, eq=False)
class Commit:
    """Everything since the previous commit; applied atomically, compare-and-set on (epoch, previous_seq)."""

    previous_seq: int
    last_seq: int
    frames: list[FrameRecord]
    keyframes: list[KeyframeRecord]
    factors: list[FactorRecord]
    keyframe_poses: list[tuple[int, NDArray[np.float64]]]  # corrected since: (index, T_map_lidar)
    tracker: bytes  # pipeline state needed to go on after last_seq, versioned
    places: list[tuple[int, bytes]] = field(default_factory=list)  # (keyframe, descriptor as places.py packs it)
    frames_again: list[tuple[int, NDArray[np.float64]]] = field(default_factory=list)  # (seq, T_keyframe_lidar)
    outcomes: dict[tuple[str, str], int] = field(default_factory=dict)  # (metric, label) of what was tried since
    happened: list[Happened] = field(default_factory=list)
    map_version: int = 0  # after the last frame; 0: as it was


@dataclass(slots=True, eq=False)
class Snapshot:
    """A whole session as loaded from the store, input of MapPipeline.restore.

    fetch_clouds: the clouds of keyframes that were loaded without. mapped: frames so far.
    """

    last_seq: int
    keyframes: list[KeyframeRecord]
    factors: list[FactorRecord]
    tracker: bytes
    mapped: int = 0
    map_version: int = 1
    places: list[bytes] = field(default_factory=list)  # of keyframes 0, 1, 2, ...
    fetch_clouds: Callable[[Sequence[int]], dict[int, bytes]] | None = None


class StateVersionError(Exception):
    """A stored session is of a release that this one cannot read; another replica may."""
