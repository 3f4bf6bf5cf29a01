"""PoseService: poses, events and map points for other services, out of the store and, where it is quicker, live."""

from __future__ import annotations

import math
from collections.abc import AsyncIterator

import grpc
import numpy as np

from map_service.access import check_follower
from map_service.callers import Caller
from map_service.cursor import Cursor, CursorError
from map_service.event_watch import EventWatch
from map_service.following import MOST_SESSIONS, Scope
from map_service.live_answers import LiveAnswers
from map_service.messages import transform_to_wire
from map_service.nearby import MAX_POINTS, MAX_RADIUS_M, MIN_RADIUS_M, Around, around, nearby_pieces
from map_service.pose_at import NotKnownError, PoseAt, SessionPoses
from map_service.pose_watch import PoseWatch, Start
from map_service.scan_poses import read_lidar_body
from map_service.store import Store
from map_service.store_front import StoreFront, next_of
from map_service.watches import TooManyWatchesError, Watches
from splitslam.thinning import voxel_problem
from splitslam.wire import pose_pb2 as pb
from splitslam.wire import pose_pb2_grpc as rpc

_NAMED = 100  # sessions that a call may name


class PoseFront(StoreFront, rpc.PoseServiceServicer):
    """What a call may ask for is checked here; what comes of it is made elsewhere."""

    def __init__(self, store: Store, watches: Watches, live: LiveAnswers) -> None:
        super().__init__(store, watches.callers, watches.metrics)
        self._store, self._watches, self._live = store, watches, live

    async def WatchPoses(
        self, request: pb.WatchPosesRequest, context: grpc.aio.ServicerContext
    ) -> AsyncIterator[pb.WatchPosesResponse]:
        caller, scope = await self._scope(request.sessions, context)
        if len(request.after_seq) > MOST_SESSIONS:
            await context.abort(grpc.StatusCode.INVALID_ARGUMENT, f"after_seq: expected at most {MOST_SESSIONS}")
        try:
            start = Start(scope, Cursor.parse(request.cursor), dict(request.after_seq), request.from_start)
            watch = PoseWatch(self._store, start, self._watches.backlog, self._watches.count_dropped)
            async for response in self._watches.poses(watch, caller, self._live, context):
                yield response
        except CursorError as error:
            await context.abort(grpc.StatusCode.INVALID_ARGUMENT, str(error))
        except TooManyWatchesError as error:
            await context.abort(grpc.StatusCode.RESOURCE_EXHAUSTED, str(error))

    async def Events(
        self, request: pb.EventsRequest, context: grpc.aio.ServicerContext
    ) -> AsyncIterator[pb.EventsResponse]:
        caller, scope = await self._scope(request.sessions, context)
        try:
            cursor = Cursor.parse(request.cursor)
            watch = EventWatch(self._store, scope, cursor, from_start=request.from_start)
            async for response in self._watches.events(watch, caller, context):
                yield response
        except CursorError as error:
            await context.abort(grpc.StatusCode.INVALID_ARGUMENT, str(error))
        except TooManyWatchesError as error:
            await context.abort(grpc.StatusCode.RESOURCE_EXHAUSTED, str(error))

    async def PoseAt(self, request: pb.PoseAtRequest, context: grpc.aio.ServicerContext) -> pb.PoseAtResponse:
        row = await self._readable(request.session_id, context)

        def find(key: int) -> tuple[PoseAt, np.ndarray]:
            with self._store.reading() as connection:
                found = SessionPoses(connection, key).at(request.stamp_ns, request.map_version)
                return found, read_lidar_body(connection, key)

        try:
            found, T_lidar_body = await self._query(context, find, row.id)
        except NotKnownError as error:
            await context.abort(grpc.StatusCode.OUT_OF_RANGE, f"{request.session_id}: {error}")
            raise AssertionError from None  # abort raises
        return pb.PoseAtResponse(
            pose_map_lidar=transform_to_wire(found.T_map_lidar),
            pose_map_body=transform_to_wire(found.T_map_lidar @ T_lidar_body),
            covariance=() if found.covariance is None else found.covariance.ravel().tolist(),
            state=int(found.state),  # type: ignore[arg-type]
            map_version=found.map_version,
            newest_map_version=found.newest_version,
            oldest_map_version=found.oldest_version,
            seq_before=found.seq_before,
            seq_after=found.seq_after,
            thinned=found.thinned,
        )

    async def LocalMap(
        self, request: pb.LocalMapRequest, context: grpc.aio.ServicerContext
    ) -> AsyncIterator[pb.LocalMapResponse]:
        if problem := _local_map_problem(request):
            await context.abort(grpc.StatusCode.INVALID_ARGUMENT, problem)
        row = await self._readable(request.session_id, context)
        at = request.pose_map_lidar
        centre = np.array([at.tx_m, at.ty_m, at.tz_m]) if request.HasField("pose_map_lidar") else None

        def look(key: int) -> Around:
            return around(self._store, key, centre, request.radius_m)

        try:
            place = await self._query(context, look, row.id)
        except NotKnownError as error:
            await context.abort(grpc.StatusCode.OUT_OF_RANGE, f"{request.session_id}: {error}")
            raise AssertionError from None  # abort raises
        most = request.max_points or MAX_POINTS
        pieces = nearby_pieces(self._store, row.id, place, request.radius_m, request.voxel_m, most)
        while (found := await self._query(context, next_of, pieces)) is not None:
            yield pb.LocalMapResponse(
                keyframe=found.piece.keyframe,
                pose_map_lidar=transform_to_wire(found.piece.T_map_lidar),
                points=found.piece.points_map.tobytes(),
                point_count=len(found.piece.points_map),
                map_version=found.map_version,
                truncated=found.truncated,
            )

    async def _scope(self, selection: pb.SessionSelection, context: grpc.aio.ServicerContext) -> tuple[Caller, Scope]:
        """Who calls, and what of it he may follow."""
        for name, given in (("session_ids", selection.session_ids), ("robot_ids", selection.robot_ids)):
            if len(given) > _NAMED:
                detail = f"sessions.{name}: {len(given)}, expected at most {_NAMED}"
                await context.abort(grpc.StatusCode.INVALID_ARGUMENT, detail)
        asked = Scope(frozenset(selection.session_ids), frozenset(selection.robot_ids), selection.site_id)
        async with self._allowed(context) as caller:
            scope = check_follower(caller, asked)
        for session_id in sorted(scope.session_ids):
            await self._readable(session_id, context)
        return caller, scope


def _local_map_problem(request: pb.LocalMapRequest) -> str | None:
    at = request.pose_map_lidar
    if not MIN_RADIUS_M <= request.radius_m <= MAX_RADIUS_M:  # true for NaN
        return f"radius_m {request.radius_m:g}: expected {MIN_RADIUS_M:g} to {MAX_RADIUS_M:g}"
    if problem := voxel_problem(request.voxel_m):
        return f"voxel_m {problem}"
    if request.max_points > MAX_POINTS:
        return f"max_points {request.max_points}: expected at most {MAX_POINTS}"
    if not all(math.isfinite(v) for v in (at.tx_m, at.ty_m, at.tz_m)):
        return "pose_map_lidar: expected numbers"
    return None
