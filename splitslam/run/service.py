"""The embedded map service of one run."""

from __future__ import annotations

import contextlib
import json
import time
from collections import deque
from collections.abc import Iterator
from pathlib import Path

from splitslam.run.processes import Child, RunFailedError, how_it_ended, started

NAME = "map-service"
_START_S = 300.0  # the first start compiles the kernels
_STOP_S = 10.0
_TICK_S = 0.1


class EmbeddedService:
    """A map service that listens on `address`."""

    def __init__(self, child: Child, address: str, log: deque[str]) -> None:
        self._child, self.address, self._log = child, address, log

    def check(self) -> None:
        """Raises RunFailedError when it has ended."""
        _check(self._child, self._log)


@contextlib.contextmanager
def embedded_service(command: tuple[str, ...], config: Path) -> Iterator[EmbeddedService]:
    """Serve for as long as the block runs. Raises RunFailedError when it does not get to listen."""
    with started(NAME, (*command, "serve", "--config", str(config)), _STOP_S) as child:
        log: deque[str] = deque(maxlen=30)
        yield EmbeddedService(child, _address(child, log), log)


def _address(child: Child, log: deque[str]) -> str:
    deadline_s = time.monotonic() + _START_S
    while time.monotonic() < deadline_s:
        kind, text = child.next_line(_TICK_S) or ("", "")
        if kind == "err":
            log.append(text)
        elif kind == "out" and (address := _listening(text)):
            return address
        elif not kind:
            _check(child, log)
    raise RunFailedError(f"{NAME}: expected to listen within {_START_S:g} s, did not")


def _listening(text: str) -> str | None:
    with contextlib.suppress(ValueError, TypeError, AttributeError):
        message = json.loads(text)
        return message.get("grpc") if message.get("event") == "listening" else None
    return None


def _check(child: Child, log: deque[str]) -> None:
    exit_code = child.exit_code
    while kind_and_text := child.next_line(0.0):
        log.append(kind_and_text[1])
    if exit_code is None:
        return
    log.extend(text for _, text in child.remaining_lines())
    last = next((text for text in reversed(log) if text.strip()), "")
    if exit_code == 2:  # the one line that says what to mend
        raise RunFailedError(f"{NAME}: {last}", exit_code)
    raise RunFailedError(f"{how_it_ended(NAME, exit_code)}" + (f": {last}" if last else ""))
