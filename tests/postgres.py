"""A real PostgreSQL server for tests; it may be killed, frozen, started again."""

from __future__ import annotations

import os
import shutil
import signal
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psycopg

from splitslam.errors import InputError
from splitslam.stack.postgres import PostgresServer
from tests.map_service.harness import descendants
from tests.missing import missing


class DatabaseServer(PostgresServer):
    """One for all tests, with an empty database for each."""

    def __init__(self) -> None:
        self._folder = Path(tempfile.mkdtemp(prefix="splitslam-pg-"))
        self._folder.chmod(0o755)  # the server's user comes through
        super().__init__(self._folder)
        self.start()

    def url_of(self, database: str) -> str:
        """As an operator writes it."""
        return self.url.replace("+psycopg", "").rpartition("/")[0] + "/" + database

    def empty_database(self, name: str = "test") -> str:
        """URL of a database without tables. One that is emptied costs less than a new one: 300 files to sync."""
        with psycopg.connect(self.url_of("postgres"), autocommit=True) as connection:
            if connection.execute("SELECT FROM pg_database WHERE datname = %s", [name]).fetchone() is None:
                connection.execute(f"CREATE DATABASE {name}".encode())
                return self.url_of(name)
            connection.execute("SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE datname = %s", [name])
        with psycopg.connect(self.url_of(name)) as connection:
            connection.execute("DROP SCHEMA public CASCADE").execute("CREATE SCHEMA public")
        return self.url_of(name)

    @contextmanager
    def frozen(self) -> Iterator[None]:
        """Every process of the server is stopped while the block runs."""
        stopped = [self.pid, *descendants(self.pid)]
        for pid in stopped:
            os.kill(pid, signal.SIGSTOP)
        try:
            yield
        finally:
            for pid in stopped:
                os.kill(pid, signal.SIGCONT)

    def close(self) -> None:
        super().close()
        shutil.rmtree(self._folder)


def database_server() -> DatabaseServer:
    """Skips on a laptop without the wheel; in CI its absence must not look like success."""
    try:
        return DatabaseServer()
    except InputError as error:
        missing(str(error))
