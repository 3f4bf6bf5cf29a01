"""The diagnosis for people."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table

from splitslam.diagnose.checks import Verdict
from splitslam.diagnose.command import Diagnosis

_COLOURS = {Verdict.OK: "green", Verdict.WARN: "yellow", Verdict.FAIL: "red", Verdict.UNKNOWN: "dim"}


def show(diagnosis: Diagnosis) -> None:
    """A line for each thing that was looked at, then the path of the bundle."""
    table = Table(box=None, show_header=False, padding=(0, 2, 0, 0))
    for part, found in diagnosis.found.items():
        for check in found:
            colour = _COLOURS[check.verdict]
            table.add_row(part, check.name, f"[{colour}]{check.verdict.value}[/{colour}]", check.text)
    Console(soft_wrap=True).print(table)
    print(diagnosis.path)
