"""Backup and restore: a store's content as of one moment, in one SQLite file that any engine's store is made from.

The file holds the tables of schema.py and, in `archive`, a digest of each table's rows. It is written beside its name
and renamed when it is complete and on disk.
"""

from __future__ import annotations

import hashlib
import sqlite3
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sqlalchemy import (
    BigInteger,
    Column,
    Connection,
    MetaData,
    Row,
    String,
    Table,
    create_engine,
    event,
    func,
    insert,
    inspect,
    select,
)
from sqlalchemy.exc import DBAPIError
from sqlalchemy.pool import NullPool

from map_service import migrations, schema
from map_service.catalog import delete_session
from map_service.database import one_line
from map_service.store import Store
from splitslam.durable import sync
from splitslam.errors import InputError

_BATCH = {"clouds": 50, "dense_clouds": 16}  # rows at a time; a cloud may be 100 kB, a dense one 4 MB
_ROWS = 500

contents = Table(
    "archive",
    MetaData(),
    Column("name", String(64), primary_key=True),
    Column("rows", BigInteger, nullable=False),
    Column("sha256", String(64), nullable=False),
)


@dataclass(frozen=True, slots=True)
class Archived:
    """What a backup or a restore took along."""

    sessions: int
    frames: int
    keyframes: int
    bytes: int  # of the file


def backup(store: Store, path: Path) -> Archived:
    """Writes `path`, while services go on. Raises InputError for a path that is taken, StoreError."""
    if path.exists():
        raise InputError(f"{path}: is there already; a backup overwrites nothing")
    if not path.absolute().parent.is_dir():
        raise InputError(f"{path}: no directory {path.absolute().parent}")
    part = path.with_name(path.name + ".part")
    try:
        part.unlink(missing_ok=True)
        part.touch()
    except OSError as error:
        raise InputError(f"{path}: expected a folder that can be written ({error.strerror})") from error
    try:
        with store.reading() as source, _file(part) as target:
            version = migrations.version(source)
            if version != migrations.VERSION:
                raise InputError(f"store: schema version {version}: this program backs up {migrations.VERSION}")
            counts, scans = _copy_out(source, target), _scans(source)
        sync(part)
        part.rename(path)
        sync(path.absolute().parent)
    finally:
        part.unlink(missing_ok=True)
    return Archived(counts["sessions"], scans, counts["keyframes"], path.stat().st_size)


