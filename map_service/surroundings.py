"""The local map goes along with the robot: keyframes come in ahead and go out behind, one of each a scan at most.

So no answer waits for a map that is made anew; that happens only when a correction has bent it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from map_service.clouds import CloudsAwayError, Fetch
from map_service.keyframes import Keyframes
from splitslam.registration.local_map import LocalMap
from splitslam.registration.settings import LocalMapSettings

Array = NDArray[np.float64]
NEWEST = 8  # are kept wherever the robot is: they have still to be described as places


class Surroundings:
    """Which keyframes are in the local map, and whose clouds stay in memory. One for each pipeline."""

    def __init__(self, settings: LocalMapSettings) -> None:
        self.settings = settings
        self.stored: tuple[int, Fetch] | None = None  # keyframes of frames up to that one can be fetched
        self._looked_at_m: Array | None = None
        self._coming: deque[int] = deque()
        self._going: deque[int] = deque()

    def fill(self, centre_m: Array, local_map: LocalMap, keyframes: Keyframes) -> None:
        """The map anew, of all keyframes within the radius of a point (3,) in `local`. Raises CloudsAwayError."""
        near = keyframes.within(centre_m, self.settings.radius_m)
        clouds = keyframes.clouds.get(near)
        local_map.clear()
        for i, cloud in zip(near, clouds, strict=True):
            local_map.insert(i, keyframes.T_local(i), cloud.corners_lidar, cloud.surfs_lidar)
        self.filled(centre_m, keyframes)

    def filled(self, centre_m: Array, keyframes: Keyframes) -> None:
        """The map holds the keyframes within the radius of a point (3,) in `local`."""
        self._looked_at_m = centre_m.copy()
        self._coming.clear()
        self._going.clear()
        self._let_go(centre_m, keyframes)

    def follow(
        self, centre_m: Array, local_map: LocalMap, keyframes: Keyframes, corrected: Callable[[], Array]
    ) -> None:
        """After a scan at centre_m (3,); corrected: where the graph has all keyframes, (n, 4, 4). Both in `local`."""
        s = self.settings
        if self._looked_at_m is None:
            self._looked_at_m = centre_m.copy()
        if not (self._coming or self._going):
            if np.linalg.norm(centre_m - self._looked_at_m) < s.step_m:
                return
            keyframes.place(corrected(), local_map.keyframes)
            self._look(centre_m, local_map, keyframes)
        try:
            for queue, change in ((self._coming, local_map.insert), (self._going, local_map.remove)):
                if queue:
                    (cloud,) = keyframes.clouds.get([queue[0]])
                    change(queue[0], keyframes.T_local(queue[0]), cloud.corners_lidar, cloud.surfs_lidar)
                    queue.popleft()
        except CloudsAwayError:  # tried again with the next scan; until then the map is smaller ahead, or larger behind
            return

    def _look(self, centre_m: Array, local_map: LocalMap, keyframes: Keyframes) -> None:
        s, there = self.settings, local_map.keyframes
        self._looked_at_m = centre_m.copy()
        near, kept = (keyframes.within(centre_m, s.radius_m + more_m) for more_m in (0.0, s.rebuild_distance_m))
        self._coming.extend(i for i in near if i not in there)
        self._going.extend(sorted(there.difference(kept)))
        self._let_go(centre_m, keyframes)

    def _let_go(self, centre_m: Array, keyframes: Keyframes) -> None:
        """Of clouds that are stored and not soon needed."""
        if self.stored is None:
            return
        s, (seq, fetch) = self.settings, self.stored
        soon = keyframes.within(centre_m, s.radius_m + 2.0 * s.rebuild_distance_m)
        below = min(keyframes.up_to_seq(seq), len(keyframes) - NEWEST)
        keyframes.clouds.keep({*soon, *self._going}, below, fetch)
