"""The store's engine by URL: SQLite embedded, PostgreSQL when there are replicas."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sqlalchemy import Connection, Engine, func, select
from sqlalchemy.engine import make_url
from sqlalchemy.exc import (
    ArgumentError,
    DataError,
    DBAPIError,
    IntegrityError,
    NoSuchModuleError,
    NotSupportedError,
    ProgrammingError,
    TimeoutError,
)

from map_service.migrations import make_or_check
from splitslam.errors import InputError
from splitslam.logs import fields

_EXPECTED = "expected sqlite:///FILE or postgresql://USER@HOST/DATABASE"
_OURS = (IntegrityError, DataError, ProgrammingError, NotSupportedError)  # trying again cannot help
_TRY_EVERY_S = 0.25
_LOCK = 0x53504C55  # PostgreSQL's advisory lock of the replica that keeps the house

_log = logging.getLogger(__name__)


class StoreError(Exception):
    """The store does not answer or refused the write; it may work later."""


@contextmanager
def store_errors() -> Iterator[None]:
    """What the database reports as StoreError: gone, locked, full, frozen, a deadlock, a serialisation failure.

    What is wrong with the statement or its values raises as it is.
    """
    try:
        yield
    except _OURS:
        raise
    except DBAPIError as error:
        raise StoreError(one_line(error.orig)) from error
    except TimeoutError as error:  # no connection came free
        raise StoreError(one_line(error)) from error


def open_engine(url: str, patience_s: float = 0.0) -> Engine:
    """The engine of a store URL, its schema made or checked. Raises InputError naming the URL and what is wrong.

    patience_s: how long to wait for a server that does not answer yet.
    """
    engine = plain_engine(url)
    until_s = time.monotonic() + patience_s
    waited = False
    while True:
        try:
            make_or_check(engine)
            return engine
        except InputError:
            engine.dispose()
            raise
        except DBAPIError as error:
            if time.monotonic() >= until_s or not _may_pass(engine, error):
                engine.dispose()
                raise InputError(f"store: {shown(url)}: cannot be opened: {one_line(error.orig)}") from error
            if not waited:
                _log.warning("waiting for the store", extra=fields(detail=one_line(error.orig)))
                waited = True
        time.sleep(_TRY_EVERY_S)


def check_exists(url: str) -> None:
    """Raises InputError for a SQLite file that is not there: commands that look make none."""
    engine = plain_engine(url)
    path = engine.url.database
    if engine.dialect.name == "sqlite" and path and not Path(path).is_file():
        raise InputError(f"store: {shown(url)}: no such file")


@contextmanager
def input_errors(engine: Engine) -> Iterator[None]:
    """What the database says as one line of InputError."""
    try:
        yield
    except DBAPIError as error:
        raise InputError(f"store: {engine.url.render_as_string()}: {one_line(error.orig)}") from error
    finally:
        engine.dispose()


def plain_engine(url: str) -> Engine:
    """The engine, whatever the database holds. Raises InputError for a URL that cannot be used."""
    try:
        parsed = make_url(url)
        kind = parsed.get_backend_name()
        if kind == "sqlite":
            from map_service.sqlite import sqlite_engine

            return sqlite_engine(parsed)
        if kind in ("postgresql", "postgres"):
            from map_service.postgres import postgres_engine

            return postgres_engine(parsed)
    except (ArgumentError, NoSuchModuleError, ImportError, ValueError) as error:
        raise InputError(f"store: {shown(url)}: {_EXPECTED}: {one_line(error)}") from error
    raise InputError(f"store: {shown(url)}: {_EXPECTED}")


def reading(engine: Engine) -> Engine:
    """The engine with transactions that see one state of the store throughout; SQLite's do anyway."""
    if engine.dialect.name == "sqlite":
        return engine
    from map_service import postgres

    return postgres.reading(engine)


def alone(connection: Connection) -> bool:
    """Is no other replica keeping the house? Holds until the transaction, which writes, ends."""
    if connection.dialect.name == "sqlite":  # has one writer at a time anyway
        return True
    return bool(connection.execute(select(func.pg_try_advisory_xact_lock(_LOCK))).scalar())


def _may_pass(engine: Engine, error: DBAPIError) -> bool:
    if engine.dialect.name == "sqlite":
        return "locked" in str(error.orig)
    from map_service.postgres import may_pass

    return may_pass(error.orig)


def shown(url: str) -> str:
    """A URL for people: without user and password."""
    head, separator, tail = url.rpartition("@")
    return f"{head.split('://')[0]}://...@{tail}" if separator else url


def one_line(error: object) -> str:
    """The text of an error without its line breaks; drivers write hints below."""
    return " ".join(str(error).split())
