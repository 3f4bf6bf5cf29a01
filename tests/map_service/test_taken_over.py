"""What another replica goes on with is let go here."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from map_service.catalog import Catalog
from map_service.database import StoreError
from map_service.store import Store
from map_service.taken_over import TakenOver
from tests.map_service.entries import OPENING


def at_once(job: Callable[[], None]) -> Future[None]:
    """As the committer's thread runs it."""
    done: Future[None] = Future()
    try:
        done.set_result(job())
    except StoreError as error:
        done.set_exception(error)
    return done


def held(key: int, epoch: int, stream: int | None = None) -> Any:
    return SimpleNamespace(log=SimpleNamespace(key=key, epoch=epoch), stream=stream)


@pytest.fixture
def store(tmp_path: Path) -> Any:
    store = Store(f"sqlite:///{tmp_path / 'map.db'}")
    yield store
    store.close()


def found(store: Store, *sessions: Any) -> list[Any]:
    taken_over = TakenOver(Catalog(store), every_s=0.0)
    assert taken_over.of(sessions, at_once) == [], "it waits for nothing"
    return taken_over.of(sessions, at_once)


def test_a_session_that_was_opened_elsewhere_or_deleted_is_found_and_its_own_are_not(store: Store) -> None:
    first = store.open_session(OPENING)
    store.open_session(OPENING)
    mine = store.open_session(replace(OPENING, session_id="other/run", run_id="run", robot_id="other"))
    gone, own, busy = held(first.key, 1), held(mine.key, 1), held(first.key, 1, stream=3)
    deleted = held(mine.key + 7, 1)
    assert found(store, gone, own, busy, deleted) == [gone, deleted]


def test_one_whose_robot_came_back_here_meanwhile_is_kept(store: Store) -> None:
    opened = store.open_session(OPENING)
    store.open_session(OPENING)
    session, taken_over = held(opened.key, 1), TakenOver(Catalog(store), every_s=0.0)
    taken_over.of([session], at_once)
    session.log.epoch = 3  # opened here again after the look
    assert taken_over.of([session], at_once) == []


def test_while_the_store_is_away_nothing_is_let_go(store: Store) -> None:
    opened = store.open_session(OPENING)
    store.open_session(OPENING)

    class Away(Catalog):
        def epochs(self, keys: Any) -> dict[int, int]:
            raise StoreError("away")

    taken_over, session = TakenOver(Away(store), every_s=0.0), held(opened.key, 1)
    assert taken_over.of([session], at_once) == taken_over.of([session], at_once) == []
