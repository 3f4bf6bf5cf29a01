"""EdgeService: a robot's stream, passed between gRPC and its worker without touching what is in it."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator
from contextlib import ExitStack
from itertools import zip_longest

import grpc
from google.protobuf.message import DecodeError as WireError

from map_service.access import check_robot
from map_service.callers import Caller, Callers, DeniedError
from map_service.client_limits import Bucket, ClientLimits, wait_turn
from map_service.config import ServiceConfig
from map_service.hello import RefusedError, session_id_of
from map_service.membership import Peers, as_hint
from map_service.messages import refusal_word
from map_service.metrics import ServiceMetrics
from map_service.streams import End, RobotStream
from map_service.worker_process import WorkerProcess
from map_service.workers import WorkerPool
from splitslam.logs import fields
from splitslam.wire import session_pb2 as pb

_REASSURE_S = 0.15
_REVOKED_S = 5.0
_TOO_MANY_RETRY_MS = 1000
OVERLOADED_RETRY_MS = 50  # the robot goes to another replica at once, and spreads its tries from then on

_log = logging.getLogger(__name__)


class EdgeFront:
    """Handles `EdgeService.Stream` on serialised messages: the worker is the one that parses and answers."""

    def __init__(self, config: ServiceConfig, pool: WorkerPool, metrics: ServiceMetrics, callers: Callers) -> None:
        self._config, self._pool, self._metrics, self._callers = config, pool, metrics, callers
        self._clients = ClientLimits(config.limits.client)
        self._draining = False
        self._open = 0

    @property
    def open(self) -> int:
        """Streams that are open; may be read by any thread."""
        return self._open

    def handler(self) -> grpc.GenericRpcHandler:
        stream = grpc.stream_stream_rpc_method_handler(self.stream)
        return grpc.method_handlers_generic_handler("splitslam.v1.EdgeService", {"Stream": stream})

    async def stream(self, requests: AsyncIterator[bytes], context: grpc.aio.ServicerContext) -> AsyncIterator[bytes]:
        if self._draining:  # before any message, so that the proxy tries another replica by itself
            await context.abort(grpc.StatusCode.UNAVAILABLE, "shutting down")
        session_id = ""
        with ExitStack() as cleanup:
            try:
                caller = self._callers.identify(context)
                hello = await self._hello(requests)
                session_id = session_id_of(hello)
                check_robot(caller, hello, context.invocation_metadata() or ())
                cleanup.enter_context(self._clients.stream(hello.robot_id))
                self._admit(session_id)
            except (RefusedError, DeniedError) as refusal:
                yield pb.StreamResponse(refused=self._refused(refusal, session_id)).SerializeToString()
                return
            self._count_open(1)
            cleanup.callback(self._count_open, -1)
            async for answer in self._serve(requests, context, caller, session_id, hello):
                yield answer

    async def _serve(
        self,
        requests: AsyncIterator[bytes],
        context: grpc.aio.ServicerContext,
        caller: Caller,
        session_id: str,
        hello: pb.Hello,
    ) -> AsyncIterator[bytes]:
        """A robot that may."""
        worker, stream = await self._pool.open(session_id, hello.SerializeToString())
        tasks = [
            asyncio.create_task(self._read(requests, worker, stream)),
            asyncio.create_task(self._reassure(worker, stream)),
            asyncio.create_task(self._watch(caller, stream)),
        ]
        try:
            while not isinstance(item := await stream.outbox.get(), End):
                self._metrics.sent_bytes.inc(by=len(item))
                yield item
        finally:
            status = _how(stream.ending)
            for task in tasks:
                task.cancel()
            stream.end()
            await self._pool.close(worker, stream)
            self._metrics.stream_ends.inc(status)
            _log.info("stream ended", extra=fields(session_id=session_id, status=status))
        if item.status is not None:  # when nobody reads from it any more
            await context.abort(item.status, item.detail)

    def _count_open(self, change: int) -> None:
        self._open += change
        self._metrics.streams.set(self._open)

    async def _hello(self, requests: AsyncIterator[bytes]) -> pb.Hello:
        try:
            body = await asyncio.wait_for(anext(requests), self._config.limits.hello_s)
            first = pb.StreamRequest.FromString(body)
        except (TimeoutError, StopAsyncIteration, WireError):
            first = pb.StreamRequest()
        if first.WhichOneof("message") != "hello":
            raise RefusedError(pb.REFUSED_REASON_BAD_HELLO, "expected Hello as the first message of a stream")
        return first.hello

    def _admit(self, session_id: str) -> None:
        """By number and by what is measured; a session that is in memory here is always welcome."""
        limit_s, delay_s = self._config.limits.max_delay_s, self._pool.delay_s
        if self._pool.holds(session_id):
            return
        if self._open >= self._config.session_limit:
            detail = f"{self._open} robots are served, the limit is {self._config.session_limit}"
        elif delay_s > limit_s:
            detail = f"a frame has waited for {delay_s:.1f} s, the limit is {limit_s:g} s"
        else:
            return
        raise RefusedError(pb.REFUSED_REASON_OVERLOADED, detail, OVERLOADED_RETRY_MS)

    def _refused(self, refusal: RefusedError | DeniedError, session_id: str) -> pb.Refused:
        """Counted, logged, and as the robot is told. session_id: "" for a robot that has not come to say it."""
        if isinstance(refusal, RefusedError):
            refused, denied = refusal.message, ""
        else:
            denied = refusal.reason
            self._metrics.denied.inc(denied)
            refused = _as_told(refusal)
        reason = refusal_word(refused)
        self._metrics.refused.inc(reason)
        who = {"session_id": session_id} if session_id else {}
        _log.warning("refused", extra=fields(**who, reason=denied or reason, detail=refused.detail))
        return refused

    async def _reassure(self, worker: WorkerProcess, stream: RobotStream) -> None:
        """Signs of life before Welcome: a long session takes a while to be built again, a robot leaves after 0.5 s."""
        while not stream.opened and worker.lively:
            stream.credit(0)
            await asyncio.sleep(_REASSURE_S)

    async def _watch(self, caller: Caller, stream: RobotStream) -> None:
        """Ends the stream of a certificate that is revoked meanwhile."""
        while caller.fingerprint:
            await asyncio.sleep(_REVOKED_S)
            try:
                self._callers.check_revoked(caller)
            except DeniedError as refusal:
                stream.put(pb.StreamResponse(refused=self._refused(refusal, stream.session_id)).SerializeToString())
                stream.end()
                return

    async def _read(self, requests: AsyncIterator[bytes], worker: WorkerProcess, stream: RobotStream) -> None:
        """Robot to worker, no faster than frames are answered. A robot that has said all it will stays connected."""
        turns = self._clients.messages()
        try:
            async for body in requests:
                await self._pace(turns)
                self._metrics.received_bytes.inc(by=len(body))
                if stream.leaving:  # the next replica gets it
                    return
                if pb.StreamRequest.FromString(body).HasField("frame"):
                    await stream.admit()
                await self._pool.request(worker, stream, body)
        except WireError:
            stream.end(grpc.StatusCode.INVALID_ARGUMENT, "not a StreamRequest")
        except Exception:
            _log.exception("stream failed", extra=fields(session_id=stream.session_id))
            stream.end(grpc.StatusCode.INTERNAL, "the stream failed: see the service's log")

    async def _pace(self, turns: Bucket) -> None:
        if await wait_turn(turns):
            self._metrics.throttled.inc()

    def drain(self, peers: Peers) -> None:
        """No new streams, no more frames; robots will hear where to go once their sessions are handed over."""
        self._draining = True
        self._metrics.draining.set(1)
        streams = self._pool.streams
        for stream, address in zip_longest(streams, peers.rooms(len(streams)), fillvalue=""):
            assert isinstance(stream, RobotStream)
            stream.leave(pb.Drain(reason=pb.DRAIN_REASON_SHUTDOWN, replica=as_hint(str(address))))
            self._metrics.drained.inc("shutdown")


def _how(ending: End | None) -> str:
    """As a word; None: the robot, the link or the proxy went before it was ended from this side."""
    if ending is None:
        return "cancelled"
    return "ok" if ending.status is None else ending.status.name.lower()


def _as_told(denied: DeniedError) -> pb.Refused:
    """One too many may come again; who is not whom it says need not."""
    if denied.reason in ("streams", "opens"):
        return pb.Refused(reason=pb.REFUSED_REASON_OVERLOADED, detail=denied.detail, retry_after_ms=_TOO_MANY_RETRY_MS)
    return pb.Refused(reason=pb.REFUSED_REASON_UNAUTHENTICATED, detail=denied.detail)
