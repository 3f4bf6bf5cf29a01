"""What a store needs now and then: old sessions deleted, old scans put into blocks, its size measured."""

from __future__ import annotations

import asyncio
import logging
import time
from dataclasses import dataclass

from sqlalchemy import and_, or_, select, update
from sqlalchemy.exc import DBAPIError

from map_service import schema
from map_service.block_keeping import BlockKeeper
from map_service.catalog import Catalog, delete_session
from map_service.config import RetentionConfig, ServiceConfig
from map_service.database import StoreError, alone, one_line
from map_service.metrics import ServiceMetrics
from map_service.store import Store
from splitslam.logs import fields
from splitslam.metrics import OTHER

DAY_S = 86_400.0

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Removed:
    """What one deletion by retention removed."""

    session_id: str
    site_id: str
    frames: int
    keyframes: int
    bytes: int


class _UndeletableError(Exception):
    """The session `name` cannot be deleted now; the cause says why."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.name = name


class Retention:
    """Deletes finished sessions that are older than their site keeps them, one replica at a time."""

    def __init__(self, store: Store, config: RetentionConfig) -> None:
        self._store, self._config = store, config

    def run(self, now_s: float) -> list[Removed]:
        """now_s: Unix time. Raises StoreError; what was deleted until then is deleted.

        A session that cannot be deleted is told and left for the next time; those after it are not.
        """
        if not (self._config.finished_days or any(self._config.sites.values())):
            return []
        removed: list[Removed] = []
        left: list[str] = []
        while True:
            try:
                one = self._remove_one(now_s, left)
            except _UndeletableError as failed:
                left.append(failed.name)
                _tell(failed)
                continue
            if one is None:
                return removed
            said = fields(session_id=one.session_id, site_id=one.site_id, frames=one.frames, bytes=one.bytes)
            _log.info("session deleted by retention", extra=said)
            removed.append(one)

    def _remove_one(self, now_s: float, left: list[str]) -> Removed | None:
        """A transaction for each: commits of running sessions come in between. left: not to be tried again.

        Raises _UndeletableError when it has been chosen and cannot be deleted.
        """
        t = schema.sessions
        with self._store.writing() as connection:
            if not alone(connection):
                return None
            # finished under a service that did not note when: it counts from now
            unknown = and_(t.c.finished.is_(True), t.c.finished_s.is_(None))
            connection.execute(update(t).where(unknown).values(finished_s=now_s))
            query = select(t.c.id, t.c.session_id, t.c.site_id).where(t.c.finished.is_(True), self._expired(now_s))
            query = query.where(t.c.session_id.not_in(left)).order_by(t.c.finished_s)
            row = connection.execute(query.limit(1)).first()
            if row is None:
                return None
            try:
                d = delete_session(connection, row.session_id)
            except Exception as error:
                raise _UndeletableError(row.session_id) from error
            return None if d is None else Removed(row.session_id, row.site_id, d.frames, d.keyframes, d.bytes)

    def _expired(self, now_s: float):
        t, named = schema.sessions, self._config.sites
        rules = [
            and_(t.c.site_id == site, t.c.finished_s < now_s - days * DAY_S) for site, days in named.items() if days
        ]
        if self._config.finished_days:
            rest = t.c.finished_s < now_s - self._config.finished_days * DAY_S
            rules.append(and_(t.c.site_id.not_in(list(named)), rest))
        return or_(*rules)


def _tell(failed: _UndeletableError) -> None:
    cause = failed.__cause__
    if isinstance(cause, DBAPIError):
        said = fields(session_id=failed.name, detail=one_line(cause.orig))
        _log.warning("session not deleted by retention", extra=said)
    else:
        _log.exception("session not deleted by retention", extra=fields(session_id=failed.name))


class Housekeeper:
    """The service's own: does all three every `housekeeping_s` in a thread beside the event loop."""

    def __init__(self, store: Store, config: ServiceConfig, metrics: ServiceMetrics) -> None:
        self._store, self._config, self._metrics = store, config, metrics
        self._catalog = Catalog(store)
        self._retention = Retention(store, config.retention)
        self._blocks = BlockKeeper(store, config.poses)

    async def run(self) -> None:
        """Until cancelled."""
        while True:
            await asyncio.to_thread(self.look)
            await asyncio.sleep(self._config.housekeeping_s)

    def look(self) -> None:
        """Each of the three, whatever became of the others."""
        for task in (self._delete_old, self._keep_blocks, self._measure):
            try:
                task()
            except StoreError as error:
                _log.warning("housekeeping failed", extra=fields(task=task.__name__.strip("_"), detail=str(error)))
            except Exception:  # a defect in one must not end all of it for as long as the service runs
                _log.exception("housekeeping failed", extra=fields(task=task.__name__.strip("_")))

    def _delete_old(self) -> None:
        for removed in self._retention.run(time.time()):
            self._metrics.retention.inc()
            self._metrics.retention_bytes.inc(by=removed.bytes)

    def _keep_blocks(self) -> None:
        kept = self._blocks.run(time.time())
        self._metrics.scans_closed.inc(by=kept.closed)
        self._metrics.scans_thinned.inc(by=kept.thinned)

    def _measure(self) -> None:
        """By site only for those that the configuration names: labels are bounded."""
        named = self._metrics.sites
        by_site = dict.fromkeys([*named, OTHER], 0)
        for site, size in self._catalog.bytes_by_site().items():
            by_site[site if site in named else OTHER] += size
        for site, size in by_site.items():
            self._metrics.store_bytes.set(size, site)
        self._metrics.database_bytes.set(self._store.size_bytes())
