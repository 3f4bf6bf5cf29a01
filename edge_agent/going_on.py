"""How an agent goes on with a run that another began: where its own part starts, and what nobody has seen.

`odom` begins anew at this agent's first scan, as every agent's does. The map service's frame goes on.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field

from edge_agent.imu.unseen import unseen
from edge_agent.sources import TimedEvent
from edge_agent.sources.time_map import shifted
from edge_agent.types import MotionSource
from splitslam.features import Motion
from splitslam.logs import fields
from splitslam.scan import GnssFix, ImuSamples, Scan, WheelSamples

_log = logging.getLogger(__name__)

_SECOND_NS = 1_000_000_000
_LEAD_NS = 500_000_000  # of samples before the first own scan, to level the robot by


@dataclass(slots=True)
class StartAfter:
    """The last frame of the agent before: its seq and stamp. skipped: scans of a recording up to there, read again.

    live: scans up to there are none that were read before, but of a clock that was set back meanwhile: stamps go on
    from a second after that frame. Until the first of them tells by how much, other sensors' messages have no place in
    the run: `dropped` counts them.
    """

    seq: int
    stamp_ns: int
    live: bool = False
    skipped: int = 0
    dropped: Counter[str] = field(default_factory=Counter)

    def events(self, events: Iterator[TimedEvent | None]) -> Iterator[TimedEvent | None]:
        """What a source holds after that frame, and the samples just before it."""
        set_back_ns, first = 0, True
        for timed in events:
            if timed is None:
                yield None
                continue
            arrival_ns, event = timed[0], shifted(timed[1], set_back_ns)
            if isinstance(event, Scan):
                if event.stamp_ns <= self.stamp_ns and self.live and first:
                    set_back_ns = self.stamp_ns + _SECOND_NS - event.stamp_ns
                    _log.warning("clock set back since the agent before", extra=fields(by_s=set_back_ns * 1e-9))
                    event = shifted(event, set_back_ns)
                elif event.stamp_ns <= self.stamp_ns and not self.live:
                    self.skipped += 1
                    continue
                first = False
            else:
                newest_ns = event.stamp_ns if isinstance(event, GnssFix) else int(event.stamps_ns[-1])
                if newest_ns <= self.stamp_ns - _LEAD_NS:
                    if self.live:
                        self._drop(event)
                    continue
            yield arrival_ns, event

    def _drop(self, event: ImuSamples | WheelSamples | GnssFix) -> None:
        if isinstance(event, GnssFix):
            self.dropped["gnss_time_backwards"] += 1
        else:
            kind = "imu" if isinstance(event, ImuSamples) else "wheel"
            self.dropped[f"{kind}_time_backwards"] += len(event.stamps_ns)


class UnseenMotion:
    """A MotionSource that knows that its node has not seen how the robot came to its first scan."""

    def __init__(self, node: MotionSource, after_ns: int) -> None:
        """after_ns: stamp of the last frame of the agent before."""
        self._node = node
        self._after_ns: int | None = after_ns

    def motion_over(self, start_ns: int, end_ns: int) -> Motion:
        """See MotionSource; the first motion holds what the scan itself shows of it, and doubt."""
        motion = self._node.motion_over(start_ns, end_ns)
        if self._after_ns is None:
            return motion
        gap_s, self._after_ns = max((start_ns - self._after_ns) * 1e-9, 1e-3), None
        return unseen(motion, gap_s)
