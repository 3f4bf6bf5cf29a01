"""The scans of one session on their way to somebody who follows it: each once and in order.

The store has every scan, a second late. Answers that a worker of this replica gives come at once, but a session may
move to another replica and back, so what comes live is passed on only where it is known to follow on what was.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

from splitslam.wire import pose_pb2 as pb


@dataclass(frozen=True, slots=True)
class TrackedScan:
    """pose: None of a scan that was rejected."""

    seq: int
    pose: pb.ScanPose | None


class PoseTrack:
    """`last` is the newest scan that was passed on, or left out."""

    def __init__(self, last: int, paced_until: int, backlog: int) -> None:
        """Goes on after scan `last`. Up to `paced_until` nothing is left out; beyond it no more than `backlog` wait."""
        self.last = last
        self._paced_until, self._backlog = paced_until, backlog
        self._live: deque[TrackedScan] = deque()
        self._before: int | None = None  # the answer before the first of `_live`, on the same stream
        self._stream: int | None = None

    def answered(self, stream: int, scan: TrackedScan) -> None:
        """An answer on a robot's stream, all of which come here in order."""
        newest = self._live[-1].seq if self._live else self.last
        if stream != self._stream:
            self._stream = stream
            if scan.seq > newest + 1:  # who knows what was answered elsewhere in between
                self._live.clear()
            if not self._live:
                self._before = None
        if scan.seq > newest:
            self._live.append(scan)
        elif not self._live:
            self._before = scan.seq
        if len(self._live) > self._backlog:
            self._before = self._live.popleft().seq

    def live(self) -> list[pb.ScanPose]:
        """What can be passed on without the store."""
        passed: list[pb.ScanPose] = []
        while self._live and self._live[0].seq <= self.last:
            self._before = self._live.popleft().seq
        while self._live and (self._live[0].seq == self.last + 1 or self._follows()):
            scan = self._live.popleft()
            self._before = self.last = scan.seq
            if scan.pose is not None:
                passed.append(scan.pose)
        return passed

    def _follows(self) -> bool:
        return self._before is not None and self._before <= self.last

    def next_after(self, stored_seq: int) -> int:
        """After which scan to go on, as the store has them up to `stored_seq`: not too far behind."""
        return max(self.last, stored_seq - self._backlog) if self.last >= self._paced_until else self.last

    def leave_out(self, stored_seq: int) -> int:
        """Goes on after `next_after`; returns how many scans that leaves out."""
        before, self.last = self.last, self.next_after(stored_seq)
        return self.last - before

    def stored(self, scans: Iterable[TrackedScan]) -> list[pb.ScanPose]:
        """Scans out of the store, the next ones after `last`, without a gap; then those that were waiting for them."""
        passed: list[pb.ScanPose] = []
        for scan in scans:
            if scan.seq > self.last:
                self.last = scan.seq
                if scan.pose is not None:
                    passed.append(scan.pose)
        return passed + self.live()
