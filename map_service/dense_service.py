"""DenseService: whole scans of keyframes, out of the way of the robots' streams: no worker has to do with them."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator

import grpc

from map_service.access import check_robot
from map_service.callers import Caller, Callers
from map_service.client_limits import ClientLimits, wait_turn
from map_service.config import ServiceConfig
from map_service.dense_receiver import DenseReceiver
from map_service.dense_store import DenseStore
from map_service.hello import RefusedError, session_id_of
from map_service.metrics import ServiceMetrics
from map_service.store import Store
from map_service.store_front import StoreFront
from splitslam.logs import fields
from splitslam.wire import dense_pb2 as pb
from splitslam.wire import dense_pb2_grpc as rpc
from splitslam.wire import session_pb2

SERVICE = "splitslam.v1.DenseService"
_SILENT_S = 60.0  # a robot whose link is not idle for so long offers again
_log = logging.getLogger(__name__)


class DenseFront(StoreFront, rpc.DenseServiceServicer):
    """For robots."""

    def __init__(self, config: ServiceConfig, store: Store, callers: Callers, metrics: ServiceMetrics) -> None:
        super().__init__(store, callers, metrics)
        self._clouds = DenseStore(store, config.quota)
        self._clients = ClientLimits(config.limits.client)
        self._opening_s = config.limits.hello_s

    async def Upload(
        self, requests: AsyncIterator[pb.UploadRequest], context: grpc.aio.ServicerContext
    ) -> AsyncIterator[pb.UploadResponse]:
        opening = await self._opening(requests, context)
        async with self._allowed(context) as caller:
            check_robot(caller, opening, context.invocation_metadata() or ())
            with self._clients.stream(opening.robot_id):
                async for answer in self._serve(requests, context, session_id_of(opening), caller):
                    yield answer

    async def _opening(
        self, requests: AsyncIterator[pb.UploadRequest], context: grpc.aio.ServicerContext
    ) -> session_pb2.Hello:
        """Whose clouds they are, as far as a Hello says it."""
        request = await self._next(requests, self._opening_s)
        said = request.open if request is not None else pb.UploadOpen()
        hello = session_pb2.Hello(robot_id=said.robot_id, run_id=said.run_id, site_id=said.site_id)
        try:
            session_id_of(hello)
        except RefusedError as refusal:
            await context.abort(grpc.StatusCode.INVALID_ARGUMENT, refusal.message.detail.replace("hello.", "open."))
        return hello

    async def _serve(
        self,
        requests: AsyncIterator[pb.UploadRequest],
        context: grpc.aio.ServicerContext,
        session_id: str,
        caller: Caller,
    ) -> AsyncIterator[pb.UploadResponse]:
        """Until the robot is silent. Raises DeniedError when its certificate is revoked meanwhile."""
        receiver, turns = DenseReceiver(self._clouds, session_id), self._clients.messages()
        yield pb.UploadResponse(verdict=pb.CLOUD_VERDICT_WANTED)
        while (request := await self._next(requests, _SILENT_S)) is not None:
            self._callers.check_revoked(caller)
            if await wait_turn(turns):
                self._metrics.throttled.inc()
            self._metrics.received_bytes.inc(by=request.ByteSize())
            answer = await self._query(context, receiver.take, request)
            self._count(answer, session_id)
            yield answer

    def _count(self, answer: pb.UploadResponse, session_id: str) -> None:
        """Each cloud once, by what became of it."""
        verdict = answer.verdict
        if verdict == pb.CLOUD_VERDICT_WANTED:
            return
        word = pb.CloudVerdict.Name(verdict).removeprefix("CLOUD_VERDICT_").lower()
        self._metrics.dense_clouds.inc(word)
        if verdict == pb.CLOUD_VERDICT_STORED:
            self._metrics.dense_bytes.inc(by=answer.received_bytes)
        if verdict == pb.CLOUD_VERDICT_REFUSED:
            _log.warning("dense cloud refused", extra=fields(session_id=session_id, detail=answer.detail))

    async def _next(self, requests: AsyncIterator[pb.UploadRequest], within_s: float) -> pb.UploadRequest | None:
        """None: the robot has said all it will for now."""
        try:
            return await asyncio.wait_for(anext(requests), within_s)
        except (TimeoutError, StopAsyncIteration):
            return None
