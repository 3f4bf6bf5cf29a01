"""A session's log of commits, at a store that fails."""

from __future__ import annotations

import pytest

from map_service.commits import Committer
from map_service.config import CommitConfig
from map_service.rows import SessionCommit
from map_service.store import StoreError
from map_service.tally import Tally
from tests.map_service.entries import entry


class FailingStore:
    """Fails a number of times, then works."""

    def __init__(self, failures: int) -> None:
        self.failures = failures
        self.written: list[int] = []

    def commit(self, key: int, epoch: int, commit: SessionCommit) -> None:
        if self.failures:
            self.failures -= 1
            raise StoreError("down")
        self.written.append(commit.commit.last_seq)


def test_a_failing_store_is_tried_again_and_the_order_is_kept() -> None:
    store = FailingStore(failures=2)
    log = Committer(store, CommitConfig(), Tally()).log(1, 1, 0)  # type: ignore[arg-type]
    log.put(entry(0, 3))
    log.put(entry(3, 5))
    log.flush()
    assert store.written == [3, 5]
    assert log.durable_seq == 5


def test_a_store_that_stays_away_is_tried_until_the_service_ends_and_then_nothing_later_is_written() -> None:
    store = FailingStore(failures=10**9)
    committer = Committer(store, CommitConfig(), Tally())  # type: ignore[arg-type]
    log = committer.log(1, 1, 0)
    log.put(entry(0, 3))
    log.put(entry(3, 5))
    with pytest.raises(StoreError, match="still being tried"):
        log.flush(0.2)
    assert committer.away
    assert not log.broken
    committer.give_up_after(0)
    with pytest.raises(StoreError, match="down"):
        log.flush()
    store.failures = 0
    with pytest.raises(StoreError, match="earlier"):
        log.flush()
    assert store.written == []
    assert log.durable_seq == 0
    assert not committer.away
