"""`splitslam top` on a terminal, in a pipe, or in a script."""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from typing import Any

from rich.console import Console
from rich.live import Live

from splitslam.chaos.keys import Keys
from splitslam.errors import InputError
from splitslam.top.endpoint import Endpoint, read_all
from splitslam.top.rows import ReplicaRow, RobotRow, Row, Silent, row_of
from splitslam.top.trouble import Journal, Watch
from splitslam.top.view import EVENTS, MIN_WIDTH, Screen, render

DEFAULT = ("127.0.0.1:9464", "127.0.0.1:9465")  # an agent and a service of this machine, as they are by default
_THREADS = 32
_KINDS = {RobotRow: "robot", ReplicaRow: "replica", Silent: "silent"}


class Top:
    """The endpoints, read together, and what has happened to them."""

    def __init__(self, addresses: Sequence[str]) -> None:
        """Raises InputError for an address that is none."""
        self._endpoints = [Endpoint(address) for address in dict.fromkeys(addresses)]
        self._watches = [Watch(endpoint) for endpoint in self._endpoints]
        self._journal = Journal(EVENTS)
        self._pool = ThreadPoolExecutor(min(_THREADS, len(self._endpoints)), thread_name_prefix="top")

    def read(self) -> None:
        """Asks every endpoint once."""
        read_all(self._endpoints, self._pool)
        clock = time.strftime("%H:%M:%S")
        for watch in self._watches:
            for event in watch.events():
                self._journal.add(clock, event)

    @property
    def rows(self) -> tuple[Row, ...]:
        """One of each endpoint, in the order in which they were named."""
        return tuple(map(row_of, self._endpoints))

    def screen(self, keys: bool = False) -> Screen:
        """What there is to show now."""
        return Screen(self.rows, self._journal.lines, time.strftime("%H:%M:%S"), keys)


def run_top(addresses: Sequence[str], every_s: float, once: bool, as_json: bool) -> bool:
    """Live until `q` or Ctrl-C; without a terminal, or when asked to, once. False: an endpoint gives no answer."""
    if not every_s > 0:
        raise InputError(f"--every: expected more than 0 s, found {every_s:g}")
    top = Top(addresses or DEFAULT)
    console = Console()
    once = once or as_json or not (console.is_terminal and sys.stdin.isatty())
    top.read()
    if once:
        time.sleep(every_s)  # rates need two readings
        top.read()
        if as_json:
            print(json.dumps([_as_dict(row) for row in top.rows], allow_nan=False))
        else:
            Console(width=max(MIN_WIDTH, console.width)).print(render(top.screen()))
        return not any(isinstance(row, Silent) for row in top.rows)
    _live(top, console, every_s)
    return True


def _live(top: Top, console: Console, every_s: float) -> None:
    try:
        with Keys(True) as keys, Live(console=console, screen=True, auto_refresh=False) as live:
            while True:
                live.update(render(top.screen(keys=True)), refresh=True)
                if keys.pressed(every_s) == "q":
                    return
                top.read()
    except KeyboardInterrupt:  # the usual way out of a program that never ends
        return


def _as_dict(row: Row) -> dict[str, Any]:
    """With null for what is not known."""
    fields = {
        key: None if isinstance(value, float) and math.isnan(value) else value
        for key, value in asdict(row).items()
        if key != "uplinks_kbps"
    }
    return {"kind": _KINDS[type(row)], **fields}
