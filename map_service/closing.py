"""Loop closing in one session: candidates out to the verifier, results back at a fixed number of scans later."""

from __future__ import annotations

from collections import deque
from concurrent.futures import BrokenExecutor, CancelledError, Future
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from map_service.keyframes import Keyframes
from map_service.loops import LoopJob, LoopResult, LoopVerifier, candidate
from map_service.settings import LoopSettings
from splitslam import se3

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class _Pending:
    due_seq: int
    older: int
    newer: int
    future: Future[LoopResult]


class LoopCloser:
    """Looks for a candidate at each keyframe; `due` waits for what must be applied now, so that runs repeat exactly."""

    def __init__(self, settings: LoopSettings, verifier: LoopVerifier) -> None:
        self.settings, self.verifier = settings, verifier
        self.last_used = -1
        self.rejected: dict[str, int] = {}
        self._pending: deque[_Pending] = deque()

    def look(self, seq: int, keyframes: Keyframes, poses: list[Array]) -> None:
        """Submits the newest keyframe's candidate, if it has one; `seq` is its frame."""
        s = self.settings
        newest = len(keyframes) - 1
        positions = np.array([T[:3, 3] for T in poses])
        older = candidate(positions, keyframes.stamps_ns(), newest, self.last_used, s)
        if older is None:
            return
        self.last_used = newest
        self._submit(seq + s.apply_after_frames, older, newest, keyframes, poses)

    def _submit(self, due_seq: int, older: int, newer: int, keyframes: Keyframes, poses: list[Array]) -> None:
        s = self.settings
        job = LoopJob(
            older,
            newer,
            keyframes.submap(older, older - s.target_keyframes, older + s.target_keyframes, poses),
            keyframes.submap(newer, newer - s.source_keyframes, newer, poses),
            se3.inv(poses[older]) @ poses[newer],
            s,
        )
        self._pending.append(_Pending(due_seq, older, newer, self.verifier.submit(job)))

    def due(self, seq: int, everything: bool = False) -> list[LoopResult]:
        """Accepted results whose frame has come; rejected ones are counted by reason."""
        accepted = []
        while self._pending and (everything or self._pending[0].due_seq <= seq):
            try:
                result = self._pending.popleft().future.result()
            except (BrokenExecutor, CancelledError):  # the pool died: a loop is lost, the session is not
                self.reject("verifier_died")
                continue
            if result.accepted:
                accepted.append(result)
            else:
                self.reject(result.reason)
        return accepted

    def dump(self) -> dict:
        """All that must survive a restart (JSON); verifications under way are to be asked for again."""
        pending = [[p.due_seq, p.older, p.newer] for p in self._pending]
        return {"last_used": self.last_used, "rejected": self.rejected, "pending": pending}

    def load(self, data: dict, keyframes: Keyframes, poses: list[Array]) -> None:
        """The reverse of dump, once keyframes and poses are there."""
        self.last_used, self.rejected = int(data["last_used"]), dict(data["rejected"])
        for due_seq, older, newer in data["pending"]:
            self._submit(due_seq, older, newer, keyframes, poses)

    def reject(self, reason: str) -> None:
        """Counts a candidate that becomes no factor."""
        self.rejected[reason] = self.rejected.get(reason, 0) + 1
