"""A new replica takes its share of running sessions: the fullest one gives one at a time to the emptiest."""

from __future__ import annotations

import asyncio
import logging
import time

from map_service.config import ReplicaConfig
from map_service.membership import Membership, Peers, as_hint
from map_service.metrics import ServiceMetrics
from map_service.streams import RobotStream
from map_service.workers import WorkerPool
from splitslam.logs import fields
from splitslam.wire import session_pb2 as pb

_log = logging.getLogger(__name__)


class Balance:
    """When to give a session away, from what each look at the store shows.

    Loads that differ by one stay: a move could only turn them round. A larger difference must last longer than a dead
    replica stays in the table, and between two moves the first must have become visible.
    """

    def __init__(self, config: ReplicaConfig) -> None:
        self._config = config
        self._uneven = 0  # looks in a row
        self._moved_s = float("-inf")

    def look(self, peers: Peers, now_s: float) -> bool:
        """Whether this replica gives one away now."""
        self._uneven = self._uneven + 1 if peers.spread >= 2 else 0
        if self._uneven <= self._config.lost_beats or now_s - self._moved_s < self._config.rest_s:
            return False
        if not peers.is_fullest:
            return False
        self._moved_s = now_s
        return True


class Rebalancer:
    """Looks whenever the membership has been read again."""

    def __init__(
        self, config: ReplicaConfig, membership: Membership, pool: WorkerPool, metrics: ServiceMetrics
    ) -> None:
        self._balance, self._period_s = Balance(config), config.beat_s / 4
        self._membership, self._pool, self._metrics = membership, pool, metrics

    async def run(self) -> None:
        looks = 0
        while True:
            await asyncio.sleep(self._period_s)
            if self._membership.looks == looks:
                continue
            looks, peers = self._membership.looks, self._membership.peers
            self._metrics.replicas.set(len(peers.alive))
            if self._balance.look(peers, time.monotonic()) and (stream := self._cheapest()) is not None:
                await self._give(stream, peers)

    def _cheapest(self) -> RobotStream | None:
        """The shortest session that runs: it is built again soonest."""
        running = [stream for stream in self._pool.streams if stream.answered and not stream.leaving]
        return min(running, key=lambda stream: stream.durable_seq, default=None)

    async def _give(self, stream: RobotStream, peers: Peers) -> None:
        (address,) = peers.rooms(1)
        _log.info("rebalance", extra=fields(session_id=stream.session_id, to=address))
        self._metrics.drained.inc("rebalance")
        await self._pool.hand_over(stream, pb.Drain(reason=pb.DRAIN_REASON_REBALANCE, replica=as_hint(address)))
