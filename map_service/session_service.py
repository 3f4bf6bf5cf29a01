"""SessionService: sessions and maps out of the store, for operators and tools."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager
from typing import TypeVar

import grpc
from sqlalchemy import Row

from map_service.access import NO_SITE, check_operator, check_reader
from map_service.callers import Caller, Callers, DeniedError
from map_service.catalog import Catalog
from map_service.export import map_pieces
from map_service.graph_export import map_graph
from map_service.graph_messages import graph_to_wire
from map_service.messages import stamped_pose, transform_to_wire
from map_service.metrics import ServiceMetrics
from map_service.store import Store, StoreError
from map_service.workers import WorkerPool
from splitslam.errors import DataError
from splitslam.logs import fields
from splitslam.thinning import voxel_problem
from splitslam.wire import session_pb2 as pb
from splitslam.wire import session_pb2_grpc as rpc

A = TypeVar("A")
T = TypeVar("T")
_log = logging.getLogger(__name__)


class SessionFront(rpc.SessionServiceServicer):
    """Queries run in threads: a large map must not stop the robots' streams."""

    def __init__(self, store: Store, pool: WorkerPool, callers: Callers, metrics: ServiceMetrics) -> None:
        self._catalog, self._pool, self._callers, self._metrics = Catalog(store), pool, callers, metrics

    async def List(self, request: pb.ListRequest, context: grpc.aio.ServicerContext) -> pb.ListResponse:
        async with self._allowed(context) as caller:
            site_id = check_operator(caller, request.site_id)
        rows = await self._query(context, self._catalog.sessions, site_id)
        return pb.ListResponse(sessions=[session_info(row) for row in rows])

    async def Get(self, request: pb.GetRequest, context: grpc.aio.ServicerContext) -> pb.GetResponse:
        return pb.GetResponse(session=session_info(await self._readable(request.session_id, context)))

    async def Delete(self, request: pb.DeleteRequest, context: grpc.aio.ServicerContext) -> pb.DeleteResponse:
        async with self._allowed(context) as caller:
            check_operator(caller, "")
            row = await self._row(request.session_id, context)
            check_operator(caller, row.site_id or NO_SITE)
        if self._pool.is_open(request.session_id):
            await context.abort(grpc.StatusCode.FAILED_PRECONDITION, "a robot's stream has the session open")
        deleted = await self._query(context, self._catalog.delete, request.session_id)
        if deleted is None:
            await context.abort(grpc.StatusCode.NOT_FOUND, f"no session {request.session_id!r}")
            raise AssertionError  # abort raises
        await self._pool.forget(request.session_id)
        return pb.DeleteResponse(frames=deleted.frames, keyframes=deleted.keyframes, bytes=deleted.bytes)

    async def Trajectory(
        self, request: pb.TrajectoryRequest, context: grpc.aio.ServicerContext
    ) -> AsyncIterator[pb.TrajectoryResponse]:
        row = await self._readable(request.session_id, context)
        pages = self._catalog.trajectory(row.id)
        while (page := await self._query(context, _next, pages)) is not None:
            yield pb.TrajectoryResponse(poses=[stamped_pose(*pose) for pose in page])

    async def StreamMap(
        self, request: pb.StreamMapRequest, context: grpc.aio.ServicerContext
    ) -> AsyncIterator[pb.StreamMapResponse]:
        voxel_m = request.voxel_m
        if problem := voxel_problem(voxel_m):
            await context.abort(grpc.StatusCode.INVALID_ARGUMENT, f"voxel_m {problem}")
        row = await self._readable(request.session_id, context)
        pieces = map_pieces(self._catalog.keyframes(row.id), voxel_m)
        while (piece := await self._query(context, _next, pieces)) is not None:
            yield pb.StreamMapResponse(
                keyframe=piece.keyframe,
                pose_map_lidar=transform_to_wire(piece.T_map_lidar),
                points=piece.points_map.tobytes(),
                point_count=len(piece.points_map),
                stamp_ns=piece.stamp_ns,
            )

    async def PoseGraph(
        self, request: pb.PoseGraphRequest, context: grpc.aio.ServicerContext
    ) -> AsyncIterator[pb.PoseGraphResponse]:
        row = await self._readable(request.session_id, context)
        stored = await self._query(context, self._catalog.graph, row.id)
        for part in graph_to_wire(await self._query(context, map_graph, stored)):
            yield part

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


def _next(iterator: Iterator[T]) -> T | None:
    return next(iterator, None)


def session_info(row: Row) -> pb.SessionInfo:
    """A row of `schema.sessions`."""
    return pb.SessionInfo(
        session_id=row.session_id,
        robot_id=row.robot_id,
        run_id=row.run_id,
        site_id=row.site_id,
        map_id=row.map_id,
        finished=row.finished,
        epoch=row.epoch,
        durable_seq=row.last_seq,
        first_stamp_ns=row.first_stamp_ns,
        last_stamp_ns=row.last_stamp_ns,
        frames=row.frames,
        keyframes=row.keyframes,
        loops=row.loops,
        gnss_factors=row.gnss_factors,
        store_bytes=row.bytes,
        statistics_json=row.statistics,
    )
