"""SQLite as a store: one file, shared by the processes of one machine."""

from __future__ import annotations

import sqlite3
from pathlib import Path

from sqlalchemy import URL, Connection, Engine, create_engine, event

from splitslam.errors import InputError

BUSY_TIMEOUT_MS = 5000


def sqlite_engine(url: URL) -> Engine:
    """The engine; the file is made when it is first connected. Raises InputError for a path that cannot be."""
    _check_path(url)
    engine = create_engine(url)
    event.listen(engine, "connect", _configure)
    event.listen(engine, "begin", _begin)
    return engine


def _check_path(url: URL) -> None:
    if not url.database or url.database == ":memory:":
        raise InputError(f"store: {url}: expected sqlite:///FILE; several processes share the store")
    folder = Path(url.database).resolve().parent
    if not folder.is_dir():
        raise InputError(f"store: {url}: no directory {folder}")
    if Path(url.database).is_dir():
        raise InputError(f"store: {url}: expected a file, found a directory")


def _configure(connection: sqlite3.Connection, _record: object) -> None:
    connection.isolation_level = None  # transactions begin in _begin, never behind our back
    cursor = connection.cursor()
    for pragma in (
        f"busy_timeout={BUSY_TIMEOUT_MS}",
        "auto_vacuum=INCREMENTAL",  # of a new file; one that has tables keeps what it was made with
        "journal_mode=WAL",
        "synchronous=FULL",  # durable_seq must not lie after a power cut
        "foreign_keys=ON",
    ):
        cursor.execute(f"PRAGMA {pragma}")
    cursor.close()


def _begin(connection: Connection) -> None:
    # A writer takes the lock at once: upgrading a read lock later fails without waiting.
    write = connection.get_execution_options().get("write", False)
    connection.exec_driver_sql("BEGIN IMMEDIATE" if write else "BEGIN")
