"""Single keys from the terminal, without Return."""

from __future__ import annotations

import os
import select
import sys
import termios
import time
import tty
from typing import Any, Self


class Keys:
    """Reads keys inside the block; not `on`: only waits."""

    def __init__(self, on: bool) -> None:
        self._on = on
        self._before: list[Any] = []

    def __enter__(self) -> Self:
        if self._on:
            self._before = termios.tcgetattr(sys.stdin)
            tty.setcbreak(sys.stdin)
        return self

    def __exit__(self, *_: object) -> None:
        if self._on:
            termios.tcsetattr(sys.stdin, termios.TCSADRAIN, self._before)

    def pressed(self, timeout_s: float) -> str:
        """The next key, or "" when none comes in time."""
        if not self._on:
            time.sleep(timeout_s)
            return ""
        ready, _, _ = select.select([sys.stdin], [], [], timeout_s)
        return os.read(sys.stdin.fileno(), 1).decode(errors="replace").lower() if ready else ""
