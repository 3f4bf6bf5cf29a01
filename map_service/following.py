"""Which sessions somebody follows, and how far each of them has come by the store."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from sqlalchemy import ColumnElement, Connection, func, or_, select

from map_service import schema

MOST_SESSIONS = 1000  # followed by one call, the newest


@dataclass(frozen=True, slots=True)
class Scope:
    """Sessions that are in all that is given. session_ids: those alone, also when they have ended."""

    session_ids: frozenset[str] = frozenset()
    robot_ids: frozenset[str] = frozenset()
    site_id: str = ""

    def conditions(self) -> list[ColumnElement[bool]]:
        t = schema.sessions
        found: list[ColumnElement[bool]] = []
        if self.session_ids:
            found.append(t.c.session_id.in_(sorted(self.session_ids)))
        if self.robot_ids:
            found.append(t.c.robot_id.in_(sorted(self.robot_ids)))
        if self.site_id:
            found.append(t.c.site_id == self.site_id)
        return found


@dataclass(frozen=True, slots=True)
class Standing:
    """A session as one look at the store found it. events: number of the newest."""

    key: int
    session_id: str
    last_seq: int
    finished: bool
    map_version: int
    events: int


def standings(connection: Connection, scope: Scope, known: Collection[str], after_key: int | None) -> list[Standing]:
    """Those of the scope that have not ended, are `known`, or were opened after that of key `after_key`; oldest first.

    At most MOST_SESSIONS, the newest.
    """
    t = schema.sessions
    version, events = func.coalesce(t.c.map_version, 1), func.coalesce(t.c.events, 0)
    query = select(t.c.id, t.c.session_id, t.c.last_seq, t.c.finished, version, events).where(*scope.conditions())
    if not scope.session_ids:
        wanted = [t.c.finished.is_(False), t.c.session_id.in_(sorted(known))]
        query = query.where(or_(*wanted) if after_key is None else or_(*wanted, t.c.id > after_key))
    rows = connection.execute(query.order_by(t.c.id.desc()).limit(MOST_SESSIONS)).all()
    return [Standing(*row) for row in reversed(rows)]


def newest_key(connection: Connection) -> int:
    """Of the session that was opened last; 0: there is none."""
    return connection.execute(select(func.coalesce(func.max(schema.sessions.c.id), 0))).scalar_one()
