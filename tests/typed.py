"""A command typed into this process: what it prints and how it ends, without the seconds that a new one takes to start.

What only a process of its own can show (signals, what a start loads, what `-m` finds) is tested with one.
"""

from __future__ import annotations

import contextlib
import io
import sys
from importlib import import_module
from pathlib import Path
from typing import NamedTuple
from unittest import mock

from tests.conftest import ROOT

PROGRAMS = {
    "splitslam": "splitslam.cli",
    "edge-agent": "edge_agent.__main__",
    "map-service": "map_service.command",
}


class Said(NamedTuple):
    """What a finished command leaves to its caller."""

    exit_code: int
    out: str
    err: str


def typed(program: str, *words: object, folder: Path = ROOT) -> Said:
    """Calls the entry point of one of PROGRAMS with these words, in `folder`; what it raises comes through."""
    main = import_module(PROGRAMS[program]).main
    out, err = io.StringIO(), io.StringIO()
    with (
        contextlib.chdir(folder),
        mock.patch.object(sys, "argv", [program, *map(str, words)]),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        try:
            main()
            exit_code = 0
        except SystemExit as end:
            exit_code = int(end.code or 0)
    return Said(exit_code, out.getvalue(), err.getvalue())
