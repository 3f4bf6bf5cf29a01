"""What only a server can do to its clients: die, freeze, refuse, deadlock."""

from __future__ import annotations

import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest
from sqlalchemy import text, update
from sqlalchemy.exc import DBAPIError

from map_service import postgres as patience
from map_service import schema
from map_service.store import Opening, Store, StoreError
from splitslam.errors import InputError
from tests.map_service.entries import OPENING, entry
from tests.postgres import DatabaseServer


@pytest.fixture
def store(postgres: DatabaseServer) -> Iterator[Store]:
    opened = Store(postgres.empty_database())
    yield opened
    opened.close()


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(patience, "ANSWER_S", 0.5)


def test_a_server_that_was_killed_is_a_store_error_and_serves_again_when_it_is_back(
    postgres: DatabaseServer, store: Store
) -> None:
    opened = store.open_session(OPENING)
    store.commit(opened.key, 1, entry(0, 3, keyframes=(0,)))
    postgres.kill()
    try:
        for _ in range(2):  # on a connection that has died, and when none can be made
            with pytest.raises(StoreError):
                store.commit(opened.key, 1, entry(3, 6))
    finally:
        postgres.start()
    store.commit(opened.key, 1, entry(3, 6))
    assert store.load(opened.key).last_seq == 6


@pytest.mark.usefixtures("impatient")
def test_a_frozen_server_hangs_nobody(postgres: DatabaseServer, store: Store) -> None:
    opened = store.open_session(OPENING)
    with postgres.frozen():
        start_s = time.monotonic()
        with pytest.raises(StoreError):
            store.commit(opened.key, 1, entry(0, 3, keyframes=(0,)))
        assert time.monotonic() - start_s < 60 * patience.ANSWER_S
    store.commit(opened.key, 1, entry(0, 3, keyframes=(0,)))
    assert store.load(opened.key).last_seq == 3


def test_an_owner_frozen_in_the_middle_of_a_commit_does_not_keep_its_successor_out(store: Store) -> None:
    store.open_session(OPENING)
    zombie = store.writing()
    connection = zombie.__enter__()
    connection.execute(update(schema.sessions).values(last_seq=7))
    opened = store.open_session(OPENING)
    assert (opened.epoch, opened.last_seq) == (2, 0)
    with pytest.raises(StoreError):
        zombie.__exit__(None, None, None)


@pytest.mark.parametrize(
    ("sqlstate", "retry"),
    [
        pytest.param("40001", True, id="serialisation failure"),
        pytest.param("40P01", True, id="deadlock"),
        pytest.param("53100", True, id="disk full"),
        pytest.param("55P03", True, id="lock not available"),
        pytest.param("57014", True, id="statement timeout"),
        pytest.param("57P01", True, id="server shut down"),
        pytest.param("25006", True, id="a standby after a failover"),
        pytest.param("22003", False, id="value out of range"),
        pytest.param("23505", False, id="not unique"),
        pytest.param("42P01", False, id="no such table"),
    ],
)
def test_what_may_pass_is_told_from_what_is_wrong(store: Store, sqlstate: str, retry: bool) -> None:
    with pytest.raises(StoreError if retry else DBAPIError), store.writing() as connection:
        connection.execute(text(f"DO $$ BEGIN RAISE SQLSTATE '{sqlstate}'; END $$"))


def test_a_server_that_does_not_sync_its_commits_is_refused(
    postgres: DatabaseServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(patience.REQUIRED, "fsync", "off")
    with pytest.raises(InputError, match="fsync=on: expected off"):
        Store(postgres.empty_database())


@pytest.mark.parametrize("scheme", ["postgres", "postgresql", "postgresql+psycopg"])
def test_a_url_is_taken_as_operators_write_it(postgres: DatabaseServer, scheme: str) -> None:
    store = Store(scheme + "://" + postgres.empty_database().partition("://")[2])
    assert store.engine.dialect.driver == "psycopg"
    store.close()


def test_a_database_that_is_not_there_is_one_line_and_not_waited_for(postgres: DatabaseServer) -> None:
    with pytest.raises(InputError, match='database "nowhere" does not exist') as error:
        Store(postgres.url_of("nowhere"), patience_s=60)
    assert "\n" not in str(error.value)


def test_a_server_that_comes_late_is_waited_for(postgres: DatabaseServer) -> None:
    url = postgres.empty_database()
    postgres.kill()
    try:
        with pytest.raises(InputError, match="cannot be opened"):
            Store(url, patience_s=0.5)
    finally:
        postgres.start()
    Store(url, patience_s=30).close()


def test_many_openings_at_once_make_one_schema(postgres: DatabaseServer) -> None:
    url = postgres.empty_database()
    with ThreadPoolExecutor(8) as threads:
        stores = list(threads.map(Store, [url] * 8))
    assert stores[0].open_session(Opening("r/2", "r", "2", "", "", "")).epoch == 1
    for store in stores:
        store.close()
