"""ViewService: the sessions of this replica for people who look on. Robots never wait for them."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import AsyncIterator, Callable

import grpc

from map_service.access import check_watcher
from map_service.callers import Caller, Callers, DeniedError
from map_service.membership import Peers, as_hint
from map_service.metrics import ServiceMetrics
from map_service.watchers import Watcher, Watchers
from splitslam.logs import fields
from splitslam.wire import view_pb2

SERVICE = "splitslam.v1.ViewService"
MOST_WATCHERS = 16
_SIGN_OF_LIFE_S = 1.0
_REVOKED_S = 5.0

_log = logging.getLogger(__name__)


class ViewFront:
    """Handles `ViewService.WatchScans`; views go out as the workers have serialised them."""

    def __init__(self, watchers: Watchers, callers: Callers, metrics: ServiceMetrics) -> None:
        self._watchers, self._callers, self._metrics = watchers, callers, metrics
        self.peers: Callable[[], Peers] = lambda: Peers("")  # as soon as there is a membership

    def handler(self) -> grpc.GenericRpcHandler:
        watch = grpc.unary_stream_rpc_method_handler(
            self.watch, request_deserializer=view_pb2.WatchScansRequest.FromString
        )
        return grpc.method_handlers_generic_handler(SERVICE, {"WatchScans": watch})

    async def watch(
        self, request: view_pb2.WatchScansRequest, context: grpc.aio.ServicerContext
    ) -> AsyncIterator[bytes]:
        try:
            caller = self._callers.identify(context)
            robot_id, site_id = check_watcher(caller, request.robot_id, request.site_id)
            if self._watchers.count >= MOST_WATCHERS:
                await context.abort(grpc.StatusCode.RESOURCE_EXHAUSTED, f"{MOST_WATCHERS} watch this replica already")
            watcher = Watcher(robot_id, site_id)
            with self._watchers.watching(watcher):
                async for body in self._views(watcher, caller):
                    yield body
        except DeniedError as denied:
            self._metrics.denied.inc(denied.reason)
            _log.warning("refused", extra=fields(reason=denied.reason, detail=denied.detail))
            await context.abort(grpc.StatusCode.PERMISSION_DENIED, f"{denied.reason}: {denied.detail}")

    async def _views(self, watcher: Watcher, caller: Caller) -> AsyncIterator[bytes]:
        """Until the call ends. Raises DeniedError when the caller's certificate is revoked."""
        told_s = looked_s = -math.inf
        while True:
            now_s = time.monotonic()
            if now_s - looked_s > _REVOKED_S:
                self._callers.check_revoked(caller)
                looked_s = now_s
            if now_s - told_s > _SIGN_OF_LIFE_S:
                told_s = now_s
                yield self._sign_of_life()
            if (body := await watcher.next(_SIGN_OF_LIFE_S)) is not None:
                yield body
            if watcher.caught_up():
                self._watchers.all_anew()

    def _sign_of_life(self) -> bytes:
        peers = self.peers()
        hints = {peer.id: as_hint(peer.address) for peer in peers.alive}
        own = hints.pop(peers.own_id, "")
        return view_pb2.WatchScansResponse(replica=own, replicas=sorted(hints.values())).SerializeToString()
