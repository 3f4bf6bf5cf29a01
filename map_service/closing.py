"""Loop closing in one session: candidates out to the verifier, results back at a fixed number of scans later."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Future
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from map_service.clouds import CloudsAwayError
from map_service.keyframes import Keyframes
from map_service.loop_gate import Admitted, Chain, LoopGate
from map_service.loops import LoopJob, LoopResult, LoopVerifier, near_candidate
from map_service.places import PlaceIndex
from map_service.settings import LoopSettings
from splitslam import se3

Array = NDArray[np.float64]
NEAR, LOOKS = "near", "looks"


@dataclass(frozen=True, slots=True, eq=False)
class _Request:
    due_seq: int
    older: int
    newer: int
    by_looks: bool
    T_older_newer: Array


@dataclass(frozen=True, slots=True)
class _Pending:
    request: _Request
    future: Future[LoopResult]


class LoopCloser:
    """Looks for candidates at each keyframe; `due` waits for what must be applied now, so that runs repeat exactly.

    A candidate is near by what the graph knows, or it looks alike and may be anywhere.
    """

    def __init__(self, settings: LoopSettings, verifier: LoopVerifier) -> None:
        self.settings, self.verifier = settings, verifier
        self.places = PlaceIndex(settings.places)
        self.gate = LoopGate(settings.gate)
        self.tried = {NEAR: 0, LOOKS: 0}
        self.last_used = -1
        self._looked_m = 0.0  # way to the place that was compared last
        self._patience_m = settings.spacing_m
        self._pending: deque[_Pending] = deque()
        self._stored_places = 0

    @property
    def rejected(self) -> dict[str, int]:
        """Candidates that became no factor, by reason."""
        return self.gate.refused

    def look(self, seq: int, keyframes: Keyframes, poses: Sequence[Array], loops: list[tuple[int, int]]) -> None:
        """Submits the newest keyframe's candidates, if it has any; `seq` is its frame, `loops` are in the graph."""
        s = self.settings
        newest = len(keyframes) - 1
        positions = np.asarray(poses)[:, :3, 3]
        chain = Chain(poses, keyframes.way_m(), loops, keyframes.branches)
        older = near_candidate(positions, keyframes.stamps_ns(), newest, self.last_used, s)
        if older is not None and chain.tied_m(older, newest) > s.near_way_m:
            self.last_used = newest
            guess = se3.inv(poses[older]) @ poses[newest]
            self._submit(_Request(seq + s.apply_after_frames, older, newest, False, guess), keyframes, poses)
        place = self._describe(keyframes, poses)
        if place is not None:
            self._look_alike(seq, place, keyframes, chain)

    def _describe(self, keyframes: Keyframes, poses: Sequence[Array]) -> int | None:
        """Describes the newest keyframe that has enough others on either side; None: there is no new one."""
        s = self.settings.places
        place = len(self.places)
        if place + s.keyframes >= len(keyframes):
            return None
        points = keyframes.submap(place, s.keyframes, s.keyframes, poses, s.points)
        self._surroundings = (points @ se3.level_rotation(_up(poses[place])).T).astype(np.float32)
        self.places.add(self._surroundings)
        return place

    def _look_alike(self, seq: int, place: int, keyframes: Keyframes, chain: Chain) -> None:
        """Submits the place that looks most like this one, if it may be too far off for a guess."""
        s, stamps = self.settings, keyframes.stamps_ns()
        if not self._astray(chain.way_m[place]):  # nor is any older place
            return
        old = int(np.searchsorted(stamps, stamps[place] - round(s.min_age_s * 1e9)))
        match = self.places.search(self._surroundings, old)
        if match is None or match.likeness < s.likeness:
            return
        wait_m = min(self._patience_m, s.strong_patience_m if match.likeness > s.strong_likeness else s.patience_m)
        if chain.way_m[place] < self._looked_m + wait_m or not self._astray(chain.tied_m(match.older, place)):
            return
        if any((p.request.older, p.request.newer) == (match.older, place) for p in self._pending):
            return
        self._looked_m = float(chain.way_m[place])
        older, newer = (se3.compose(se3.level_rotation(_up(chain.poses[k])), np.zeros(3)) for k in (match.older, place))
        guess = se3.inv(older) @ match.T_older_newer @ newer
        self._submit(_Request(seq + s.apply_after_frames, match.older, place, True, guess), keyframes, chain.poses)

    def _astray(self, way_m: float) -> bool:
        """May the graph be off by more than GICP reaches, after such a way? What is nearer is found from its guess."""
        return self.gate.usual_drift_m(way_m) > self.settings.near_drift_m

    def _submit(self, request: _Request, keyframes: Keyframes, poses: Sequence[Array]) -> None:
        s, r = self.settings, request
        self.tried[LOOKS if r.by_looks else NEAR] += 1
        try:
            target = keyframes.submap(r.older, s.target_keyframes, s.target_keyframes, poses)
            source = keyframes.submap(r.newer, s.source_keyframes, s.source_keyframes, poses)
        except CloudsAwayError:  # the robot goes on without the store, and so without this loop
            self.gate.refuse("store_away")
            return
        job = LoopJob(
            r.older,
            r.newer,
            target,
            source,
            r.T_older_newer,
            _up(poses[r.older]),
            _up(poses[r.newer]),
            r.by_looks,
            s,
        )
        self._pending.append(_Pending(r, self.verifier.submit(job)))

    def has_due(self, seq: int, everything: bool = False) -> bool:
        """Is there anything that `due` has to look at?"""
        return everything or bool(self._pending and self._pending[0].request.due_seq <= seq)

    def due(self, seq: int, chain: Chain, everything: bool = False) -> list[Admitted]:
        """Loops that enter the graph with frame `seq`; with `everything`, the end of the drive, all that ever will."""
        admitted: list[Admitted] = []
        while self._pending and self.has_due(seq, everything):
            pending = self._pending.popleft()
            try:
                result = pending.future.result()
            except (BrokenExecutor, CancelledError):  # the pool died: a loop is lost, the session is not
                self.gate.refuse("verifier_died")
                continue
            if pending.request.by_looks:
                longer_m = min(2 * self._patience_m, self.settings.patience_m)
                self._patience_m = self.settings.spacing_m if result.accepted else longer_m
            admitted += self.gate.take(result, chain)
        if everything:
            self.gate.close()
        return admitted

    def dump(self) -> dict:
        """All that must survive a restart (JSON); verifications under way are to be asked for again."""
        pending = [p.request for p in self._pending]
        return {
            "last_used": self.last_used,
            "looked_m": self._looked_m,
            "patience_m": self._patience_m,
            "tried": self.tried,
            "places": len(self.places),
            "gate": self.gate.dump(),
            "pending": [[r.due_seq, r.older, r.newer, r.by_looks, r.T_older_newer.tolist()] for r in pending],
        }

    def take_places(self) -> list[tuple[int, bytes]]:
        """(keyframe, descriptor) of the places described since the last call."""
        new = range(self._stored_places, len(self.places))
        self._stored_places = len(self.places)
        return [(place, self.places.packed(place)) for place in new]

    def load(self, data: dict, places: list[bytes], keyframes: Keyframes, poses: Sequence[Array]) -> None:
        """The reverse of dump, once keyframes and poses are there; a state of the first release has fewer keys.

        places: descriptors from the store; those that it lacks are made again, for which every cloud is needed.
        """
        self.last_used = int(data["last_used"])
        self._looked_m = float(data.get("looked_m", self._looked_m))
        self._patience_m = float(data.get("patience_m", self._patience_m))
        self.gate.load(data.get("gate", {"refused": data.get("rejected", {}), "waiting": [], "last_doubt": -1}))
        count = int(data.get("places", max(len(keyframes) - self.settings.places.keyframes, 0)))
        for packed in places[:count]:
            self.places.add_packed(packed)
        self._stored_places = len(self.places)
        while len(self.places) < count and self._describe(keyframes, poses) is not None:
            pass
        for due_seq, older, newer, *known in data["pending"]:
            by_looks, guess = (bool(known[0]), np.array(known[1])) if known else (False, None)
            T = se3.inv(poses[older]) @ poses[newer] if guess is None else guess
            self._submit(_Request(due_seq, older, newer, by_looks, T), keyframes, poses)
        self.tried = dict(data.get("tried", self.tried))


def _up(T_map_lidar: Array) -> Array:
    """Against gravity, in the frame of the keyframe, (3,)."""
    return T_map_lidar[2, :3]
