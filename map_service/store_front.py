"""What every service has in common that answers out of the store: who may read, threads that ask, errors by name."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager
from typing import TypeVar

import grpc
from sqlalchemy import Row

from map_service.access import NO_SITE, check_reader
from map_service.callers import Caller, Callers, DeniedError
from map_service.catalog import Catalog
from map_service.metrics import ServiceMetrics
from map_service.store import Store, StoreError
from splitslam.errors import DataError
from splitslam.logs import fields

A = TypeVar("A")
T = TypeVar("T")
_log = logging.getLogger(__name__)


class StoreFront:
    """Queries run in threads: a large map must not stop the robots' streams."""

    def __init__(self, store: Store, callers: Callers, metrics: ServiceMetrics) -> None:
        self._catalog, self._callers, self._metrics = Catalog(store), callers, metrics

    @asynccontextmanager
    async def _allowed(self, context: grpc.aio.ServicerContext) -> AsyncIterator[Caller]:
        """Who calls; what is denied within is counted and ends the call."""
        try:
            yield self._callers.identify(context)
        except DeniedError as denied:
            self._metrics.denied.inc(denied.reason)
            _log.warning("refused", extra=fields(reason=denied.reason, detail=denied.detail))
            await context.abort(grpc.StatusCode.PERMISSION_DENIED, f"{denied.reason}: {denied.detail}")

    async def _readable(self, session_id: str, context: grpc.aio.ServicerContext) -> Row:
        """The row of a session that the caller may read."""
        async with self._allowed(context) as caller:
            check_reader(caller, session_id.partition("/")[0], None)
            row = await self._row(session_id, context)
            check_reader(caller, row.robot_id, row.site_id or NO_SITE)
        return row

    async def _row(self, session_id: str, context: grpc.aio.ServicerContext) -> Row:
        row = await self._query(context, self._catalog.session, session_id)
        if row is None:
            await context.abort(grpc.StatusCode.NOT_FOUND, f"no session {session_id!r}")
            raise AssertionError  # abort raises
        return row

    async def _query(self, context: grpc.aio.ServicerContext, function: Callable[[A], T], argument: A) -> T:
        try:
            return await asyncio.to_thread(function, argument)
        except StoreError as error:
            await context.abort(grpc.StatusCode.UNAVAILABLE, f"store: {error}"[:200])
        except DataError as error:
            await context.abort(grpc.StatusCode.DATA_LOSS, str(error))
        raise AssertionError  # abort raises


def next_of(iterator: Iterator[T]) -> T | None:
    """None at its end."""
    return next(iterator, None)
