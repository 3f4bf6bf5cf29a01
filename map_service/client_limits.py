"""What one client may take of a replica: streams at a time, openings and messages a second."""

from __future__ import annotations

import asyncio
import time
from collections import Counter, OrderedDict
from collections.abc import Iterator
from contextlib import contextmanager

from map_service.callers import DeniedError
from map_service.config import ClientLimitsConfig

_CLIENTS = 10_000  # whose openings are remembered; beyond, those who have been quiet longest are forgotten


class Bucket:
    """Takes `rate` a second, `burst` at once."""

    def __init__(self, rate: float, burst: float) -> None:
        self._rate, self._burst = rate, burst
        self._level, self._at_s = burst, time.monotonic()

    def take(self) -> float:
        """One more; how long it is too early, s."""
        now_s = time.monotonic()
        self._level = min(self._burst, self._level + (now_s - self._at_s) * self._rate) - 1.0
        self._at_s = now_s
        return max(0.0, -self._level / self._rate)

    def give_back(self) -> None:
        """The last one was not let through."""
        self._level += 1.0


class ClientLimits:
    """By robot. A client that has not shown a name is not known here: connections are the proxy's to count."""

    def __init__(self, config: ClientLimitsConfig) -> None:
        self._config = config
        self._open: Counter[str] = Counter()
        self._openings: OrderedDict[str, Bucket] = OrderedDict()

    @contextmanager
    def stream(self, robot_id: str) -> Iterator[None]:
        """Around a stream. Raises DeniedError for one too many."""
        c = self._config
        if self._open[robot_id] >= c.streams:
            raise DeniedError("streams", f"{self._open[robot_id]} streams are open, the limit is {c.streams}")
        self._check_opening(robot_id)
        self._open[robot_id] += 1
        try:
            yield
        finally:
            self._open[robot_id] -= 1
            if not self._open[robot_id]:
                del self._open[robot_id]

    def _check_opening(self, robot_id: str) -> None:
        c = self._config
        bucket = self._openings.setdefault(robot_id, Bucket(c.opens_per_s, c.opens_burst))
        self._openings.move_to_end(robot_id)
        if len(self._openings) > _CLIENTS:
            self._openings.popitem(last=False)
        if bucket.take() > 0:
            bucket.give_back()
            raise DeniedError("opens", f"expected at most {c.opens_per_s:g} streams a second")

    def messages(self) -> Bucket:
        """For one stream."""
        return Bucket(self._config.messages_per_s, self._config.messages_burst)


async def wait_turn(bucket: Bucket) -> bool:
    """Whether the message had to wait: nothing more is read of the stream meanwhile, and TCP slows the client down."""
    early_s = bucket.take()
    if early_s > 0:
        await asyncio.sleep(early_s)
    return early_s > 0
