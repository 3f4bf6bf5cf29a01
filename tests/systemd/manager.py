"""What systemd does with a unit, as far as a test needs it: environment, folders, system call filter, sd_notify,
watchdog, and what it would do after the end.
"""

from __future__ import annotations

import os
import re
import shlex
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tests.systemd.unit import INSTALLED, UNITS, Unit, analyze, read_unit

_FOLDERS = {
    "STATE_DIRECTORY": ("StateDirectory", "/var/lib"),
    "CACHE_DIRECTORY": ("CacheDirectory", "/var/cache"),
    "RUNTIME_DIRECTORY": ("RuntimeDirectory", "/run"),
    "CONFIGURATION_DIRECTORY": ("ConfigurationDirectory", "/etc"),
}
_HERE = Path(__file__).parent


@dataclass(frozen=True)
class Said:
    """One datagram: its fields, and when it came (monotonic)."""

    at_s: float
    fields: dict[str, str]


class Manager:
    """Starts the unit's ExecStart below `root`, with the programs of `executables`.

    said: all that the service has notified. log: its stdout and stderr. watchdog_s: WatchdogSec=, unless it is given.
    """

    def __init__(self, root: Path, executables: Path, watchdog_s: float | None = None, name: str = "edge-agent"):
        self.unit: Unit = read_unit(UNITS / f"{name}.service")
        self.root, self._executables = root, executables
        self.watchdog_s = self.unit.seconds("WatchdogSec") if watchdog_s is None else watchdog_s
        self.log = root / f"{name}.log"
        self.said: list[Said] = []
        self.aborted = False
        self.folders = {}
        for variable, (key, parent) in _FOLDERS.items():
            if not self.unit.all(key):
                continue
            folder = Path(f"{root}{parent}") / self.unit.one(key)
            folder.mkdir(parents=True, exist_ok=True)
            self.folders[variable] = folder
        self.state, self.config = self.folders["STATE_DIRECTORY"], self.folders["CONFIGURATION_DIRECTORY"]
        self.runtime = root / "run" / "splitslam"
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(str(root / "notify"))
        self._socket.settimeout(0.05)
        self._process: subprocess.Popen[bytes] | None = None
        self._closed, self._quiet = False, 0
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def start(self, **environment: str) -> None:
        """As on a machine that has just booted or restarts the service."""
        self.said, self.aborted = [], False
        with self.log.open("ab") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-IS", str(_HERE / "_filtered.py"), str(self._system_calls()), *self.command()],
                env=self._environment() | environment,
                cwd=f"{self.root}{self.unit.one('WorkingDirectory')}",
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                umask=int(self.unit.one("UMask"), 8),
                start_new_session=True,
            )

    def command(self) -> list[str]:
        """ExecStart=, below the root."""
        words = shlex.split(self.unit.one("ExecStart"))
        folder = f"{INSTALLED}/current/bin/"
        assert words[0].startswith(folder)
        program = self._executables / words[0].removeprefix(folder)
        return [str(program), *(f"{self.root}{word}" if word.startswith("/etc/") else word for word in words[1:])]

    def _environment(self) -> dict[str, str]:
        from_file = Path(f"{self.root}{self.unit.one('EnvironmentFile')}")
        lines = from_file.read_text().splitlines() if from_file.exists() else []
        return {
            "PATH": "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin",
            "LANG": "C.UTF-8",
            **self.unit.environment,
            **dict(line.split("=", 1) for line in lines if re.match(r"\w+=", line)),
            **{variable: str(folder) for variable, folder in self.folders.items()},
            "NOTIFY_SOCKET": str(self.root / "notify"),
            "WATCHDOG_USEC": str(int(self.watchdog_s * 1e6)),
        }

    def _system_calls(self) -> Path:
        """A file with the names that SystemCallFilter= leaves."""
        sets: dict[str, list[str]] = {}
        for line in analyze("syscall-filter", "--no-pager").stdout.splitlines():
            if line.startswith("@"):
                names = sets[line.strip()] = []
            elif re.match(r" +[@a-z]", line) and sets:
                names.append(line.strip())

        def flat(name: str) -> set[str]:
            return set().union(*map(flat, sets[name])) if name.startswith("@") else {name}

        allowed = flat("@default")
        for line in self.unit.all("SystemCallFilter"):
            named = set().union(*map(flat, line.removeprefix("~").split()))
            allowed = allowed - named if line.startswith("~") else allowed | named
        file = self.root / "system_calls"
        file.write_text("\n".join(sorted(allowed)))
        return file

    def _listen(self) -> None:
        """Takes notifications, and ends a service that is silent for longer than it may be."""
        while not self._closed:
            try:
                text = self._socket.recv(65536).decode()
                self.said.append(Said(time.monotonic(), dict(line.split("=", 1) for line in text.splitlines())))
            except TimeoutError:
                self._quiet += 1
            alive = [said.at_s for said in self.said if said.fields.keys() & {"WATCHDOG", "READY"}]
            over = any("STOPPING" in said.fields for said in self.said)
            silent = bool(alive) and time.monotonic() - alive[-1] > self.watchdog_s
            if silent and self.running and not over and not self.aborted:
                self.aborted = True
                self.send(signal.SIGABRT)

    @property
    def running(self) -> bool:
        return self._process is not None and self._process.poll() is None

    def send(self, number: signal.Signals) -> None:
        assert self._process is not None
        self._process.send_signal(number)

    def wait(self, timeout_s: float = 240.0) -> int:
        """Exit code; negative: the signal that ended it. All that it has said is in `said` then."""
        assert self._process is not None
        code, quiet = self._process.wait(timeout_s), self._quiet
        self.until(lambda: self._quiet >= quiet + 2, "its last words")  # the first may be one of before its end
        return code

    def restarts(self, exit_code: int) -> bool:
        """Whether systemd would start it again after this end (Restart=on-failure)."""
        assert self.unit.one("Restart") == "on-failure"
        return exit_code not in (0, -signal.SIGTERM, *map(int, self.unit.one("RestartPreventExitStatus").split()))

    def with_field(self, name: str) -> list[Said]:
        return [said for said in self.said if name in said.fields]

    def statuses(self) -> list[str]:
        return [said.fields["STATUS"] for said in self.with_field("STATUS")]

    def until(self, done: Callable[[], bool], what: str, within_s: float = 240.0) -> None:
        """Raises AssertionError when it is not done in time, which is enough to compile kernels on a busy machine."""
        deadline_s = time.monotonic() + within_s
        while not done():
            assert time.monotonic() < deadline_s, f"{what}: {self.log.read_text()[-3000:]}\n{self.statuses()[-3:]}"
            time.sleep(0.02)

    def close(self) -> None:
        if self._process is not None and self.running:
            os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()
        self._closed = True
        self._thread.join()
        self._socket.close()
