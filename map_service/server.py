"""The life of the service: startup -> serve -> drain."""

from __future__ import annotations

import asyncio
import json
import logging
import signal
from pathlib import Path
from typing import Any

import grpc
from grpc_health.v1 import health, health_pb2, health_pb2_grpc
from grpc_reflection.v1alpha import reflection

from map_service.config import ServiceConfig
from map_service.dense_service import SERVICE as DENSE_SERVICE
from map_service.dense_service import DenseFront
from map_service.door import Door
from map_service.edge_service import EdgeFront
from map_service.engine import DEFAULT_ENGINE
from map_service.housekeeping import Housekeeper
from map_service.live_answers import LiveAnswers
from map_service.membership import Membership, own_address
from map_service.metrics import ServiceMetrics
from map_service.pose_service import PoseFront
from map_service.processes import leave_out_of_collections
from map_service.rebalance import Rebalancer
from map_service.session_service import SessionFront
from map_service.store import Store
from map_service.view_service import SERVICE as VIEW_SERVICE
from map_service.view_service import ViewFront
from map_service.watches import Watches
from map_service.workers import WorkerPool
from splitslam.errors import InputError
from splitslam.logs import configure_logs
from splitslam.notify import Notifier
from splitslam.wire import dense_pb2_grpc, pose_pb2_grpc, session_pb2_grpc

SERVICES = (
    "splitslam.v1.EdgeService",
    "splitslam.v1.SessionService",
    "splitslam.v1.PoseService",
    VIEW_SERVICE,
    DENSE_SERVICE,
)
_STREAM_GRACE_S = 0.5
_LEAVE_S = 1.0

HealthServicer = health.aio.HealthServicer  # pyright: ignore[reportAttributeAccessIssue] (its stubs lack it)

_log = logging.getLogger(__name__)


def serve(config: ServiceConfig, engine: str = DEFAULT_ENGINE) -> None:
    """Run until SIGTERM or SIGINT, then drain. engine: dotted path of what the workers compute with.

    Prints one JSON line on stdout when robots can connect. Raises InputError for a configuration that cannot work.
    """
    configure_logs(config.log.format, config.log.level, replica=config.name)
    asyncio.run(_serve(config, engine))


async def _serve(config: ServiceConfig, engine: str) -> None:
    stop = asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        asyncio.get_running_loop().add_signal_handler(number, stop.set)
    store = Store(config.store, config.store_wait_s)
    metrics = ServiceMetrics(config)
    live = LiveAnswers()
    pool = WorkerPool(config, engine, metrics, live)
    door = Door(config.tls, metrics)
    front = EdgeFront(config, pool, metrics, door.callers)
    sessions = SessionFront(store, pool, door.callers, metrics)
    watches = Watches(config.watch, door.callers, metrics)
    poses = PoseFront(store, watches, live)
    views = ViewFront(pool.watchers, door.callers, metrics)
    dense = DenseFront(config, store, door.callers, metrics)
    server, checks, address = _build(config, front, sessions, poses, views, dense, door)
    page = metrics.serve(config.metrics.host, config.metrics.port)
    local = _health_only(config.health_socket, checks)
    try:
        starting = asyncio.create_task(pool.start())
        stopping = asyncio.create_task(stop.wait())
        await asyncio.wait((starting, stopping), return_when=asyncio.FIRST_COMPLETED)
        if stop.is_set():
            starting.cancel()
            return
        starting.result()
        await server.start()
        if local is not None:
            await local.start()
        await _set_health(checks, health_pb2.HealthCheckResponse.SERVING)
        leave_out_of_collections()
        scraped = f"{page.host}:{page.port}" if page else None
        keeping = asyncio.create_task(Housekeeper(store, config, metrics).run())
        print(json.dumps({"event": "listening", "grpc": address, "metrics": scraped}), flush=True)
        notifier = Notifier()
        notifier.ready(f"listening on {address}")
        living = asyncio.create_task(_give_signs_of_life(notifier))
        own = own_address(config.replica, address)
        membership = Membership(store, config.replica, own, lambda: front.open, lambda: pool.ready)
        rebalancing = asyncio.create_task(Rebalancer(config.replica, membership, pool, metrics).run())
        views.peers = lambda: membership.peers
        if _shared(config, store):
            membership.start()
        await stopping
        notifier.stopping("handing sessions over")
        keeping.cancel()
        _log.info("draining")
        await _set_health(checks, health_pb2.HealthCheckResponse.NOT_SERVING)
        rebalancing.cancel()
        front.drain(membership.peers)
        watches.drain()
        await asyncio.gather(pool.drain(), asyncio.to_thread(membership.leave, _LEAVE_S))
        await server.stop(_STREAM_GRACE_S)
        living.cancel()
        if local is not None:
            await local.stop(None)
    finally:
        pool.kill()
        watches.close()
        store.close()
        if page:
            page.close()


async def _give_signs_of_life(notifier: Notifier) -> None:
    """As long as this event loop turns, which is what robots talk to; it watches the workers itself."""
    while notifier.watchdog_s is not None:
        notifier.alive()
        await asyncio.sleep(notifier.watchdog_s / 4)


def _shared(config: ServiceConfig, store: Store) -> bool:
    """Whether other replicas may use the store."""
    shared = config.replica.shared
    return store.engine.dialect.name != "sqlite" if shared is None else shared


def _build(
    config: ServiceConfig,
    front: EdgeFront,
    sessions: SessionFront,
    poses: PoseFront,
    views: ViewFront,
    dense: DenseFront,
    door: Door,
) -> tuple[grpc.aio.Server, Any, str]:
    server = grpc.aio.server(
        options=[
            ("grpc.so_reuseport", 0),  # two services on one port would share the robots at random
            ("grpc.max_receive_message_length", config.limits.max_message_bytes),
            ("grpc.keepalive_time_ms", 10_000),
            ("grpc.keepalive_timeout_ms", 5_000),
            ("grpc.http2.min_ping_interval_without_data_ms", 5_000),
        ]
    )
    server.add_generic_rpc_handlers((front.handler(), views.handler()))
    session_pb2_grpc.add_SessionServiceServicer_to_server(sessions, server)
    pose_pb2_grpc.add_PoseServiceServicer_to_server(poses, server)
    dense_pb2_grpc.add_DenseServiceServicer_to_server(dense, server)
    checks = HealthServicer()
    health_pb2_grpc.add_HealthServicer_to_server(checks, server)
    if not config.tls.on:  # whoever needs the contract behind a door has it from proto/
        reflection.enable_server_reflection((*SERVICES, "grpc.health.v1.Health", reflection.SERVICE_NAME), server)
    host, _, _ = config.listen.rpartition(":")
    try:
        bound = door.open(server, config.listen)
    except RuntimeError as error:
        raise InputError(f"listen {config.listen}: cannot be bound (is the port in use?)") from error
    return server, checks, f"{host}:{bound}"


def _health_only(socket: Path | None, checks: Any) -> grpc.aio.Server | None:
    """A second server for whoever is in the same container: it tells health and nothing else."""
    if socket is None:
        return None
    server = grpc.aio.server()
    health_pb2_grpc.add_HealthServicer_to_server(checks, server)
    try:
        server.add_insecure_port(f"unix:{socket.absolute()}")
    except RuntimeError as error:
        raise InputError(f"health_socket {socket}: cannot be made (does its folder exist?)") from error
    return server


async def _set_health(checks: Any, status: health_pb2.HealthCheckResponse.ServingStatus) -> None:
    for service in ("", *SERVICES):
        await checks.set(service, status)
