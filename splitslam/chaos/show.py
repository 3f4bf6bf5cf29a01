"""The stack and the robots of the chaos demo while they run: what is done to them, and how they look now."""

from __future__ import annotations

import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitslam.chaos.agent import Agent
from splitslam.chaos.link import Link
from splitslam.chaos.script import Harm
from splitslam.chaos.view import PartRow, Point, RobotRow, Snapshot
from splitslam.chaos.watch import AgentWatch, ReplicaWatch
from splitslam.stack import Stack, StackError

_RESTART_S, _TRIES = 1.0, 20
_TRAIL = 60
_TRAIL_M = 0.15


@dataclass(frozen=True, slots=True)
class Inflicted:
    """A harm that was done: to whom, and from when to when, s after the drive's begin."""

    what: str
    from_s: float
    to_s: float


class Show:
    """began_s: the drive's begin, monotonic clock. T_yard_map: of each robot, (4, 4). way_m: the lap."""

    def __init__(
        self,
        stack: Stack,
        agents: list[Agent],
        links: list[Link],
        began_s: float,
        duration_s: float,
        T_yard_map: list[NDArray[np.float64]],
        way_m: tuple[Point, ...],
        keys: bool,
    ) -> None:
        self.stack, self.agents, self.links, self.began_s = stack, agents, links, began_s
        self.done: list[Inflicted] = []
        self._duration_s, self._T_yard_map, self._way_m, self._keys = duration_s, T_yard_map, way_m, keys
        self._robots = [AgentWatch(agent) for agent in agents]
        self._replicas = [ReplicaWatch(replica) for replica in stack.replicas]
        self._trails: list[deque[Point]] = [deque(maxlen=_TRAIL) for _ in agents]
        self._events: deque[tuple[float, str]] = deque(maxlen=100)
        self._store_word = self._proxy_word = "up"
        self._rack = threading.Lock()  # keys may ask for a second harm before the first is mended
        self._work = ThreadPoolExecutor(8, "harm")
        self._supervisors = ThreadPoolExecutor(len(stack.replicas), "supervisor")
        self._harms: dict[str, Callable[[float], str]] = {
            "kill replica": self._kill_replica,
            "freeze replica": self._freeze_replica,
            "drain replica": self._drain_replica,
            "kill store": self._kill_store,
            "kill proxy": self._kill_proxy,
            "kill agent": self._kill_agent,
            "cut network": self._cut_network,
        }

    def start(self) -> None:
        for watch in (*self._robots, *self._replicas):
            watch.start()

    def stop(self) -> None:
        """Waits for what is being mended."""
        self._work.shutdown()
        self._supervisors.shutdown()  # last: a harm that was still being done has let one of them begin
        for watch in (*self._robots, *self._replicas):
            watch.stop()

    @property
    def now_s(self) -> float:
        """Since the drive's begin; negative before."""
        return time.monotonic() - self.began_s

    @property
    def over(self) -> bool:
        return all(agent.done for agent in self.agents)

    def do(self, harm: Harm) -> None:
        """Begins the harm; returns at once."""
        self._work.submit(self._do, harm)

    def _do(self, harm: Harm) -> None:
        from_s = self.now_s
        try:
            what = self._harms[harm.what](harm.for_s)
        except Exception as error:  # nobody waits for this thread: what went wrong is shown
            self._note(f"{harm.what}: {error}")
            return
        if what:
            self.done.append(Inflicted(what, from_s, self.now_s))

    def _note(self, text: str) -> None:
        self._events.append((self.now_s, text))

    # --- the harms; each returns what it did, "" for nothing ---------------------------------------------------

    def _busiest(self) -> ReplicaWatch | None:
        up = [watch for watch in self._replicas if watch.status.word == "up" and watch.replica.alive]
        return max(up, key=lambda watch: watch.status.streams, default=None)

    def _kill_replica(self, _for_s: float) -> str:
        if (watch := self._busiest()) is None:
            return ""
        name, robots = watch.replica.name, watch.status.streams
        watch.replica.kill()
        self._note(f"{name} killed (SIGKILL) with {robots} robots")
        self._supervisors.submit(self._again, watch)
        return f"{name} killed"

    def _again(self, watch: ReplicaWatch) -> None:
        """A supervisor's work: a replica does not start while its store is away, so it is tried until it does."""
        watch.draining = False
        for _ in range(_TRIES):
            time.sleep(_RESTART_S)
            if watch.replica.alive:  # it was killed twice, and another of us was first
                return
            with contextlib.suppress(StackError):
                watch.replica.start()
                self._note(f"{watch.replica.name} started again")
                return
        self._note(f"{watch.replica.name} does not start: {watch.replica.last_line()}")

    def _freeze_replica(self, for_s: float) -> str:
        if (watch := self._busiest()) is None:
            return ""
        watch.replica.freeze()
        watch.frozen = True
        self._note(f"{watch.replica.name} frozen (SIGSTOP) with {watch.status.streams} robots")
        time.sleep(for_s)
        watch.replica.thaw()
        watch.frozen = False
        self._note(f"{watch.replica.name} goes on (SIGCONT)")
        return f"{watch.replica.name} frozen"

    def _drain_replica(self, _for_s: float) -> str:
        if (watch := self._busiest()) is None:
            return ""
        watch.draining = True
        self._note(f"{watch.replica.name} drains (SIGTERM), {watch.status.streams} robots move")
        watch.replica.drain()
        self._supervisors.submit(self._again, watch)
        return f"{watch.replica.name} drained"

    def _kill_store(self, for_s: float) -> str:
        postgres = self.stack.postgres
        assert postgres is not None
        with self._rack:
            postgres.kill()
            self._store_word = "dead"
            self._note("PostgreSQL killed (SIGKILL)")
            time.sleep(for_s)
            postgres.start()
            self._store_word = "up"
            self._note("PostgreSQL started again")
        return "store killed"

    def _kill_proxy(self, _for_s: float) -> str:
        with self._rack:
            self.stack.envoy.kill()
            self._proxy_word = "dead"
            self._note("Envoy killed (SIGKILL)")
            self.stack.envoy.start()
            self._proxy_word = "up"
            self._note("Envoy started again")
        return "proxy killed"

    def _kill_agent(self, _for_s: float) -> str:
        alive = [agent for agent in self.agents if not agent.done and agent.process.alive]
        if not alive:
            return ""
        alive[-1].process.kill()
        self._note(f"the agent of {alive[-1].name} killed (SIGKILL)")
        return f"agent of {alive[-1].name} killed"

    def _cut_network(self, for_s: float) -> str:
        if not all(link.up for link in self.links):
            return ""
        for link in self.links:
            link.partition()
        self._note("the network between robots and rack is gone")
        time.sleep(for_s)
        for link in self.links:
            link.heal()
        self._note("the network is back")
        return "network cut"

    # --- how it looks now --------------------------------------------------------------------------------------

    def snapshot(self) -> Snapshot:
        """To be called by one thread."""
        return Snapshot(
            now_s=self.now_s,
            duration_s=self._duration_s,
            robots=tuple(self._robot(k) for k in range(len(self.agents))),
            parts=tuple(self._parts()),
            way_m=self._way_m,
            events=tuple(self._events),
            keys=self._keys,
        )

    def _robot(self, k: int) -> RobotRow:
        status, link = self._robots[k].status, self.links[k]
        place_m = None
        if status.T_map_body is not None and self.now_s > 0:
            x_m, y_m = (self._T_yard_map[k] @ status.T_map_body)[:2, 3].tolist()
            place_m, trail = (x_m, y_m), self._trails[k]
            if not trail or np.hypot(x_m - trail[-1][0], y_m - trail[-1][1]) > _TRAIL_M:
                trail.append(place_m)
        return RobotRow(
            name=self.agents[k].name,
            up=status.up or self.agents[k].done,
            state=status.state,
            place_m=place_m,
            trail_m=tuple(self._trails[k]),
            gap_s=status.gap_s,
            longest_gap_s=status.longest_gap_s,
            spool=status.spool,
            answered=status.answered,
            cut=not link.up,
        )

    def _parts(self) -> list[PartRow]:
        rows = []
        for watch in self._replicas:
            status = watch.status
            robots = f"{status.streams} robot{'' if status.streams == 1 else 's'}, {status.frames} scans mapped"
            fenced = f", fenced {status.fenced}" if status.fenced else ""
            rows.append(PartRow(watch.replica.name, status.word, robots + fenced if status.word == "up" else ""))
        rows.append(PartRow("Envoy", self._proxy_word, "robots to replicas"))
        rows.append(PartRow("PostgreSQL", self._store_word, "every map, every epoch"))
        return rows
