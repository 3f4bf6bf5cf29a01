"""PostgreSQL as a store: connections that commit durably and never wait for ever.

The server's own limits end a statement, a wait for a lock, and a transaction whose owner went to sleep. A server that
is itself frozen keeps none of them, so the client has one more.
"""

from __future__ import annotations

from typing import Any, TypeVar

import psycopg
from psycopg.abc import PQGen
from psycopg.pq import TransactionStatus
from sqlalchemy import URL, Connection, Engine, create_engine, event

from splitslam.errors import InputError

CONNECT_S = 2  # libpq's least
STATEMENT_S = 5.0
ANSWER_S = 6.0  # for one exchange with the server: beyond its own limits it is frozen
LOCK_S = 3.0
ASLEEP_S = 1.0  # a frozen owner in the middle of a commit must not keep its successor out
READING_S = 60.0  # a reader may hand on what it reads to somebody slow
POOL_WAIT_S = 5.0
REQUIRED = {"synchronous_commit": "on", "fsync": "on"}  # durable_seq must not lie after a power cut
_PASSING = ("starting up", "shutting down", "recovery", "not yet accepting", "too many")

T = TypeVar("T")


class ImpatientConnection(psycopg.Connection[Any]):
    """Closes itself when the server does not answer within ANSWER_S: OperationalError, as any lost connection."""

    def wait(self, gen: PQGen[T], interval: float = 0.1, timeout: float | None = None) -> T:
        try:
            return super().wait(gen, interval, ANSWER_S if timeout is None else timeout)
        except psycopg.OperationalError:
            if self.pgconn.transaction_status == TransactionStatus.ACTIVE:  # nobody knows what became of it
                self.pgconn.finish()
            raise


def postgres_engine(url: URL) -> Engine:
    """The engine; nothing is connected yet."""
    engine = create_engine(
        url.set(drivername="postgresql+psycopg"),
        pool_pre_ping=True,  # connections of before a restart of the server are replaced, not handed out
        pool_timeout=POOL_WAIT_S,
        connect_args={
            "connect_timeout": CONNECT_S,
            "application_name": "splitslam",
            "options": _options(),
            "keepalives_idle": 5,
            "keepalives_interval": 2,
            "keepalives_count": 3,
            "tcp_user_timeout": round(ANSWER_S * 1e3),
        },
    )
    event.listen(engine, "do_connect", _connect)
    event.listen(engine, "connect", _check_durable)
    event.listen(engine, "begin", _begin)
    return engine


def reading(engine: Engine) -> Engine:
    """The same engine for readers: one snapshot for the whole transaction, which writes nothing."""
    return engine.execution_options(isolation_level="REPEATABLE READ", postgresql_readonly=True)


def may_pass(error: BaseException | None) -> bool:
    """May a failure to connect pass by itself? Not what the server says of user, password or database.

    The driver has no SQLSTATE for it, so the text must do.
    """
    said = str(error)
    return "FATAL" not in said or any(word in said for word in _PASSING)


def _options() -> str:
    limits = {
        "statement_timeout": STATEMENT_S,
        "lock_timeout": LOCK_S,
        "idle_in_transaction_session_timeout": ASLEEP_S,
    }
    settings = {name: str(round(seconds * 1e3)) for name, seconds in limits.items()} | {"synchronous_commit": "on"}
    return " ".join(f"-c {name}={value}" for name, value in settings.items())


def _connect(_dialect: object, _record: object, arguments: Any, options: Any) -> ImpatientConnection:
    return ImpatientConnection.connect(*arguments, **options)


def _check_durable(connection: ImpatientConnection, _record: object) -> None:
    for name, expected in REQUIRED.items():
        row = connection.execute(f"SHOW {name}".encode()).fetchone()
        if row is None or row[0] != expected:
            raise InputError(f"store: the PostgreSQL server has {name}={row and row[0]}: expected {expected}")
    connection.rollback()


def _begin(connection: Connection) -> None:
    if not connection.get_execution_options().get("write", False):
        connection.exec_driver_sql(f"SET LOCAL idle_in_transaction_session_timeout = {round(READING_S * 1e3)}")
