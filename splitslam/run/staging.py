"""Results appear in the user's folder when they are complete, or not at all."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from splitslam.errors import InputError
from splitslam.run.processes import undisturbed


class Staging:
    """`work` is thrown away; what is written into `results` goes to `out` by `publish`."""

    def __init__(self, root: Path, out: Path) -> None:
        self.work, self.results, self._out = root / "work", root / "results", out
        self.work.mkdir()
        self.results.mkdir()

    def publish(self) -> None:
        """Move the results into `out`; other files there stay. report.json comes last: with it the rest is there."""
        with undisturbed():
            self._out.mkdir(parents=True, exist_ok=True)
            for path in sorted(self.results.iterdir(), key=lambda path: path.name == "report.json"):
                os.replace(path, self._out / path.name)


@contextmanager
def staging(out: Path) -> Iterator[Staging]:
    """A temporary folder on the file system of `out`. Raises InputError when `out` cannot be written."""
    place = out.absolute()
    while not place.exists():
        place = place.parent
    try:
        root = Path(tempfile.mkdtemp(prefix=".splitslam-", dir=place))
    except OSError as error:
        raise InputError(f"--out {out}: expected a folder that can be written ({error.strerror})") from None
    try:
        yield Staging(root, out)
    finally:
        with undisturbed():
            shutil.rmtree(root, ignore_errors=True)
