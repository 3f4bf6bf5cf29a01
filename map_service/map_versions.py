"""The version of a session's map: it grows by one when a correction has moved stored poses noticeably.

Each fix moves every keyframe by a little. So moves are measured from where the version began, and only when one of the
keyframes has gone `version_m` or `version_rad` from there the next version begins: within one, poses that were told
are good to that. What a version ends with is kept by the store for those who ask for it later.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from map_service.growing import Poses
from map_service.happenings import MapMove
from map_service.settings import GraphSettings
from map_service.types import Cause

Array = NDArray[np.float64]
FIRST = 1


class MapVersions:
    """`number` is the version of now."""

    def __init__(self, settings: GraphSettings) -> None:
        self._settings = settings
        self.number = FIRST
        self._began = Poses()  # the keyframes as the version began, or as they were made in it

    def resume(self, number: int, poses: Poses) -> None:
        """Goes on with a stored session; its keyframes are where the version began, as far as anybody remembers."""
        self.number, self._began = max(number, FIRST), Poses(poses)

    def added(self, T_map_lidar: Array) -> None:
        """A keyframe (4, 4) is new."""
        self._began.append(T_map_lidar)

    def corrected(self, before: Array, after: Array, cause: Cause, first_seq: int) -> MapMove | None:
        """The graph has moved its keyframes (n, 4, 4); None: not so far that a version begins."""
        moved_m, moved_rad = _moves(self._began.matrices, after)
        if moved_m < self._settings.version_m and moved_rad < self._settings.version_rad:
            return None
        return self._next(before, after, cause, first_seq, (moved_m, moved_rad))

    def relocalised(self, poses: Array, size: tuple[float, float], first_seq: int) -> MapMove:
        """The robot was lost, and the scans since then lie elsewhere than was told. size: of that, m and rad."""
        return self._next(poses, poses, Cause.RELOCALISE, first_seq, size)

    def _next(self, before: Array, after: Array, cause: Cause, first_seq: int, size: tuple[float, float]) -> MapMove:
        self.number += 1
        self._began.matrices[:] = after
        return MapMove(self.number, first_seq, cause, *size, before.copy())


def _moves(then: Array, now: Array) -> tuple[float, float]:
    """The largest translation, m, and rotation, rad, between poses (n, 4, 4); 0 for none."""
    if not len(then):
        return 0.0, 0.0
    moved_m = np.linalg.norm(now[:, :3, 3] - then[:, :3, 3], axis=1).max()
    # |R - R'|_F = 2 sqrt(2) sin(angle / 2), which small angles do not lose in the rounding of a cosine
    chord = np.linalg.norm(now[:, :3, :3] - then[:, :3, :3], axis=(1, 2)).max()
    return float(moved_m), float(2.0 * np.arcsin(min(chord / np.sqrt(8.0), 1.0)))
