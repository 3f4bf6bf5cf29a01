"""What goes from edge to map in the systems that rate_distortion.py compares; everything else is the same.

Each wire carries the edge's motion of the scan, which costs all of them what it costs us: a frame of ours without
points. Without times of points the map service cannot deskew again, so only our wire lets it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import numpy as np

from benchmarks import clouds
from edge_agent.features.integer import FeatureMarks
from edge_agent.rate import RateSettings
from edge_agent.settings import DenseSettings, FeatureSettings, PipelineSettings
from splitslam import codec
from splitslam.bench.in_one_process import Seen
from splitslam.bench.lio_sam import LioSamFeatures
from splitslam.features import FeatureFrame, FeatureSet

# What the uplink puts around each frame (envelope, gRPC, HTTP/2): what our rate control reckons with.
OVERHEAD_BYTES = RateSettings().frame_overhead_bytes


@dataclass(slots=True)
class Sent:
    """What has gone over a wire so far, OVERHEAD_BYTES a frame included."""

    frames: int = 0
    bytes: int = 0
    points: int = 0

    def add(self, size: int, frame: FeatureFrame) -> FeatureFrame:
        """Counts a frame with a payload of `size` bytes and hands it on."""
        self.frames += 1
        self.bytes += size + OVERHEAD_BYTES
        self.points += len(frame.corners) + len(frame.surfs)
        return frame


class Wire(ABC):
    """One system at one setting."""

    deskew_again = False
    max_kbps: float | None = None  # of the edge's rate control
    every: int = 1  # 2: each second scan is sent, and so on

    def __init__(self) -> None:
        self.sent = Sent()

    @property
    def settings(self) -> PipelineSettings:
        """Of the edge."""
        return PipelineSettings(deskew="cpu")

    @abstractmethod
    def __call__(self, seen: Seen) -> FeatureFrame:
        """The frame that arrives."""


class CloudWire(Wire):
    """Clouds of another codec beside the motion of ours."""

    def __call__(self, seen: Seen) -> FeatureFrame:
        """See Wire."""
        frame = seen.decoded()
        corners, surfs, size = self.clouds(seen)
        empty = _features(np.empty((0, 3), np.float32))
        bare = codec.encode(replace(frame, corners=empty, surfs=empty), seen.beam_elevations_rad, seen.columns)
        arrived = replace(frame, corners=_features(corners), surfs=_features(surfs))
        return self.sent.add(len(bare) + size, arrived)

    @abstractmethod
    def clouds(self, seen: Seen) -> tuple[clouds.Points, clouds.Points, int]:
        """Corners and surfs as they arrive, and the bytes they came in."""


class Ours(Wire):
    """Our codec; its rate is set by the uplink's budget or, above what it needs, by how much it is told to send."""

    deskew_again = True

    def __init__(
        self,
        max_kbps: float | None = None,
        features: FeatureSettings | None = None,
        dense_m: float = 1.0,
        every: int = 1,
    ) -> None:
        """max_kbps: the budget, None for none. features: of frames; dense_m: how often one carries them all.

        every: to compare with the others; the edge agent has no such setting.
        """
        super().__init__()
        self.max_kbps, self.every = max_kbps, every
        features, dense = features or FeatureSettings(), DenseSettings(distance_m=dense_m)
        self._settings = PipelineSettings(deskew="cpu", features=features, dense=dense)

    @property
    def settings(self) -> PipelineSettings:
        return self._settings

    def __call__(self, seen: Seen) -> FeatureFrame:
        return self.sent.add(len(seen.frame.payload), seen.decoded())


class LioSamZstd(CloudWire):
    """LIO-SAM's corners and surfs of every scan in steps of 1 cm, Morton order and zstd."""

    def __init__(self, corners_per_sector: int = 20, leaf_m: float = 0.4, every: int = 1) -> None:
        """every: LIO-SAM itself maps each second scan."""
        super().__init__()
        self.every = every
        self._corners_per_sector, self._leaf_m = corners_per_sector, leaf_m
        self._features: LioSamFeatures | None = None

    def clouds(self, seen: Seen) -> tuple[clouds.Points, clouds.Points, int]:
        image = seen.image
        if self._features is None:
            self._features = LioSamFeatures(len(seen.beam_elevations_rad), seen.columns)
        assert image.range_q is not None
        marks = FeatureMarks.of(image.range_q, image.column, image.ring_start, self._features.limits)
        rows = self._features.select(image, marks, self._leaf_m, self._corners_per_sector)
        corners, surfs = (clouds.encode_morton(image.points_lidar[chosen]) for chosen in rows)
        return clouds.decode_morton(corners), clouds.decode_morton(surfs), len(corners) + len(surfs)


class ThinnedDraco(CloudWire):
    """The deskewed scan thinned to voxels, in steps of 1 cm, by Draco; each point is a surf, as none says it is not."""

    def __init__(self, voxel_m: float, every: int = 1) -> None:
        super().__init__()
        self._voxel_m, self.every = voxel_m, every

    def clouds(self, seen: Seen) -> tuple[clouds.Points, clouds.Points, int]:
        data = clouds.encode_draco(clouds.thinned(seen.image.points_lidar, self._voxel_m))
        return np.empty((0, 3), np.float32), clouds.decode_draco(data), len(data)


def _features(points: clouds.Points) -> FeatureSet:
    """Points of which nothing else is known."""
    n = len(points)
    return FeatureSet(
        points, np.zeros(n, np.uint8), np.zeros(n, np.uint16), np.zeros(n, np.int32), np.zeros(n, np.uint8)
    )
