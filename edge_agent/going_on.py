"""How an agent goes on with a run that another began: where its own part starts, and what nobody has seen.

`odom` begins anew at this agent's first scan, as every agent's does. The map service's frame goes on.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from edge_agent.sources import TimedEvent
from edge_agent.sources.time_map import shifted
from edge_agent.types import MotionSource
from splitslam import se3
from splitslam.features import Motion
from splitslam.logs import fields
from splitslam.scan import GnssFix, Scan

_log = logging.getLogger(__name__)

_SECOND_NS = 1_000_000_000
_LEAD_NS = 500_000_000  # of samples before the first own scan, to level the robot by
_STEADY_S = 0.3  # so long a turn is taken to go on as it is; beyond, nothing is known of it
_RATE_RADPS, _SPEED_MPS = 1.5, 10.0  # what a robot may do unseen, 1 sigma
_LARGEST_RAD = 3.0


@dataclass(slots=True)
class StartAfter:
    """The last frame of the agent before: its seq and stamp. skipped: scans of a recording up to there, read again.

    live: scans up to there are none that were read before, but of a clock that was set back meanwhile: stamps go on
    from a second after that frame.
    """

    seq: int
    stamp_ns: int
    live: bool = False
    skipped: int = 0

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
                    continue
            yield arrival_ns, event


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
        return _unseen(motion, gap_s)


def _unseen(motion: Motion, gap_s: float) -> Motion:
    """`motion` after a time in which nobody measured: turned as the scan shows, the way left to the map service.

    The service adds its own last velocity where the edge says that it knows none, and holds it to what accelerations
    allow (map_service/scan_alignment.py).
    """
    knots = motion.knots
    scan_s = float(knots.offsets_ns[-1] - knots.offsets_ns[0]) * 1e-9
    rate_radps = (knots.rotation[-1] - knots.rotation[0]) / scan_s
    turn = np.concatenate([rate_radps * min(gap_s, _STEADY_S), np.zeros(3)])
    sigma_rad, sigma_m = min(_RATE_RADPS * gap_s, _LARGEST_RAD), _SPEED_MPS * gap_s
    covariance = np.diag(np.repeat([sigma_rad**2, sigma_m**2], 3))
    return replace(motion, T_prev_lidar=se3.exp(turn), covariance=covariance, velocity_known=False)
