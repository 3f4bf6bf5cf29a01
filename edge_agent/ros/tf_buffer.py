"""Transforms of other nodes: the newest seconds of each, by the frame that they place."""

from __future__ import annotations

import threading
from bisect import bisect_left
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitslam import se3

Array = NDArray[np.float64]
_KEPT_NS = 10_000_000_000
_MOST_FRAMES = 2000  # trackers of objects name a new frame for each: those not heard of for longest go
_DEEPEST = 64  # frames between a frame and its root: more is a circle


def transform_of(message: Any) -> Array | None:
    """geometry_msgs/Transform -> (4, 4), None for one that is no rigid transform."""
    t, q = message.translation, message.rotation
    position_m, quat = np.array([t.x, t.y, t.z]), np.array([q.x, q.y, q.z, q.w])
    if not (np.isfinite(position_m).all() and np.isfinite(quat).all() and abs(quat @ quat - 1.0) < 0.02):
        return None
    return se3.from_quat(position_m, quat)


@dataclass(slots=True)
class _Edge:
    """Where a frame is in its parent. stamps_ns: increasing; empty for a fixed place, which then is poses[0]."""

    parent: str
    stamps_ns: list[int] = field(default_factory=list)
    poses: list[Array] = field(default_factory=list)  # T_parent_child

    def at(self, stamp_ns: int) -> Array | None:
        """T_parent_child (4, 4), interpolated; None outside of what is known."""
        if not self.stamps_ns:
            return self.poses[0]
        after = bisect_left(self.stamps_ns, stamp_ns)
        if after == len(self.stamps_ns):
            return None
        if self.stamps_ns[after] == stamp_ns:
            return self.poses[after]
        if after == 0:
            return None
        start_ns, end_ns = self.stamps_ns[after - 1], self.stamps_ns[after]
        return se3.interpolate(self.poses[after - 1], self.poses[after], (stamp_ns - start_ns) / (end_ns - start_ns))


class TfBuffer:
    """The tree of frames as far as it has been heard of; may be filled and asked from different threads."""

    def __init__(self) -> None:
        self._edges: dict[str, _Edge] = {}  # those that moved last at the end
        self._lock = threading.Lock()

    def add(self, parent: str, child: str, stamp_ns: int, T_parent_child: Array, fixed: bool = False) -> None:
        """One transform (4, 4); a stamp older than the last is a clock set back: what was before is forgotten."""
        parent, child = parent.lstrip("/"), child.lstrip("/")
        with self._lock:
            edge = self._edges.get(child)
            if edge is None or edge.parent != parent or fixed or not edge.stamps_ns or stamp_ns < edge.stamps_ns[-1]:
                edge = self._edges[child] = _Edge(parent)
            self._bound()
            if fixed:
                edge.poses = [T_parent_child]
                return
            self._edges[child] = self._edges.pop(child)
            if edge.stamps_ns and edge.stamps_ns[-1] == stamp_ns:
                edge.poses[-1] = T_parent_child
                return
            edge.stamps_ns.append(stamp_ns)
            edge.poses.append(T_parent_child)
            old = bisect_left(edge.stamps_ns, stamp_ns - _KEPT_NS)
            del edge.stamps_ns[:old], edge.poses[:old]

    def _bound(self) -> None:
        if len(self._edges) > _MOST_FRAMES:
            moving = (child for child, edge in self._edges.items() if edge.stamps_ns)
            del self._edges[next(moving, next(iter(self._edges)))]

    def lookup(self, target: str, source: str, stamp_ns: int = 0) -> Array | None:
        """T_target_source (4, 4) at a time; None when the tree does not say. stamp_ns: any, between fixed frames."""
        target, source = target.lstrip("/"), source.lstrip("/")
        with self._lock:
            above_source = self._way_up(source, target, stamp_ns)
            if target in above_source:
                return above_source[target]
            above_target = self._way_up(target, source, stamp_ns)
        for frame, T_frame_source in above_source.items():
            if frame in above_target:
                return se3.inv(above_target[frame]) @ T_frame_source
        return None

    def newest_ns(self, child: str) -> int | None:
        """Of the moving frames between `child` and its root, up to when all of them are known."""
        newest: list[int] = []
        with self._lock:
            frame = child.lstrip("/")
            for _ in range(_DEEPEST):
                edge = self._edges.get(frame)
                if edge is None:
                    break
                newest += edge.stamps_ns[-1:]
                frame = edge.parent
        return min(newest, default=None)

    def parent(self, child: str) -> str | None:
        """The frame that `child` hangs on."""
        with self._lock:
            edge = self._edges.get(child.lstrip("/"))
            return None if edge is None else edge.parent

    def _way_up(self, frame: str, until: str, stamp_ns: int) -> dict[str, Array]:
        """T_ancestor_frame of `frame` and its ancestors as far as `until`, the root, or where nothing is known."""
        way = {frame: np.eye(4)}
        T = way[frame]
        for _ in range(_DEEPEST):
            edge = self._edges.get(frame)
            step = None if edge is None or frame == until else edge.at(stamp_ns)
            if edge is None or step is None:
                break
            frame, T = edge.parent, step @ T
            way[frame] = T
        return way
