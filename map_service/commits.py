"""Commits on their way to the store: off the answer's path, in order, tried again for as long as the store fails."""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor

from map_service.config import CommitConfig
from map_service.database import StoreError
from map_service.rows import SessionCommit
from map_service.store import FencedError, Store
from map_service.tally import Tally
from splitslam.logs import fields

FLUSH_S = 2.0
_RETRY_FIRST_S = 0.05
_RETRY_CAP_S = 0.5
_SLOW_S = 1.0

_log = logging.getLogger(__name__)


class Committer:
    """One thread that writes for all sessions of a worker: an fsync must not stop the pipeline thread."""

    def __init__(self, store: Store, config: CommitConfig, tally: Tally) -> None:
        self._store, self._config, self._tally = store, config, tally
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="commit")
        self._trying_since_s: float | None = None
        self._failing = False
        self._until_s = float("inf")

    @property
    def away(self) -> bool:
        """The store has failed at its last commit, or takes long over one: nobody should wait for it."""
        since_s = self._trying_since_s
        return self._failing or (since_s is not None and time.monotonic() - since_s > _SLOW_S)

    def log(self, key: int, epoch: int, last_seq: int) -> CommitLog:
        return CommitLog(self, self._config, key, epoch, last_seq)

    def submit(self, log: CommitLog, epoch: int, entry: SessionCommit) -> Future[None]:
        return self._thread.submit(self._write, log, epoch, entry)

    def run(self, job: Callable[[], None]) -> Future[None]:
        """Something else that waits for the store, between commits."""
        return self._thread.submit(job)

    def give_up_after(self, seconds: float) -> None:
        """The worker drains: what the store does not take until then is the robots' to send again."""
        self._until_s = time.monotonic() + seconds

    def _write(self, log: CommitLog, epoch: int, entry: SessionCommit) -> None:
        if log.broken:
            raise StoreError("an earlier commit of this session has failed")
        start_s = time.monotonic()
        try:
            self._write_until_done(log.key, epoch, entry)
        except FencedError:
            log.broken = True
            self._tally.count("commits", "fenced")
            raise
        except BaseException:
            log.broken = True
            self._tally.count("commits", "failed")
            raise
        finally:
            self._trying_since_s, self._failing = None, False
        self._tally.count("commits", "ok")
        self._tally.observe("commit_seconds", time.monotonic() - start_s)
        self._tally.observe("commit_bytes", entry.bytes)
        for (metric, label), count in entry.commit.outcomes.items():
            self._tally.count(metric, label, by=count)

    def _write_until_done(self, key: int, epoch: int, entry: SessionCommit) -> None:
        start_s, wait_s = time.monotonic(), _RETRY_FIRST_S
        while True:
            self._trying_since_s = time.monotonic()
            try:
                self._store.commit(key, epoch, entry)
                break
            except StoreError as error:
                if time.monotonic() + wait_s > self._until_s:
                    raise
                if not self._failing:
                    _log.warning("the store is away", extra=fields(detail=str(error)))
                self._failing = True
                self._tally.count("commits", "retried")
            time.sleep(wait_s)
            wait_s = min(2 * wait_s, _RETRY_CAP_S)
        if self._failing:
            _log.info("the store is back", extra=fields(after_s=round(time.monotonic() - start_s, 3)))


class CommitLog:
    """Where one session stands: applied by its thread, taken into a commit, durable in the store."""

    def __init__(self, committer: Committer, config: CommitConfig, key: int, epoch: int, last_seq: int) -> None:
        self.key, self.epoch = key, epoch
        self.applied_seq = self.taken_seq = self.durable_seq = last_seq
        self.broken = False
        self._committer, self._config = committer, config
        self._pending: deque[tuple[int, Future[None]]] = deque()
        self._taken_s = time.monotonic()

    @property
    def waiting(self) -> bool:
        return bool(self._pending)

    @property
    def undurable(self) -> int:
        """Frames applied and not durable."""
        return self.applied_seq - self.durable_seq

    @property
    def full(self) -> bool:
        """So much is applied and not durable that nothing more may be applied: memory is bounded."""
        return self.undurable >= self._config.backlog_frames

    def due(self) -> bool:
        """By time or by number of frames, also when the robot stands."""
        new = self.applied_seq - self.taken_seq
        if new == 0:
            return False
        return new >= self._config.every_frames or time.monotonic() - self._taken_s >= self._config.every_s

    def put(self, entry: SessionCommit) -> None:
        """Hand over everything from taken_seq to applied_seq."""
        self.taken_seq = entry.commit.last_seq
        self._taken_s = time.monotonic()
        self._pending.append((self.taken_seq, self._committer.submit(self, self.epoch, entry)))

    def collect(self) -> None:
        """Take note of what has become durable. Raises FencedError or StoreError of a commit that failed."""
        while self._pending and self._pending[0][1].done():
            seq, future = self._pending.popleft()
            future.result()
            self.durable_seq = seq

    def flush(self, timeout_s: float = FLUSH_S) -> None:
        """Wait for everything handed over. Raises as `collect`; StoreError, with nothing lost, when it takes long."""
        until_s = time.monotonic() + timeout_s
        while self._pending:
            seq, future = self._pending[0]
            try:
                future.exception(max(0.0, until_s - time.monotonic()))
            except TimeoutError:
                raise StoreError(f"the commit of frames up to {seq} is still being tried") from None
            self.collect()
