"""What is fuzzed: how inputs are made, what they are fed to, and how it may say no."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.fuzz.mutate import Rng


@dataclass(frozen=True)
class Target:
    """`make` makes one input; `feed` takes it and raises one of `refusals`, or nothing, or it has a defect.

    make and feed may keep files in `folder`.
    """

    name: str
    make: Callable[[Rng], Any]
    feed: Callable[[Any], None]
    refusals: tuple[type[Exception], ...]
    close: Callable[[], None] = field(default=lambda: None)

    def takes(self, given: Any) -> bool:
        """Whether it was taken; False: refused."""
        try:
            self.feed(given)
        except self.refusals:
            return False
        return True


def scratch() -> tuple[Path, Callable[[], None]]:
    """A folder for files, in memory where there is such a place, and what removes it."""
    memory = Path("/dev/shm")
    folder = tempfile.TemporaryDirectory(dir=memory if memory.is_dir() else None)
    return Path(folder.name), folder.cleanup