def restore(store: Store, path: Path, force: bool = False) -> Archived:
    """Makes the store what the backup holds, in one transaction; each session gets a new epoch, so no owner goes on.

    Raises InputError for a file that is no sound backup, and without `force` for a store that is not empty.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    try:
        with _file(path, read_only=True) as source:
            counts, scans = _verify(source, path), _scans(source)
            with store.writing() as target:
                _unhurried(target)
                names = list(target.execute(select(schema.sessions.c.session_id)).scalars())
                if names and not force:
                    raise InputError(f"store: holds {len(names)} sessions; --force replaces them by the backup")
                for name in names:
                    delete_session(target, name)
                _copy_in(source, target)
                migrations.note_since(target, migrations.since(source))
    except sqlite3.Error as error:
        raise InputError(f"{path}: damaged: {one_line(error)}") from error
    return Archived(counts["sessions"], scans, counts["keyframes"], path.stat().st_size)


def _copy_out(source: Connection, target: Connection) -> dict[str, int]:
    schema.metadata.create_all(target)
    contents.create(target)
    counts = {}
    for table in schema.metadata.sorted_tables:
        digest, count = hashlib.sha256(), 0
        for batch in _batches(source, table, list(table.columns)):
            target.execute(insert(table), [row._asdict() for row in batch])
            _add(digest, batch)
            count += len(batch)
        target.execute(insert(contents).values(name=table.name, rows=count, sha256=digest.hexdigest()))
        counts[table.name] = count
    return counts


def _verify(source: Connection, path: Path) -> dict[str, int]:
    """Rows by table. Every byte is read before anything is written to a store."""
    try:
        if not inspect(source).has_table(contents.name):
            raise InputError(f"{path}: not a backup: it has no table `{contents.name}`")
        version = migrations.version(source)
        if version is None or version > migrations.VERSION:
            raise InputError(f"{path}: schema version {version}: this program restores up to {migrations.VERSION}")
        expected = {row.name: row for row in source.execute(select(contents))}
        for table, columns in _tables(source):
            digest, count = hashlib.sha256(), 0
            for batch in _batches(source, table, columns):
                _add(digest, batch)
                count += len(batch)
            noted = expected.get(table.name)
            if noted is None or (noted.rows, noted.sha256) != (count, digest.hexdigest()):
                raise InputError(f"{path}: damaged: table `{table.name}` is not what was written")
    except (DBAPIError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: damaged: {one_line(getattr(error, 'orig', error))}") from error
    return {name: row.rows for name, row in expected.items()}


def _copy_in(source: Connection, target: Connection) -> None:
    keys: dict[int, int] = {}  # a session's key in the archive -> in the store, where none is used twice
    for table, columns in _tables(source):
        if table is schema.meta:
            continue
        for batch in _batches(source, table, columns):
            rows = [row._asdict() for row in batch]
            if table is schema.sessions:
                for row in rows:
                    old = row.pop("id")
                    inserted = target.execute(insert(table).values(row | {"epoch": row["epoch"] + 1}))
                    assert inserted.inserted_primary_key is not None
                    keys[old] = inserted.inserted_primary_key[0]
            else:
                target.execute(insert(table), [row | {"session": keys[row["session"]]} for row in rows])


def _scans(source: Connection) -> int:
    """Those that were answered, wherever they lie."""
    t = schema.sessions
    return int(source.execute(select(func.coalesce(func.sum(t.c.frames + t.c.rejected), 0))).scalar_one())


def _tables(source: Connection) -> Iterator[tuple[Table, list[Column]]]:
    """What the archive has of the tables, parents first; one of an older version has less."""
    known = inspect(source)
    for table in schema.metadata.sorted_tables:
        if known.has_table(table.name):
            there = {column["name"] for column in known.get_columns(table.name)}
            yield table, [column for column in table.columns if column.name in there]


def _batches(connection: Connection, table: Table, columns: list[Column]) -> Iterator[list[Row]]:
    """Rows in the order of their primary key."""
    query = select(*columns).order_by(*table.primary_key.columns)
    size = _BATCH.get(table.name, _ROWS)
    with connection.execute(query.execution_options(yield_per=size)) as rows:
        for batch in rows.partitions():
            yield list(batch)


def _add(digest: Any, rows: list[Row]) -> None:
    """Each value with its type and length, so that no two tables look alike."""
    for row in rows:
        for value in row:
            match value:
                case None:
                    data = b"n"
                case bool() | int():
                    data = b"i%d" % value
                case float():
                    data = b"f" + struct.pack("<d", value)
                case str():
                    data = b"s" + value.encode()
                case _:
                    data = b"b" + bytes(value)
            digest.update(struct.pack("<Q", len(data)) + data)


@contextmanager
def _file(path: Path, read_only: bool = False) -> Iterator[Connection]:
    """A transaction on an archive, without a journal beside it."""
    mode = "ro" if read_only else "rwc"
    engine = create_engine(f"sqlite:///file:{path.absolute()}?mode={mode}&uri=true", poolclass=NullPool)
    if not read_only:
        event.listen(engine, "connect", lambda connection, _: connection.execute("PRAGMA journal_mode=OFF"))
    with engine.begin() as connection:
        yield connection
    engine.dispose()


def _unhurried(connection: Connection) -> None:
    if connection.dialect.name == "postgresql":
        connection.exec_driver_sql("SET LOCAL idle_in_transaction_session_timeout = 60000")
