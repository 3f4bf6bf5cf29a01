"""The wall clock of the stack and of the agents, which a test may set."""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_HOOK = Path(__file__).with_name("wall_clock")


class WallClock:
    """What programs started inside `wall_clock` take for the time is the real one plus `shift`."""

    def __init__(self, file: Path) -> None:
        self._file = file
        self.shift(0.0)

    def shift(self, seconds: float) -> None:
        """From now on; in place, since the programs have the file mapped."""
        with self._file.open("r+b" if self._file.exists() else "wb") as file:
            file.write(struct.pack("d", seconds))


@contextmanager
def wall_clock(file: Path) -> Iterator[WallClock]:
    """For every Python program that is started inside the block."""
    clock = WallClock(file)
    before = {name: os.environ.get(name) for name in ("PYTHONPATH", "CHAOS_CLOCK")}
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, (str(_HOOK), before["PYTHONPATH"])))
    os.environ["CHAOS_CLOCK"] = str(file)
    try:
        yield clock
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
