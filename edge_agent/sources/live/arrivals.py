"""When something came: on a clock that looks like the Unix time at the start of the run, and never steps."""

from __future__ import annotations

import time

_FRESH_NS = 1_000_000_000  # the kernel's stamp of a packet is no older, unless somebody set the wall clock meanwhile


class ArrivalClock:
    """offset_ns: what is added to the monotonic clock."""

    def __init__(self) -> None:
        self.offset_ns = _wall_ahead_ns()

    def now_ns(self) -> int:
        """Now."""
        return time.monotonic_ns() + self.offset_ns

    def of_wall_ns(self, wall_ns: int) -> int:
        """Of the kernel's wall clock stamp of something that came just now."""
        now_ns = self.now_ns()
        came_ns = wall_ns - _wall_ahead_ns() + self.offset_ns
        return came_ns if now_ns - _FRESH_NS <= came_ns <= now_ns else now_ns


def _wall_ahead_ns() -> int:
    """The wall clock against the monotonic one, in the tightest of three looks."""
    looks = []
    for _ in range(3):
        before_ns = time.monotonic_ns()
        wall_ns = time.time_ns()
        after_ns = time.monotonic_ns()
        looks.append((after_ns - before_ns, wall_ns - (before_ns + after_ns) // 2))
    return min(looks)[1]
