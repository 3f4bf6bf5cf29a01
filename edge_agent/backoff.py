"""How long to wait before the next attempt to reach the map service."""

from __future__ import annotations

import random


class Backoff:
    """First retry at once, then full jitter: uniform from 0 to a cap that doubles from `first_s` to `max_s`."""

    def __init__(self, first_s: float, max_s: float, rng: random.Random | None = None) -> None:
        self._first_s, self._max_s = first_s, max_s
        self._rng = rng or random.Random()
        self._retries = 0

    def reset(self) -> None:
        self._retries = 0

    def next_s(self) -> float:
        self._retries += 1
        if self._retries == 1:
            return 0.0
        # the exponent is capped: a day of retries must not overflow a float
        cap_s = min(self._max_s, self._first_s * 2.0 ** min(self._retries - 2, 60))
        return self._rng.uniform(0.0, cap_s)


def jittered(retry_after_s: float) -> float:
    """Not before the service's wish, and spread over as long again: it was said to many robots at once."""
    return random.uniform(retry_after_s, 2.0 * retry_after_s)


def welcome_timeout_s(base_s: float, max_s: float, failures: int) -> float:
    """Twice the base, then doubling: a frozen replica is left quickly, a cold service is given time in the end."""
    return min(max(base_s, max_s), base_s * 2.0 ** min(max(0, failures - 1), 60))
