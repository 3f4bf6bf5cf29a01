"""Loop closing in one session: candidates out to the verifier, results back at a fixed number of scans later."""

from __future__ import annotations

from collections import deque
from concurrent.futures import Future

import numpy as np
from numpy.typing import NDArray

from map_service.keyframes import Keyframes
from map_service.loops import LoopJob, LoopResult, LoopVerifier, candidate
from map_service.settings import LoopSettings
from splitslam import se3

Array = NDArray[np.float64]


class LoopCloser:
    """Looks for a candidate at each keyframe; `due` waits for what must be applied now, so that runs repeat exactly."""

    def __init__(self, settings: LoopSettings, verifier: LoopVerifier) -> None:
        self.settings, self.verifier = settings, verifier
        self.last_used = -1
        self.rejected: dict[str, int] = {}
        self._pending: deque[tuple[int, Future[LoopResult]]] = deque()

    def look(self, seq: int, keyframes: Keyframes, poses: list[Array]) -> None:
        """Submits the newest keyframe's candidate, if it has one; `seq` is its frame."""
        s = self.settings
        newest = len(keyframes) - 1
        positions = np.array([T[:3, 3] for T in poses])
        older = candidate(positions, keyframes.stamps_ns(), newest, self.last_used, s)
        if older is None:
            return
        self.last_used = newest
        job = LoopJob(
            older,
            newest,
            keyframes.submap(older, older - s.target_keyframes, older + s.target_keyframes, poses),
            keyframes.submap(newest, newest - s.source_keyframes, newest, poses),
            se3.inv(poses[older]) @ poses[newest],
            s,
        )
        self._pending.append((seq + s.apply_after_frames, self.verifier.submit(job)))

    def due(self, seq: int, everything: bool = False) -> list[LoopResult]:
        """Accepted results whose frame has come; rejected ones are counted by reason."""
        accepted = []
        while self._pending and (everything or self._pending[0][0] <= seq):
            result = self._pending.popleft()[1].result()
            if result.accepted:
                accepted.append(result)
            else:
                self.reject(result.reason)
        return accepted

    def reject(self, reason: str) -> None:
        """Counts a candidate that becomes no factor."""
        self.rejected[reason] = self.rejected.get(reason, 0) + 1
