"""Who wrote what, noted by the store itself: a trigger on every update of a session (PostgreSQL)."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import psycopg

_MAKE = """
CREATE TABLE chaos_audit (
    id bigserial PRIMARY KEY, session_id text, epoch bigint, last_seq bigint, finished boolean, transaction xid8
);
CREATE FUNCTION chaos_note() RETURNS trigger AS $$
BEGIN
    INSERT INTO chaos_audit (session_id, epoch, last_seq, finished, transaction)
    VALUES (NEW.session_id, NEW.epoch, NEW.last_seq, NEW.finished, pg_current_xact_id());
    RETURN NULL;
END $$ LANGUAGE plpgsql;
CREATE TRIGGER chaos_note AFTER INSERT OR UPDATE OF epoch, last_seq, finished ON sessions
    FOR EACH ROW EXECUTE FUNCTION chaos_note();
"""


@dataclass(frozen=True, slots=True)
class Note:
    """One committed write of an owner to a session's row, in the order of the row's lock.

    Housekeeping, which owns nothing, only books bytes there.
    """

    session_id: str
    epoch: int
    last_seq: int
    finished: bool


class Audit:
    """Installed once the tables are there; its rows are part of the transactions that they describe."""

    def __init__(self, url: str) -> None:
        """url: as SQLAlchemy has it."""
        self._url = url.replace("postgresql+psycopg://", "postgresql://")
        with psycopg.connect(self._url) as connection:
            connection.execute(_MAKE)

    def notes(self) -> list[Note]:
        """One for each transaction that touched a session, as it left it."""
        query = """
            SELECT session_id, epoch, last_seq, finished FROM (
                SELECT *, row_number() OVER (PARTITION BY transaction, session_id ORDER BY id DESC) AS newest
                FROM chaos_audit
            ) AS noted WHERE newest = 1 ORDER BY id
        """
        with psycopg.connect(self._url) as connection:
            return [Note(*row) for row in connection.execute(query)]


def one_owner(notes: list[Note]) -> list[str]:
    """At any time one owner: once a new epoch has begun nothing is written by an older one, and no frame twice."""
    wrong = []
    by_session = sorted(notes, key=lambda note: note.session_id)  # stable: the order within a session stays
    for session_id, group in itertools.groupby(by_session, key=lambda note: note.session_id):
        for before, after in itertools.pairwise(group):
            if before.finished:
                wrong.append(f"{session_id}: written after its end, at {after.last_seq}")
            elif after.epoch < before.epoch:
                wrong.append(f"{session_id}: epoch {after.epoch} wrote after epoch {before.epoch}")
            elif after.last_seq < before.last_seq:
                wrong.append(f"{session_id}: from {before.last_seq} back to {after.last_seq}")
            elif after.epoch > before.epoch and after.last_seq != before.last_seq:
                wrong.append(f"{session_id}: epoch {after.epoch} began with {after.last_seq}, not {before.last_seq}")
    return wrong
