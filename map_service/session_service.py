"""SessionService: sessions and maps out of the store, for operators and tools."""

from __future__ import annotations

from collections.abc import AsyncIterator

import grpc
from sqlalchemy import Row

from map_service.access import NO_SITE, check_operator
from map_service.callers import Callers
from map_service.catalog import StoredKeyframe
from map_service.export import map_pieces
from map_service.graph_export import map_graph
from map_service.graph_messages import graph_to_wire
from map_service.messages import stamped_pose, transform_to_wire
from map_service.metrics import ServiceMetrics
from map_service.store import Store
from map_service.store_front import StoreFront, next_of
from map_service.workers import WorkerPool
from splitslam.maps import MapPiece
from splitslam.thinning import voxel_problem
from splitslam.wire import session_pb2 as pb
from splitslam.wire import session_pb2_grpc as rpc


class SessionFront(StoreFront, rpc.SessionServiceServicer):
    """For operators and tools."""

    def __init__(self, store: Store, pool: WorkerPool, callers: Callers, metrics: ServiceMetrics) -> None:
        super().__init__(store, callers, metrics)
        self._pool = pool

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
        while (page := await self._query(context, next_of, pages)) is not None:
            yield pb.TrajectoryResponse(poses=[stamped_pose(*pose) for pose in page])

    async def StreamMap(
        self, request: pb.StreamMapRequest, context: grpc.aio.ServicerContext
    ) -> AsyncIterator[pb.StreamMapResponse]:
        voxel_m = request.voxel_m
        if problem := voxel_problem(voxel_m):
            await context.abort(grpc.StatusCode.INVALID_ARGUMENT, f"voxel_m {problem}")
        if request.dense and voxel_m:
            await context.abort(grpc.StatusCode.INVALID_ARGUMENT, "voxel_m: expected 0 with dense")
        row = await self._readable(request.session_id, context)
        keyframes = self._catalog.keyframes(row.id, request.first_keyframe, dense=request.dense)
        messages = map(_whole, keyframes) if request.dense else map(_features, map_pieces(keyframes, voxel_m))
        while (message := await self._query(context, next_of, messages)) is not None:
            yield message

    async def PoseGraph(
        self, request: pb.PoseGraphRequest, context: grpc.aio.ServicerContext
    ) -> AsyncIterator[pb.PoseGraphResponse]:
        row = await self._readable(request.session_id, context)
        stored = await self._query(context, self._catalog.graph, row.id)
        for part in graph_to_wire(await self._query(context, map_graph, stored)):
            yield part


def _features(piece: MapPiece) -> pb.StreamMapResponse:
    return pb.StreamMapResponse(
        keyframe=piece.keyframe,
        pose_map_lidar=transform_to_wire(piece.T_map_lidar),
        points=piece.points_map.tobytes(),
        point_count=len(piece.points_map),
        stamp_ns=piece.stamp_ns,
    )


def _whole(keyframe: StoredKeyframe) -> pb.StreamMapResponse:
    """A whole scan goes as it is stored: to decode it is the reader's work, and makes it ten times as large."""
    if keyframe.dense is None:
        return _features(next(map_pieces([keyframe], 0.0)))
    return pb.StreamMapResponse(
        keyframe=keyframe.index,
        pose_map_lidar=transform_to_wire(keyframe.T_map_lidar),
        stamp_ns=keyframe.stamp_ns,
        dense_cloud=keyframe.dense,
    )


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
