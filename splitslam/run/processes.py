"""The programs a run starts: ended on every path, and never left behind, however this process ends."""

from __future__ import annotations

import contextlib
import os
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from typing import IO

# The kernel ends the program when this process dies, even by SIGKILL. Not by preexec_fn: other threads run here.
_TIED = (
    "import ctypes, os, signal, sys; "
    "ctypes.CDLL(None).prctl(1, signal.SIGTERM); "
    "os.getppid() == int(sys.argv[1]) or os._exit(1); "
    "os.execvp(sys.argv[2], sys.argv[2:])"
)
_FOREIGN = ("SPLITSLAM_EDGE__", "SPLITSLAM_MAP__")


class RunFailedError(Exception):
    """A program ended before its work was done; the text says which and why."""

    def __init__(self, text: str, exit_code: int = 1) -> None:
        super().__init__(text)
        self.exit_code = exit_code


@dataclass(frozen=True, slots=True)
class Programs:
    """Command lines of both programs, without arguments."""

    edge_agent: tuple[str, ...] = (sys.executable, "-m", "edge_agent")
    map_service: tuple[str, ...] = (sys.executable, "-m", "map_service")


class Child:
    """A started program. Its lines come by `next_line`, stdout as ("out", text), stderr as ("err", text)."""

    def __init__(self, name: str, command: tuple[str, ...]) -> None:
        self.name = name
        # What the environment configures is in the files we hand over; here it would override the options of the run.
        environment = {key: value for key, value in os.environ.items() if not key.startswith(_FOREIGN)}
        self._process = subprocess.Popen(
            (sys.executable, "-ISc", _TIED, str(os.getpid()), *command),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=environment,
            start_new_session=True,  # Ctrl-C comes to us, and we end it
        )
        self._lines: queue.SimpleQueue[tuple[str, str]] = queue.SimpleQueue()
        self._pumps = [self._pump("out", self._process.stdout), self._pump("err", self._process.stderr)]

    def _pump(self, kind: str, stream: IO[bytes] | None) -> threading.Thread:
        assert stream is not None

        def pump() -> None:
            with stream:
                for line in stream:
                    self._lines.put((kind, line.decode("utf-8", "replace").rstrip("\n")))

        thread = threading.Thread(target=pump, name=f"{self.name}-{kind}", daemon=True)
        thread.start()
        return thread

    def next_line(self, timeout_s: float) -> tuple[str, str] | None:
        """The next line, or None when none comes in time."""
        with contextlib.suppress(queue.Empty):
            return self._lines.get(timeout=timeout_s)
        return None

    def remaining_lines(self) -> Iterator[tuple[str, str]]:
        """What is left to read of a program that has ended."""
        for pump in self._pumps:
            pump.join(timeout=2.0)
        while (line := self.next_line(0.0)) is not None:
            yield line

    @property
    def exit_code(self) -> int | None:
        """None while it runs; negative: the signal that ended it."""
        return self._process.poll()

    def stop(self, grace_s: float) -> None:
        """SIGTERM, and after `grace_s` SIGKILL to it and what it has started."""
        if self.exit_code is not None:
            return
        self._process.terminate()
        try:
            self._process.wait(grace_s)
        except subprocess.TimeoutExpired:
            os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()


def how_it_ended(name: str, exit_code: int) -> str:
    """`edge-agent was ended by SIGKILL`."""
    if exit_code < 0:
        return f"{name} was ended by {signal.Signals(-exit_code).name}"
    return f"{name} ended with exit code {exit_code}"


@contextlib.contextmanager
def interruptible() -> Iterator[None]:
    """SIGTERM ends this process as Ctrl-C does: by an exception, so that every `finally` runs."""

    def interrupt(number: int, frame: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


@contextlib.contextmanager
def undisturbed() -> Iterator[None]:
    """Ctrl-C waits: what runs inside is bounded in time and must be finished."""
    before = {number: signal.signal(number, signal.SIG_IGN) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def started(name: str, command: tuple[str, ...], grace_s: float) -> Iterator[Child]:
    """The program for as long as the block runs."""
    child = Child(name, command)
    try:
        yield child
    finally:
        with undisturbed():
            child.stop(grace_s)
