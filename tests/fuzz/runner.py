"""One target for a while: what it took, what it refused, how slow it was, how memory went."""

from __future__ import annotations

import pickle
import resource
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tests.fuzz.target import Target

MAX_S = 5.0  # for one input, on a busy machine
MAX_GROWTH_BYTES = 48 << 20  # from the warm state on; one object of a hundred bytes kept by each input shows at once
WARM = 0.2


@dataclass(frozen=True, slots=True)
class Outcome:
    """growth_bytes: resident memory at the end less that after the first fifth."""

    name: str
    taken: int
    refused: int
    slowest_s: float
    growth_bytes: int
    peak_bytes: int

    def check(self) -> None:
        """Raises AssertionError for hangs and growth, and for a target that only ever says one thing."""
        assert self.slowest_s < MAX_S, self
        assert self.growth_bytes < MAX_GROWTH_BYTES, self
        assert self.taken, self
        assert self.refused or self.name == "spool files", self  # a spool takes any file and names its damage


def run(target: Target, going_on: Callable[[int], float], seed: int, last: Path | None = None) -> Outcome:
    """going_on: number of inputs so far -> share of the whole that is done. last: gets each input before it is fed.

    Raises whatever the target raises besides its refusals: a defect.
    """
    rng = np.random.default_rng(seed)
    counts = {True: 0, False: 0}
    slowest_s, warm_bytes, done = 0.0, None, 0.0
    while done < 1.0:
        given: Any = target.make(rng)
        if last is not None:
            last.write_bytes(pickle.dumps(given))
        start_s = time.perf_counter()
        counts[target.takes(given)] += 1
        slowest_s = max(slowest_s, time.perf_counter() - start_s)
        done = going_on(sum(counts.values()))
        if warm_bytes is None and done >= WARM:
            warm_bytes = rss_bytes()
    growth_bytes = rss_bytes() - (warm_bytes or 0)
    peak_bytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    return Outcome(target.name, counts[True], counts[False], slowest_s, growth_bytes, peak_bytes)


def rss_bytes() -> int:
    """Resident memory of this process."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()
