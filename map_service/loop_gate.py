"""Which verified loops may enter the graph.

Clouds that fit are no proof of a revisit: a second corridor like the first one fits as well. What is known besides
is how far odometry drifts. A loop that corrects no more than the usual drift enters at once. One that corrects more
waits until others, from other places, say the same: loops are compared in pairs through the odometry between them
(Mangelson et al., "Pairwise consistent measurement set maximization", ICRA 2018). What no drift explains is refused.
"""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from map_service.loops import LoopResult
from map_service.settings import LoopGateSettings
from splitslam import se3

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Chain:
    """The graph as the gate sees it: T_map_lidar of the keyframes, the way to each (n,), m, and the loops in it.

    branches: (keyframe, the one that it follows instead of the last, m between them), see Keyframes.
    """

    poses: Sequence[Array]
    way_m: Array
    loops: list[tuple[int, int]]
    branches: list[tuple[int, int, float]] = field(default_factory=list)

    def tied_m(self, a: int, b: int) -> float:
        """Length of the shortest way in the graph from keyframe a to b: along the drive or through loops."""
        ends = [k for pair in self.loops for k in pair] + [k for *pair, _ in self.branches for k in pair]
        nodes, begins = np.unique([a, b, *ends]).tolist(), {begin for begin, *_ in self.branches}
        edges: dict[int, list[tuple[int, float]]] = {k: [] for k in nodes}
        steps = [(i, j, float(self.way_m[j] - self.way_m[i])) for i, j in pairwise(nodes) if j not in begins]
        for i, j, length in steps + self.branches + [(i, j, 0.0) for i, j in self.loops]:
            edges[i].append((j, length))
            edges[j].append((i, length))
        best, queue = {a: 0.0}, [(0.0, a)]
        while queue:
            so_far, k = heapq.heappop(queue)
            if k == b:
                return so_far
            if so_far > best[k]:
                continue
            for j, length in edges[k]:
                if so_far + length < best.get(j, np.inf):
                    best[j] = so_far + length
                    heapq.heappush(queue, (best[j], j))
        raise AssertionError("the drive joins all keyframes")


@dataclass(frozen=True, slots=True, eq=False)
class Admitted:
    """A loop that enters the graph, and how much it may correct, m: the width of its robust kernel."""

    loop: LoopResult
    correction_m: float


