"""What a run shows while it works, on stderr: stdout belongs to the result."""

from __future__ import annotations

from typing import Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bar


class Progress:
    """A bar of what is done, scans unless said otherwise, on a terminal only; notes always."""

    def __init__(self, unit: str = "scans") -> None:
        self._console = Console(stderr=True)
        self._bar = Bar(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn(unit),
            TimeElapsedColumn(),
            console=self._console,
            transient=True,
            disable=not self._console.is_terminal,
        )
        self._task = self._bar.add_task("", total=None)

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def stage(self, text: str) -> None:
        """What is being done now."""
        self._bar.update(self._task, description=text)

    def made(self, done: int, total: int) -> None:
        """So many are there, of a made drive or of whatever is counted."""
        self._bar.update(self._task, completed=done, total=total)

    def expected(self, scans: int | None) -> None:
        """How many scans there will be."""
        self._bar.update(self._task, total=scans, description="mapping")

    def scan(self, read: int, mapped: int) -> None:
        """So many scans are done."""
        self._bar.update(self._task, completed=mapped)

    def dense(self, sent: int, waiting: int) -> None:
        """After the last scan, so many dense keyframes are with the service, so many wait."""
        self._bar.update(self._task, description="sending dense keyframes", completed=sent, total=sent + waiting)

    def note(self, text: str) -> None:
        """A line for the user."""
        self._console.print(text, style="dim", markup=False, highlight=False, soft_wrap=True)
