"""Where `map` lies against the two frames that corrections leave alone: the tracker's `local` and the service's `odom`.

Once corrected keyframes no longer lie where the local map has their points, that map is made anew, and `local` becomes
`map`. A map of hundreds of keyframes takes as long as twenty scans. So it grows beside the one in use, a part after
each scan, and no robot of the worker waits for another one's loop; what is in use is as good in itself as it was.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from map_service.clouds import CloudsAwayError
from map_service.growing import Poses
from map_service.keyframes import Keyframes
from map_service.settings import PipelineSettings
from map_service.surroundings import Surroundings
from map_service.tracker import Tracker
from splitslam import se3
from splitslam.registration.local_map import LocalMap

Array = NDArray[np.float64]


@dataclass(slots=True, eq=False)
class _Renewal:
    """A local map on its way. Its frame `new` is `map` as it was when this began.

    T_new_local, T_map_new: (4, 4); corrections go on meanwhile. poses: T_new_lidar of keyframes that are in it or will
    be. waiting: those that are not yet. centre_m: (3,) in `new`, around which they were chosen.
    """

    local_map: LocalMap
    T_new_local: Array
    centre_m: Array
    poses: dict[int, Array]
    waiting: deque[int]
    T_map_new: Array = field(default_factory=lambda: np.eye(4))


class MapFrame:
    """T_map_local, T_map_odom: (4, 4).

    Of what is passed, keyframes are the session's, and `poses` are theirs in `map`, by the graph of now.
    """

    def __init__(self, settings: PipelineSettings, surroundings: Surroundings) -> None:
        self.T_map_local = np.eye(4)
        self.T_map_odom = np.eye(4)
        self._graph, self._local = settings.graph, settings.tracker.local_map
        self._surroundings = surroundings
        self._renewal: _Renewal | None = None

    @property
    def renewing(self) -> bool:
        """Is a local map on its way?"""
        return self._renewal is not None

    def poses_local(self, poses: Poses) -> Array:
        """(n, 4, 4): the keyframes in `local`, where the graph has them."""
        return se3.inv(self.T_map_local) @ poses.matrices

    def jump(self, T_found_carried: Array) -> None:
        """The robot stands elsewhere in `local` than it was carried: `odom` goes on, and `map` jumps against it."""
        jump = self.T_map_local @ T_found_carried @ se3.inv(self.T_map_local)
        self.T_map_odom = se3.orthonormalised(jump @ self.T_map_odom)

    def correct(self, here: int, keyframes: Keyframes, poses: Poses) -> Array:
        """Takes over where the graph has keyframe `here` now; by how much that has moved, (4, 4) in its own frame."""
        T_before = self.T_map_local @ keyframes.T_local(here)
        delta = poses[here] @ se3.inv(T_before)
        self.T_map_local = se3.orthonormalised(delta @ self.T_map_local)
        self.T_map_odom = se3.orthonormalised(delta @ self.T_map_odom)
        if self._renewal is not None:
            self._renewal.T_map_new = se3.orthonormalised(delta @ self._renewal.T_map_new)
        return se3.inv(T_before) @ poses[here]

    def renew_if_bent(self, tracker: Tracker, keyframes: Keyframes, poses: Poses) -> None:
        """Begins to make the local map anew if it has to be, unless that goes on already."""
        if self._renewal is None and self._bent(tracker.local_map, keyframes, poses):
            self.renew(tracker, keyframes, poses)

    def _bent(self, local_map: LocalMap, keyframes: Keyframes, poses: Poses) -> bool:
        """Do the corrected keyframes no longer lie where the local map has their points?"""
        s, inserted = self._graph, sorted(local_map.keyframes)
        then, now = keyframes.poses_local()[inserted], self.poses_local(poses)[inserted]
        off_m = np.linalg.norm(now[:, :3, 3] - then[:, :3, 3], axis=1)
        cosine = (np.einsum("nij,nij->n", now[:, :3, :3], then[:, :3, :3]) - 1.0) / 2.0
        return bool((off_m > s.rebuild_m).any() or (cosine < np.cos(s.rebuild_rad)).any())

    def renew(self, tracker: Tracker, keyframes: Keyframes, poses: Poses) -> None:
        """Begins to make the local map anew, from the keyframes around the robot; a small one is done at once."""
        state, old = tracker.state, tracker.local_map
        assert state is not None
        here_m = (self.T_map_local @ state.T_local_lidar)[:3, 3]
        near = np.flatnonzero(np.linalg.norm(poses.positions_m - here_m, axis=1) < self._local.radius_m).tolist()
        local_map = LocalMap(self._local, (len(old.corners.slots), len(old.surfs.slots)))
        there = {i: poses[i] for i in near}
        self._renewal = _Renewal(local_map, self.T_map_local, here_m, there, deque(near))
        self.go_on(tracker, keyframes, poses)

    def added(self, index: int, T_local_lidar: Array) -> None:
        """A keyframe has come into the local map in use."""
        if (r := self._renewal) is not None:
            r.poses[index] = r.T_new_local @ T_local_lidar
            r.waiting.append(index)

    def go_on(self, tracker: Tracker, keyframes: Keyframes, poses: Poses) -> None:
        """The next part of the map on its way, if there is one; with the last part it takes the old one's place.

        While clouds are away the old map stays: the next correction asks again.
        """
        if (r := self._renewal) is None:
            return
        left = self._graph.rebuild_points
        try:
            while r.waiting and left > 0:
                i = r.waiting[0]
                (cloud,) = keyframes.clouds.get([i])
                r.local_map.insert(i, r.poses[i], cloud.corners_lidar, cloud.surfs_lidar)
                left -= cloud.count
                r.waiting.popleft()
        except CloudsAwayError:
            self._renewal = None
            return
        if not r.waiting:
            self._renewal = None
            self._replace(r, tracker, keyframes, poses)

    def _replace(self, r: _Renewal, tracker: Tracker, keyframes: Keyframes, poses: Poses) -> None:
        """`local` becomes `new`."""
        tracker.move(r.T_new_local)
        self.T_map_local = r.T_map_new
        tracker.local_map.become(r.local_map)
        now = self.poses_local(poses)
        for i in r.local_map.keyframes:
            now[i] = r.poses[i]
        keyframes.place(now, set())
        self._surroundings.filled(r.centre_m, keyframes)
