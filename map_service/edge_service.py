"""EdgeService: a robot's stream, passed between gRPC and its worker without touching what is in it."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator

import grpc
from google.protobuf.message import DecodeError as WireError

from map_service.config import ServiceConfig
from map_service.hello import RefusedError, session_id_of
from map_service.metrics import ServiceMetrics
from map_service.streams import End, RobotStream
from map_service.workers import WorkerPool, WorkerProcess
from splitslam.wire import session_pb2 as pb

OVERLOADED_RETRY_MS = 1000
DRAIN_RETRY_MS = 100

_log = logging.getLogger(__name__)


class EdgeFront:
    """Handles `EdgeService.Stream` on serialised messages: the worker is the one that parses and answers."""

    def __init__(self, config: ServiceConfig, pool: WorkerPool, metrics: ServiceMetrics) -> None:
        self._config, self._pool, self._metrics = config, pool, metrics
        self._draining = False
        self._open = 0

    def handler(self) -> grpc.GenericRpcHandler:
        stream = grpc.stream_stream_rpc_method_handler(self.stream)
        return grpc.method_handlers_generic_handler("splitslam.v1.EdgeService", {"Stream": stream})

    async def stream(self, requests: AsyncIterator[bytes], context: grpc.aio.ServicerContext) -> AsyncIterator[bytes]:
        try:
            hello = await self._hello(requests, context)
            session_id = session_id_of(hello)
            self._admit()
        except RefusedError as refusal:
            self._count_refusal(refusal.message)
            yield pb.StreamResponse(refused=refusal.message).SerializeToString()
            return
        self._open += 1
        self._metrics.streams.set(self._open)
        try:
            worker, stream = await self._pool.open(session_id, hello.SerializeToString())
            reader = asyncio.create_task(self._read(requests, worker, stream))
            try:
                while not isinstance(item := await stream.outbox.get(), End):
                    yield item
                if item.status is not None:
                    await context.abort(item.status, item.detail)
            finally:
                reader.cancel()
                stream.end()
                await self._pool.close(worker, stream)
        finally:
            self._open -= 1
            self._metrics.streams.set(self._open)

    async def _hello(self, requests: AsyncIterator[bytes], context: grpc.aio.ServicerContext) -> pb.Hello:
        try:
            body = await asyncio.wait_for(anext(requests), self._config.limits.hello_s)
            first = pb.StreamRequest.FromString(body)
        except (TimeoutError, StopAsyncIteration, WireError):
            first = pb.StreamRequest()
        if first.WhichOneof("message") != "hello":
            raise RefusedError(pb.REFUSED_REASON_BAD_HELLO, "expected Hello as the first message of a stream")
        return first.hello

    def _admit(self) -> None:
        if self._draining:
            raise RefusedError(pb.REFUSED_REASON_OVERLOADED, "shutting down", OVERLOADED_RETRY_MS)
        if self._open >= self._config.limits.max_streams:
            detail = f"{self._open} streams are open, the limit is {self._config.limits.max_streams}"
            raise RefusedError(pb.REFUSED_REASON_OVERLOADED, detail, OVERLOADED_RETRY_MS)

    def _count_refusal(self, refused: pb.Refused) -> None:
        reason = pb.RefusedReason.Name(refused.reason).removeprefix("REFUSED_REASON_").lower()
        self._metrics.refused.labels(reason).inc()
        _log.warning("refused", extra={"fields": {"reason": reason, "detail": refused.detail}})

    async def _read(self, requests: AsyncIterator[bytes], worker: WorkerProcess, stream: RobotStream) -> None:
        """Robot to worker, no faster than frames are answered. A robot that has said all it will stays connected."""
        try:
            async for body in requests:
                if pb.StreamRequest.FromString(body).HasField("frame"):
                    await stream.admit()
                await self._pool.request(worker, stream, body)
        except WireError:
            stream.end(grpc.StatusCode.INVALID_ARGUMENT, "not a StreamRequest")
        except Exception:
            _log.exception("stream failed", extra={"fields": {"session": stream.session_id}})
            stream.end(grpc.StatusCode.INTERNAL, "the stream failed: see the service's log")

    def drain(self) -> None:
        """No new streams; those that are open hear that this replica is going."""
        self._draining = True
        drain = pb.Drain(reason=pb.DRAIN_REASON_SHUTDOWN, retry_after_ms=DRAIN_RETRY_MS)
        for stream in self._pool.streams:
            stream.put_message(pb.StreamResponse(drain=drain))