class LoopGate:
    """Admits, keeps waiting or refuses; `refused` counts by reason."""

    def __init__(self, settings: LoopGateSettings) -> None:
        self.settings = settings
        self.refused: dict[str, int] = {}
        self.waiting: list[LoopResult] = []
        self.last_doubt = -1  # newest keyframe that fitted in more than one way

    def take(self, loop: LoopResult, chain: Chain) -> list[Admitted]:
        """The loops that may enter now because of this result: none, it, or it and those that waited for it."""
        if not loop.accepted:
            self.refuse(loop.reason)
        if not loop.distinct and loop.reason in ("", "ambiguous"):
            self.last_doubt = max(self.last_doubt, loop.newer)
        self._forget(chain)
        entering = self._offer(loop, chain) if loop.accepted else []
        return entering + self._now_usual(chain)

    def _offer(self, loop: LoopResult, chain: Chain) -> list[Admitted]:
        s = self.settings
        surprise, drift_m, off_m = self._surprise(loop, chain)
        if surprise <= self._limit(loop, chain):
            return [Admitted(loop, drift_m)]
        if surprise > s.extreme:
            self.refuse("implausible")
        elif not loop.distinct:
            self.refuse("ambiguous")
        else:
            self.waiting.append(loop)
            agreeing = self._agreeing(loop, chain)
            if self._enough(agreeing, chain):
                self.waiting = [w for w in self.waiting if all(w is not a for a in agreeing)]
                return [Admitted(a, off_m + drift_m) for a in agreeing]
        return []

    def _surprise(self, loop: LoopResult, chain: Chain) -> tuple[float, float, float]:
        """How often the usual drift a loop would correct; that drift, and the correction, m."""
        s = self.settings
        off = se3.inv(loop.T_older_newer) @ se3.inv(chain.poses[loop.older]) @ chain.poses[loop.newer]
        tied_m = chain.tied_m(loop.older, loop.newer)
        drift_m = self.usual_drift_m(tied_m)
        turn_rad = s.turn_floor_rad + s.turn_per_m * tied_m
        off_m = float(np.linalg.norm(off[:3, 3]))
        return max(off_m / drift_m, se3.angle(off) / turn_rad), drift_m, off_m

    def usual_drift_m(self, way_m: float) -> float:
        """What the odometry may be off by after a way, and nobody wonders."""
        return self.settings.drift_floor_m + self.settings.drift_share * way_m

    def _limit(self, loop: LoopResult, chain: Chain) -> float:
        """The surprise up to which a loop is believed by itself: less where places repeat themselves."""
        return 1.0 if self._clear(loop, chain) else self.settings.open_extreme

    def _clear(self, loop: LoopResult, chain: Chain) -> bool:
        """Is there one way only to lay it, as for all results from shortly before it until now?"""
        doubt_m = -np.inf if self.last_doubt < 0 else chain.way_m[self.last_doubt]
        return loop.distinct and bool(doubt_m < chain.way_m[loop.newer] - self.settings.quiet_m)

    def _now_usual(self, chain: Chain) -> list[Admitted]:
        """Waiting loops that the graph, corrected by others, has come to agree with."""
        entering, kept = [], []
        for loop in self.waiting:
            surprise, drift_m, _ = self._surprise(loop, chain)
            if surprise <= self._limit(loop, chain):
                entering.append(Admitted(loop, drift_m))
            else:
                kept.append(loop)
        self.waiting = kept
        return entering

    def _enough(self, agreeing: list[LoopResult], chain: Chain) -> bool:
        """Enough loops, over a long enough way?"""
        way_m = [float(chain.way_m[a.newer]) for a in agreeing]
        return len(agreeing) >= self.settings.support and max(way_m) - min(way_m) >= self.settings.span_m

    def close(self) -> None:
        """End of the drive: what still waits has not found support."""
        for _ in self.waiting:
            self.refuse("unsupported")
        self.waiting = []

    def refuse(self, reason: str) -> None:
        """Counts a candidate that becomes no factor."""
        self.refused[reason] = self.refused.get(reason, 0) + 1

    def _forget(self, chain: Chain) -> None:
        kept = [w for w in self.waiting if chain.way_m[-1] - chain.way_m[w.newer] <= self.settings.forget_m]
        for _ in range(len(self.waiting) - len(kept)):
            self.refuse("unsupported")
        self.waiting = kept

    def _agreeing(self, loop: LoopResult, chain: Chain) -> list[LoopResult]:
        """This loop and waiting ones before it, each of which agrees with the next: drift between them adds up."""
        agreeing = [loop] if self._clear(loop, chain) else []
        for other in reversed(self.waiting):
            if agreeing and self._clear(other, chain) and self._agree(other, agreeing[-1], chain):
                agreeing.append(other)
        return agreeing

    def _agree(self, a: LoopResult, b: LoopResult, chain: Chain) -> bool:
        """Does the way round through both loops lead back, and do they join different places?"""
        s, poses = self.settings, chain.poses
        newer_m = abs(float(chain.way_m[a.newer] - chain.way_m[b.newer]))
        older_m = abs(float(chain.way_m[a.older] - chain.way_m[b.older]))
        if min(newer_m, older_m) < s.apart_m:
            return False
        around = (
            a.T_older_newer
            @ (se3.inv(poses[a.newer]) @ poses[b.newer])
            @ se3.inv(b.T_older_newer)
            @ (se3.inv(poses[b.older]) @ poses[a.older])
        )
        limit_m = s.pair_floor_m + s.pair_share * (newer_m + older_m)
        limit_rad = s.pair_floor_rad + s.pair_turn_per_m * (newer_m + older_m)
        return float(np.linalg.norm(around[:3, 3])) < limit_m and se3.angle(around) < limit_rad

    def dump(self) -> dict:
        """All that must survive a restart (JSON)."""
        waiting = [
            {
                "older": w.older,
                "newer": w.newer,
                "T_older_newer": w.T_older_newer.tolist(),
                "covariance": w.covariance.tolist(),
                "by_looks": w.by_looks,
                "inlier_share": w.inlier_share,
                "rms_m": w.rms_m,
            }
            for w in self.waiting
        ]
        return {"refused": self.refused, "waiting": waiting, "last_doubt": self.last_doubt}

    def load(self, data: dict) -> None:
        """The reverse of dump."""
        self.refused, self.last_doubt = dict(data["refused"]), int(data["last_doubt"])
        self.waiting = [
            replace(
                LoopResult(**{**w, "reason": "", "distinct": True}),
                T_older_newer=np.array(w["T_older_newer"]),
                covariance=np.array(w["covariance"]),
            )
            for w in data["waiting"]
        ]
