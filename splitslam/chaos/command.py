"""`splitslam demo --chaos` on a terminal, in a pipe, or in a script."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import typer
from rich.console import Console
from rich.live import Live

from splitslam.chaos.demo import SECONDS, chaos_demo
from splitslam.chaos.script import read_script
from splitslam.chaos.table import show
from splitslam.chaos.view import WIDTH, Snapshot, render
from splitslam.errors import InputError
from splitslam.run.progress import Progress

_BY_HAND_S = 60.0


def run_chaos(out: Path, *, seconds: float | None, seed: int, script: str | None, as_json: bool) -> None:
    """Keys when a person sits there and no script is given; otherwise the script, `default` if none is named.

    Exit code 1 when a scan was lost or mapped twice, or a trajectory was bent.
    """
    by_hand = script is None and sys.stdin.isatty()
    harms = None if by_hand else read_script(script or "default")
    if seconds is None:
        seconds = _BY_HAND_S if by_hand else SECONDS
    if late := [harm for harm in harms or () if harm.at_s >= seconds]:
        raise InputError(f"--script: expected everything within the {seconds:g} s of the drive, found {late[0].at_s:g}")
    with Progress() as progress, _Screen() as screen:
        result = chaos_demo(out, progress, harms, screen.show, seconds=seconds, seed=seed)
    if as_json:
        print(json.dumps(result.as_dict()))
    else:
        show(result)
        print(out / "chaos.json")
    if not result.passed:
        raise typer.Exit(1)


class _Screen:
    """The live view on stderr; where that is no terminal, a line for each thing that is done."""

    def __init__(self) -> None:
        console = Console(stderr=True)
        wide = console.is_terminal and console.width >= WIDTH
        self._live = Live(console=console, auto_refresh=False, transient=True) if wide else None
        self._said = 0

    def __enter__(self) -> _Screen:
        return self

    def __exit__(self, *_: object) -> None:
        if self._live is not None:
            self._live.stop()

    def show(self, shot: Snapshot) -> None:
        if self._live is not None:
            self._live.start()
            self._live.update(render(shot), refresh=True)
            return
        for at_s, what in shot.events[self._said :]:
            print(f"{at_s:6.1f} s  {what}", file=sys.stderr, flush=True)
        self._said = len(shot.events)
