"""The clouds of a session's keyframes: quantised in memory, and only as long as they are near or not yet stored."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from map_service.cloud import STEP_M, decode_cloud, encode_cloud

Fetch = Callable[[Sequence[int]], dict[int, bytes]]  # keyframes -> their clouds as map_service.cloud encodes them


class CloudsAwayError(Exception):
    """The store that has the clouds does not answer now."""


class Cloud:
    """What a keyframe saw, by class: points (N, 3) in steps of 5 mm, 7 bytes each, and intensity (N,) uint8.

    Whoever asks for points gets what the store's encoding would give, so that a session that was restored, or has
    fetched a cloud again, has the very same map.
    """

    __slots__ = ("_corners", "_surfs", "corners_intensity", "surfs_intensity")

    def __init__(
        self,
        corners_lidar: NDArray[np.float32],
        surfs_lidar: NDArray[np.float32],
        corners_intensity: NDArray[np.uint8],
        surfs_intensity: NDArray[np.uint8],
    ) -> None:
        """Points (N, 3), m, frame `lidar`."""
        self._corners, self._surfs = _steps(corners_lidar), _steps(surfs_lidar)
        self.corners_intensity, self.surfs_intensity = corners_intensity, surfs_intensity

    @property
    def corners_lidar(self) -> NDArray[np.float32]:
        """(N, 3), m, frame `lidar`."""
        return _metres(self._corners)

    @property
    def surfs_lidar(self) -> NDArray[np.float32]:
        """(N, 3), m, frame `lidar`."""
        return _metres(self._surfs)

    @property
    def count(self) -> int:
        """Points of both classes."""
        return len(self._corners) + len(self._surfs)

    @property
    def nbytes(self) -> int:
        """Of its arrays."""
        return self._corners.nbytes + self._surfs.nbytes + self.count

    def encoded(self) -> bytes:
        """As the store has it."""
        return encode_cloud(self.corners_lidar, self.surfs_lidar, self.corners_intensity, self.surfs_intensity)

    @classmethod
    def decoded(cls, data: bytes) -> Cloud:
        """From map_service.cloud's encoding. Raises DataError."""
        points, intensity, is_corner = decode_cloud(data)
        return cls(points[is_corner], points[~is_corner], intensity[is_corner], intensity[~is_corner])


def _steps(points_lidar: NDArray[np.float32]) -> NDArray[np.signedinteger]:
    """16 bits reach 163 m; a cloud of a sensor that sees further takes 32."""
    steps = np.rint(points_lidar / STEP_M)
    far = len(steps) and np.abs(steps).max() > np.iinfo(np.int16).max
    return steps.astype(np.int32 if far else np.int16)


def _metres(steps: NDArray) -> NDArray[np.float32]:
    return (steps * STEP_M).astype(np.float32)


class Clouds:
    """Clouds of keyframes 0, 1, 2, ... Those let go are fetched when they are needed again: most never are."""

    def __init__(self, fetch: Fetch | None = None) -> None:
        """fetch: for those that were added as None."""
        self._fetch = fetch
        self._loaded: dict[int, Cloud] = {}
        self._count = 0

    def __len__(self) -> int:
        return self._count

    @property
    def loaded(self) -> int:
        """Clouds in memory."""
        return len(self._loaded)

    @property
    def nbytes(self) -> int:
        """Of those in memory."""
        return sum(cloud.nbytes for cloud in self._loaded.values())

    def append(self, cloud: Cloud | None) -> None:
        """Adds one; None: it is in the store."""
        if cloud is not None:
            self._loaded[self._count] = cloud
        self._count += 1

    def replace(self, index: int, cloud: Cloud) -> None:
        """Another one for a keyframe."""
        self._loaded[index] = cloud

    def get(self, indices: Iterable[int]) -> list[Cloud]:
        """Those that are not in memory come with one query. Raises CloudsAwayError."""
        wanted = list(indices)
        missing = [i for i in wanted if i not in self._loaded]
        if missing:
            assert self._fetch is not None
            self._loaded |= {i: Cloud.decoded(data) for i, data in self._fetch(missing).items()}
        return [self._loaded[i] for i in wanted]

    def keep(self, indices: set[int], below: int, fetch: Fetch) -> None:
        """Lets go of all but `indices` of the keyframes below `below`, which can be fetched from now on."""
        self._fetch = fetch
        self._loaded = {i: cloud for i, cloud in self._loaded.items() if i in indices or i >= below}
