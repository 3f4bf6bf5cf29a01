"""One `Events` call: events out of the store, and a cursor that says which of them somebody has."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

from sqlalchemy import select

from map_service import schema
from map_service.cursor import Cursor
from map_service.following import Scope, Standing, newest_key, standings
from map_service.store import Store
from splitslam.wire import pose_pb2 as pb

PAGE_EVENTS = 500


@dataclass(slots=True)
class Found:
    """What a look at the store has found. content: (number, serialised) by session id."""

    standings: list[Standing]
    newest_key: int
    events: dict[str, list[tuple[int, bytes]]] = field(default_factory=dict)
    more: bool = False


class EventWatch:
    """`look`, in a thread, and `take` by turns. At most PAGE_EVENTS are in memory: the store keeps what waits."""

    def __init__(self, store: Store, scope: Scope, cursor: Cursor | None, *, from_start: bool) -> None:
        """cursor None: all that is kept when `from_start`, else what happens from now on."""
        self._store, self._scope = store, scope
        self._newest_key = cursor.newest_key if cursor else 0 if from_start else None
        self.done = False  # every session that was named has ended, and all of it was told
        self._numbers: dict[str, int] = dict(cursor.numbers) if cursor else {}
        self._lost = 0

    def look(self) -> Found:
        """Asks the store, in one state of it. Raises StoreError."""
        t = schema.events
        with self._store.reading() as connection:
            rows = standings(connection, self._scope, self._numbers, self._newest_key)
            found = Found(rows, newest_key(connection))
            left = PAGE_EVENTS
            for row in rows:
                known = self._known(row)
                if row.events <= known or left == 0:
                    found.more |= row.events > known
                    continue
                query = select(t.c.number, t.c.content).where(t.c.session == row.key, t.c.number > known)
                events = connection.execute(query.order_by(t.c.number).limit(left)).all()
                found.events[row.session_id] = [(number, content) for number, content in events]
                left -= len(events)
                found.more |= left == 0
            return found

    def _known(self, row: Standing) -> int:
        """Number of the newest event that the caller has of a session."""
        number = self._numbers.get(row.session_id)
        if number is None:
            return row.events if self._newest_key is None else 0
        return number if number <= row.events else 0  # deleted, and begun anew under its old name

    def take(self, found: Found) -> Iterator[pb.EventsResponse]:
        """What a look has found; a message a session."""
        for row in found.standings:
            known, new = self._known(row), found.events.get(row.session_id, [])
            if new:
                self._lost += new[0][0] - known - 1
                known = new[-1][0]
            self._numbers[row.session_id] = known
            if new:
                yield self._response([_event(row.session_id, *one) for one in new])
        there = {row.session_id for row in found.standings}
        told = {row.session_id for row in found.standings if row.finished and self._known(row) == row.events}
        if self._scope.session_ids:
            self.done = told == there
            self._newest_key = self._newest_key or found.newest_key
        elif not found.more:  # then all up to the newest that have ended are told, and need not be remembered
            self._newest_key = found.newest_key
            self._numbers = {name: number for name, number in self._numbers.items() if name in there - told}

    def alive(self) -> pb.EventsResponse:
        """A sign of life."""
        return self._response([])

    def _response(self, events: list[pb.Event]) -> pb.EventsResponse:
        cursor = "" if self._newest_key is None else Cursor(self._newest_key, self._numbers).text()
        return pb.EventsResponse(events=events, cursor=cursor, lost=self._lost)


def _event(session_id: str, number: int, content: bytes) -> pb.Event:
    event = pb.Event.FromString(content)
    event.session_id, event.number = session_id, number
    return event
