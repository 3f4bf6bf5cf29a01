"""Finished sessions are deleted when they are old enough, each once, whoever does it."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import pytest
from sqlalchemy import Connection, event, insert, text, update
from sqlalchemy.exc import OperationalError

from map_service import catalog, housekeeping, schema
from map_service.catalog import Catalog
from map_service.config import RetentionConfig
from map_service.housekeeping import DAY_S, Retention
from map_service.store import Store, StoreError
from tests.map_service.entries import OPENING, entry, with_move

NOW_S = 1_800_000_000.0


def finished(store: Store, name: str, days_ago: float | None, site: str = "site") -> None:
    opened = store.open_session(replace(OPENING, session_id=name, site_id=site))
    store.commit(opened.key, 1, with_move(entry(0, 3, keyframes=(0,), holes=[(2, 0)], finished=True), 2))
    with store.writing() as connection:
        when_s = None if days_ago is None else NOW_S - days_ago * DAY_S
        connection.execute(update(schema.sessions).where(schema.sessions.c.id == opened.key).values(finished_s=when_s))


def left(store: Store) -> list[str]:
    return [row.session_id for row in Catalog(store).sessions()]


def test_what_is_older_than_its_site_keeps_it_is_deleted_and_reported(store: Store) -> None:
    finished(store, "new", 9.9)
    finished(store, "old", 10.1)
    finished(store, "short/kept", 0.9, "short")
    finished(store, "short/gone", 1.1, "short")
    finished(store, "archive", 1000, "for ever")
    store.open_session(replace(OPENING, session_id="running"))
    retention = Retention(store, RetentionConfig(finished_days=10, sites={"short": 1, "for ever": 0}))
    removed = retention.run(NOW_S)
    assert [(r.session_id, r.site_id, r.frames, r.keyframes) for r in removed] == [
        ("old", "site", 3, 1),
        ("short/gone", "short", 3, 1),
    ]
    assert removed[0].bytes > 0
    assert left(store) == ["new", "short/kept", "archive", "running"]
    with store.reading() as connection:
        for table in schema.SESSION_TABLES:
            opened = table is schema.events  # that one has been, is all that is known of "running"
            later = table in (schema.pose_blocks, schema.anchors, schema.dense_clouds)  # filled after commits
            assert len({row.session for row in connection.execute(table.select())}) == (0 if later else 3 + opened)


def test_a_session_of_which_nobody_noted_the_end_counts_from_when_it_is_seen(store: Store) -> None:
    finished(store, "unknown", None)
    retention = Retention(store, RetentionConfig(finished_days=10))
    assert retention.run(NOW_S) == []
    assert retention.run(NOW_S + 9 * DAY_S) == []
    assert len(retention.run(NOW_S + 11 * DAY_S)) == 1


def test_replicas_delete_each_session_once(url: str) -> None:
    stores = [Store(url) for _ in range(4)]
    for i in range(12):
        finished(stores[0], f"r/{i}", 20)
    with ThreadPoolExecutor(4) as threads:
        runs = list(threads.map(lambda s: Retention(s, RetentionConfig(finished_days=10)).run(NOW_S), stores))
    assert sorted(r.session_id for run in runs for r in run) == sorted(f"r/{i}" for i in range(12))
    assert left(stores[0]) == []
    for store in stores:
        store.close()


@pytest.mark.parametrize("config", [RetentionConfig(), RetentionConfig(sites={"site": 0})])
def test_without_a_rule_nothing_is_ever_deleted(store: Store, config: RetentionConfig) -> None:
    finished(store, "ancient", 10_000)
    assert Retention(store, config).run(NOW_S) == []
    assert left(store) == ["ancient"]


@pytest.mark.parametrize("database", [True, False])
def test_a_session_that_cannot_be_deleted_does_not_keep_those_after_it(
    store: Store, database: bool, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    for i in range(4):
        finished(store, f"r/{i}", 20 - i)
    delete = housekeeping.delete_session

    def fails(connection: Connection, session_id: str) -> catalog.Deleted | None:
        if session_id in ("r/0", "r/2"):
            if not database:
                raise ValueError("a defect")
            connection.execute(text("DELETE FROM keyframes WHERE session = 'x' / 0 OR nothing"))
        return delete(connection, session_id)

    monkeypatch.setattr(housekeeping, "delete_session", fails)
    retention = Retention(store, RetentionConfig(finished_days=10))
    assert [r.session_id for r in retention.run(NOW_S)] == ["r/1", "r/3"]
    assert left(store) == ["r/0", "r/2"]
    told = [record for record in caplog.records if record.message == "session not deleted by retention"]
    assert [record.exc_info is None for record in told] == [database] * 2
    monkeypatch.setattr(housekeeping, "delete_session", delete)
    assert [r.session_id for r in retention.run(NOW_S)] == ["r/0", "r/2"], "the next time"


def test_a_store_that_goes_away_ends_it(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    finished(store, "r/0", 20)

    def away(_connection: Connection) -> bool:
        raise OperationalError("SELECT", {}, Exception("gone"))

    monkeypatch.setattr(housekeeping, "alone", away)
    with pytest.raises(StoreError, match="gone"):
        Retention(store, RetentionConfig(finished_days=10)).run(NOW_S)


def test_no_statement_has_to_delete_more_than_it_can_in_its_time(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    """Gigabytes of whole scans in one took longer than a statement may: such a session stayed for ever, and with it all
    that are deleted after it."""
    finished(store, "large", 11)
    key, clouds, deleted = Catalog(store).sessions()[0].id, 23, []
    rows = [{"session": key, "keyframe": k, "cloud": bytes(10)} for k in range(clouds)]
    with store.writing() as connection:
        connection.execute(insert(schema.dense_clouds), rows)
    monkeypatch.setitem(catalog._AT_ONCE, "dense_clouds", 10)

    def noted(_connection, cursor, statement: str, *_: object) -> None:
        if statement.startswith("DELETE FROM dense_clouds"):
            deleted.append(cursor.rowcount)

    event.listen(store.engine, "after_cursor_execute", noted)
    assert len(Retention(store, RetentionConfig(finished_days=10)).run(NOW_S)) == 1
    assert deleted == [10, 10, 3]
    assert left(store) == []
