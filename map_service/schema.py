"""Tables of the store and how its engine is opened: SQLite embedded, PostgreSQL when there are replicas."""

from __future__ import annotations

import sqlite3
from pathlib import Path

from sqlalchemy import (
    BigInteger,
    Boolean,
    Column,
    Engine,
    Float,
    ForeignKey,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    String,
    Table,
    Text,
    create_engine,
    event,
    insert,
    inspect,
    select,
)
from sqlalchemy.exc import ArgumentError, DBAPIError, IntegrityError, NoSuchModuleError

from splitslam.errors import InputError

SCHEMA_VERSION = 1
BUSY_TIMEOUT_MS = 5000

metadata = MetaData()
_row_id = BigInteger().with_variant(Integer, "sqlite")  # only INTEGER is an alias of SQLite's rowid


def _session_key() -> Column:
    return Column("session", _row_id, ForeignKey("sessions.id"), primary_key=True)


meta = Table("meta", metadata, Column("key", String(64), primary_key=True), Column("value", Text, nullable=False))

sessions = Table(
    "sessions",
    metadata,
    # A surrogate key that is never used again: an owner of a deleted session cannot write into its successor.
    Column("id", _row_id, primary_key=True, autoincrement=True),
    Column("session_id", String(180), nullable=False, unique=True),
    Column("robot_id", String(128), nullable=False),
    Column("run_id", String(64), nullable=False),
    Column("site_id", String(128), nullable=False),
    Column("map_id", String(128), nullable=False),
    Column("robot_file", Text, nullable=False),
    Column("opened_s", Float, nullable=False),
    Column("epoch", BigInteger, nullable=False),
    Column("last_seq", BigInteger, nullable=False),
    Column("finished", Boolean, nullable=False),
    Column("first_stamp_ns", BigInteger, nullable=False),
    Column("last_stamp_ns", BigInteger, nullable=False),
    Column("frames", BigInteger, nullable=False),
    Column("rejected", BigInteger, nullable=False),
    Column("keyframes", BigInteger, nullable=False),
    Column("loops", BigInteger, nullable=False),
    Column("gnss_factors", BigInteger, nullable=False),
    Column("bytes", BigInteger, nullable=False),
    Column("tracker", LargeBinary, nullable=False),
    Column("statistics", Text, nullable=False),
    Index("sessions_by_site", "site_id"),
    sqlite_autoincrement=True,
)

# Poses are 7 little-endian float64: x y z, qx qy qz qw. A rejected frame has its reason and no poses.
frames = Table(
    "frames",
    metadata,
    _session_key(),
    Column("seq", BigInteger, primary_key=True),
    Column("stamp_ns", BigInteger, nullable=False),
    Column("state", Integer, nullable=False),
    Column("keyframe", Integer),
    Column("pose_keyframe_lidar", LargeBinary),
    Column("online_map_lidar", LargeBinary),
    Column("online_map_odom", LargeBinary),
    Column("rejected", String(64), nullable=False),
)

keyframes = Table(
    "keyframes",
    metadata,
    _session_key(),
    Column("keyframe", Integer, primary_key=True),
    Column("seq", BigInteger, nullable=False),
    Column("stamp_ns", BigInteger, nullable=False),
    Column("pose_map_lidar", LargeBinary, nullable=False),
)

# Apart from the poses: a loop moves every pose, and SQLite writes a whole row anew.
clouds = Table(
    "clouds",
    metadata,
    _session_key(),
    Column("keyframe", Integer, primary_key=True),
    Column("cloud", LargeBinary, nullable=False),
)

factors = Table(
    "factors",
    metadata,
    _session_key(),
    Column("factor", BigInteger, primary_key=True),
    Column("kind", String(16), nullable=False),
    Column("payload", LargeBinary, nullable=False),
)


def open_engine(url: str) -> Engine:
    """The engine of a store URL, its schema made or checked. Raises InputError naming the URL and what is wrong."""
    try:
        engine = create_engine(url, pool_pre_ping=not url.startswith("sqlite"))
    except (ArgumentError, NoSuchModuleError, ImportError, ValueError) as error:
        raise InputError(
            f"store: {_shown(url)}: expected sqlite:///FILE or postgresql+psycopg://..., {error}"
        ) from error
    if engine.dialect.name == "sqlite":
        _check_sqlite_path(engine.url.database, url)
        event.listen(engine, "connect", _configure_sqlite)
        event.listen(engine, "begin", _begin_sqlite)
    try:
        _make_or_check(engine)
    except DBAPIError as error:
        engine.dispose()
        raise InputError(f"store: {_shown(url)}: cannot be opened: {error.orig}") from error
    return engine


def _shown(url: str) -> str:
    head, separator, tail = url.rpartition("@")  # no password in a log line
    return f"{head.split('://')[0]}://...@{tail}" if separator else url


def _check_sqlite_path(database: str | None, url: str) -> None:
    if not database or database == ":memory:":
        raise InputError(f"store: {url}: expected sqlite:///FILE; several processes share the store")
    if not Path(database).resolve().parent.is_dir():
        raise InputError(f"store: {url}: no directory {Path(database).resolve().parent}")


def _configure_sqlite(connection: sqlite3.Connection, _record: object) -> None:
    connection.isolation_level = None  # transactions begin in _begin_sqlite, never behind our back
    cursor = connection.cursor()
    for pragma in (
        f"busy_timeout={BUSY_TIMEOUT_MS}",
        "journal_mode=WAL",
        "synchronous=FULL",  # durable_seq must not lie after a power cut
        "foreign_keys=ON",
    ):
        cursor.execute(f"PRAGMA {pragma}")
    cursor.close()


def _begin_sqlite(connection) -> None:
    # A writer takes the lock at once: upgrading a read lock later fails without waiting.
    write = connection.get_execution_options().get("write", False)
    connection.exec_driver_sql("BEGIN IMMEDIATE" if write else "BEGIN")


def _make_or_check(engine: Engine) -> None:
    try:
        with engine.execution_options(write=True).begin() as connection:
            if not inspect(connection).has_table("meta"):
                metadata.create_all(connection)
                connection.execute(insert(meta).values(key="schema_version", value=str(SCHEMA_VERSION)))
    except IntegrityError:
        pass  # another replica made it in the same moment
    with engine.connect() as connection:
        found = connection.execute(select(meta.c.value).where(meta.c.key == "schema_version")).scalar()
    if found != str(SCHEMA_VERSION):
        raise InputError(f"store: schema version {found}: this service reads version {SCHEMA_VERSION}")
