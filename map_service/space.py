"""Space of deleted sessions, given back to the file system."""

from __future__ import annotations

import sqlite3
from dataclasses import dataclass

from map_service.database import StoreError
from map_service.store import Store

_PAGES = 2000  # at a time: commits of running sessions come in between
_INCREMENTAL = 2


@dataclass(frozen=True, slots=True)
class Released:
    """Size of the store on disk before and after, and what to say about it."""

    before_bytes: int
    after_bytes: int
    note: str


def release(store: Store, rewrite: bool = False) -> Released:
    """Gives back what is free. rewrite: writes the whole file anew if it must, which keeps services waiting.

    Raises StoreError.
    """
    before = store.size_bytes()
    if store.engine.dialect.name != "sqlite":
        return Released(before, before, "PostgreSQL uses the space for what comes")
    try:
        note = _release_sqlite(store, rewrite)
    except sqlite3.Error as error:
        raise StoreError(str(error)) from error
    return Released(before, store.size_bytes(), note)


def _release_sqlite(store: Store, rewrite: bool) -> str:
    connection = store.engine.raw_connection()  # its statements are transactions of their own
    try:
        cursor = connection.cursor()

        def ask(pragma: str) -> int:
            return cursor.execute(f"PRAGMA {pragma}").fetchone()[0]

        if ask("auto_vacuum") != _INCREMENTAL:
            if not rewrite:
                return "the file keeps the space for what comes: `map-service store compact` gives it back"
            cursor.execute(f"PRAGMA auto_vacuum={_INCREMENTAL}")
            cursor.execute("VACUUM")
        while ask("freelist_count"):
            cursor.execute(f"PRAGMA incremental_vacuum({_PAGES})").fetchall()
        cursor.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()
        cursor.close()
        return "given back to the file system"
    finally:
        connection.close()
