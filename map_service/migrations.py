"""The version of a store's tables, and the way from one to the next.

A version only ever adds tables, indexes and columns that may be missing. So a service of version N works on a store of
N and of N + 1, and replicas are upgraded one after the other; the other way, what a version added is dropped.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass

from sqlalchemy import Column, Connection, Engine, Index, Table, delete, func, insert, inspect, select, text, update
from sqlalchemy.schema import CreateColumn

from map_service import schema
from splitslam.errors import InputError
from splitslam.logs import fields

_KEY = "schema_version"
_SINCE = "since_"
_LOCK = 0x53504C4954  # PostgreSQL's advisory lock of those who make or migrate

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Migration:
    """What a version has that the one before it has not."""

    version: int
    tables: tuple[Table, ...] = ()
    columns: tuple[Column, ...] = ()
    indexes: tuple[Index, ...] = ()
    undo: Callable[[Connection], None] = lambda connection: None  # before what it added is dropped

    def add(self, connection: Connection) -> None:
        for table in self.tables:
            table.create(connection)
        for column in self.columns:
            defined = CreateColumn(column).compile(dialect=connection.dialect)
            connection.execute(text(f"ALTER TABLE {column.table.name} ADD COLUMN {defined}"))
        for index in self.indexes:
            index.create(connection)

    def remove(self, connection: Connection) -> None:
        self.undo(connection)
        for index in self.indexes:
            index.drop(connection)
        for column in self.columns:
            connection.execute(text(f"ALTER TABLE {column.table.name} DROP COLUMN {column.name}"))
        for table in reversed(self.tables):
            table.drop(connection)


def _as_rows(connection: Connection) -> None:
    """Services of before know no blocks."""
    from map_service.block_keeping import reopen  # reads and writes rows, which the way forward needs not

    reopen(connection)


FIRST = 1  # the oldest version that there is a way from
MIGRATIONS = (
    Migration(2, tables=(schema.holes, schema.places), columns=(schema.sessions.c.finished_s,)),
    Migration(
        3,
        tables=(schema.map_versions, schema.events),
        columns=(schema.sessions.c.map_version, schema.sessions.c.events, schema.frames.c.covariance),
        indexes=tuple(schema.frames.indexes),
    ),
    Migration(4, tables=(schema.dense_clouds,)),
    Migration(5, tables=(schema.pose_blocks, schema.anchors), undo=_as_rows),
)
VERSION = MIGRATIONS[-1].version


@dataclass(frozen=True, slots=True)
class Migrated:
    """What a migration did; `before` 0: there was no store."""

    before: int
    after: int


def make_or_check(engine: Engine) -> None:
    """Makes the tables in an empty database, brings those of an older version up to date.

    Raises InputError for a version that this service can neither use nor migrate.
    """
    with engine.connect() as connection:
        found = version(connection)
    if found == VERSION + 1:
        _log.info("the store is one version ahead", extra=fields(store=found, service=VERSION))
    elif found is not None and found > VERSION:
        raise InputError(f"store: schema version {found}: this service works with {FIRST} to {VERSION + 1}")
    elif found != VERSION:
        migrate(engine, VERSION)


def migrate(engine: Engine, to: int = VERSION) -> Migrated:
    """Forward or back, in one transaction; who comes second waits and finds it done. Raises InputError.

    Going back drops what the later versions added, and what was stored in it.
    """
    if not FIRST <= to <= VERSION:
        raise InputError(f"store: no way to schema version {to}: this program knows {FIRST} to {VERSION}")
    with engine.execution_options(write=True).begin() as connection:
        if connection.dialect.name == "postgresql":  # SQLite's writers wait for each other as they are
            connection.execute(select(func.pg_advisory_xact_lock(_LOCK)))
            # a machine that has to compile the kernels of blocks first is no owner that has gone to sleep
            connection.exec_driver_sql("SET LOCAL idle_in_transaction_session_timeout = 60000")
        found = version(connection)
        if found is None:
            schema.metadata.create_all(connection)
            connection.execute(insert(schema.meta).values(key=_KEY, value=str(VERSION)))
        elif not FIRST <= found <= VERSION:
            raise InputError(
                f"store: schema version {found}: there is a way to {to} only from {FIRST} to {VERSION}; "
                f"take {'a newer' if found > VERSION else 'an older'} program"
            )
        for step in MIGRATIONS:
            if (found or VERSION) < step.version <= to:
                step.add(connection)
                connection.execute(insert(schema.meta).values(key=f"{_SINCE}{step.version}", value=str(time.time())))
        for step in reversed(MIGRATIONS):
            if to < step.version <= (found or VERSION):
                step.remove(connection)
                connection.execute(delete(schema.meta).where(schema.meta.c.key == f"{_SINCE}{step.version}"))
        connection.execute(update(schema.meta).where(schema.meta.c.key == _KEY).values(value=str(to)))
    if found not in (None, to):
        _log.info("store migrated", extra=fields(before=found, after=to))
    return Migrated(found or 0, to)


def since(connection: Connection) -> dict[int, float]:
    """Since when the store has each version that it was not made with, Unix time; now for those to come."""
    query = select(schema.meta.c.key, schema.meta.c.value).where(schema.meta.c.key.like(f"{_SINCE}%"))
    noted = {int(key.removeprefix(_SINCE)): float(value) for key, value in connection.execute(query)}
    return dict.fromkeys(range((version(connection) or 0) + 1, VERSION + 1), time.time()) | noted


def note_since(connection: Connection, times_s: dict[int, float]) -> None:
    """Content of that age came in."""
    connection.execute(delete(schema.meta).where(schema.meta.c.key.like(f"{_SINCE}%")))
    for number, time_s in times_s.items():
        connection.execute(insert(schema.meta).values(key=f"{_SINCE}{number}", value=str(time_s)))


def version(connection: Connection) -> int | None:
    """None: there are no tables. Raises InputError for tables that are not a store's."""
    if not inspect(connection).has_table(schema.meta.name):
        return None
    value = connection.execute(select(schema.meta.c.value).where(schema.meta.c.key == _KEY)).scalar()
    if value is None or not value.isdigit():
        raise InputError(f"store: schema version {value!r}: expected a number; the database is not a store")
    return int(value)
