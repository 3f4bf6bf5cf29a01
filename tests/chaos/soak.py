"""The soak: light robots for as long as asked, one random fault every 20 s, memory watched."""

from __future__ import annotations

import random
import threading
import time
from collections.abc import Callable

from tests.chaos.faults import RANDOM
from tests.chaos.field import Field
from tests.chaos.invariants import family, memory_bounded, rss_bytes
from tests.chaos.sequence import Outcome, inflict

EVERY_S = 20.0
_SAMPLE_S = 5.0


def soak(field: Field, minutes: float, seed: int, say: Callable[[str], None]) -> list[Outcome]:
    """The same seed draws the same faults in the same order."""
    chance = random.Random(seed)
    end_s = time.monotonic() + 60.0 * minutes
    outcomes: list[Outcome] = []
    with Memory(field) as memory:
        while (next_s := time.monotonic() + EVERY_S) < end_s:
            fault = chance.choice(RANDOM)
            field.seed = chance.randrange(2**31)
            field.all_up()
            outcomes.append(inflict(field, fault))
            say(outcomes[-1].line())
            time.sleep(max(0.0, next_s - time.monotonic()))
    field.wrong += memory.wrong()
    return outcomes


class Memory:
    """Resident memory of every process of the rack, sampled inside the block; a restarted one is a new one."""

    def __init__(self, field: Field) -> None:
        self._field = field
        self._samples: dict[tuple[str, int], list[int]] = {}
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._sample, name="memory", daemon=True)

    def __enter__(self) -> Memory:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def _sample(self) -> None:
        while not self._stop.wait(_SAMPLE_S):
            for part in (*self._field.stack.replicas, self._field.stack.envoy):
                for pid in family(part.pid) if part.alive else ():
                    self._samples.setdefault((part.name, pid), []).append(rss_bytes(pid))

    def wrong(self) -> list[str]:
        named = ((f"{name} (process {pid})", samples) for (name, pid), samples in self._samples.items())
        return [line for name, samples in named for line in memory_bounded(name, samples)]

    @property
    def most_bytes(self) -> int:
        """Of any process at any time."""
        return max((max(samples) for samples in self._samples.values()), default=0)
