"""Where a chaos run takes place: one stack, light robots that check every answer, real agents, and what went wrong."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

from splitslam.chaos.agent import Agent, Drive
from splitslam.chaos.link import Link
from splitslam.stack import Replica, Stack, StackError
from splitslam.stack.process import wait_until
from tests.chaos.audit import Audit, one_owner
from tests.chaos.clock import WallClock, wall_clock
from tests.chaos.disk import SmallDisk, small_disk
from tests.chaos.fleet import Fleet
from tests.chaos.invariants import Undisturbed, agent_kept, family, nobody_left

RESTART_S, _TRIES = 1.0, 20
_STAGGER_S = 0.5
AGENT_START_S = 10.0  # interpreter, kernels, the first Welcome; the drive begins after it


@dataclass(slots=True)
class Field:
    """agents: real ones, each behind one of `agent_links`. seed: of what is chosen at random. The disks are None where
    none could be mounted. previous: git ref of the version to upgrade from; None: this one under another number.
    """

    folder: Path
    stack: Stack
    fleet: Fleet
    undisturbed: Undisturbed
    agents: list[Agent]
    agent_links: list[Link]
    clock: WallClock
    agent_disk: SmallDisk | None = None
    store_disk: SmallDisk | None = None
    seed: int = 1
    previous: str | None = None
    wrong: list[str] = field(default_factory=list)
    skipped: list[str] = field(default_factory=list)
    upgraded: list[tuple[Replica, tuple[str, ...]]] = field(default_factory=list)
    _restarts: ThreadPoolExecutor = field(default_factory=lambda: ThreadPoolExecutor(1, "supervisor"))
    _pending: list[Future[None]] = field(default_factory=list)

    @property
    def links(self) -> list[Link]:
        return [*(place.link for place in self.fleet.places), *self.agent_links]

    def expect(self, true: bool, text: str) -> None:
        if not true:
            self.wrong.append(text)

    def skip(self, why: str) -> None:
        """Something cannot be done here."""
        self.skipped.append(why)

    def later(self, start: Callable[[], None]) -> None:
        """What a supervisor does: start it again, after a moment."""

        def restart() -> None:
            for _ in range(_TRIES):  # a replica does not start while its store is away
                time.sleep(RESTART_S)
                with suppress(StackError):
                    start()
                    return

        self._pending.append(self._restarts.submit(restart))

    def processes(self) -> list[int]:
        """Every process that runs for the stack and the agents now."""
        parts = [*self.stack.replicas, self.stack.envoy, self.stack.postgres, *(agent.process for agent in self.agents)]
        return [pid for part in parts if part is not None and part.alive for pid in family(part.pid)]

    def all_up(self) -> None:
        """Waits until what was to be started again is there and known to the proxy."""
        for pending in self._pending:
            pending.result()
        self._pending.clear()
        self.stack.wait_healthy(20.0)
        wait_until(lambda: all(map(_has_worker, self.stack.replicas)), 20.0, "a worker in every replica")


def _has_worker(replica: Replica) -> bool:
    try:
        return replica.metrics().get("splitslam_map_workers_ready", 1.0) >= 1.0  # releases before do not say
    except OSError:
        return False


@dataclass(frozen=True, slots=True)
class Material:
    """What is driven: the made drive and what both pipelines make of it undisturbed."""

    drive: Drive
    undisturbed: Undisturbed


@dataclass(frozen=True, slots=True)
class Size:
    """How much there is of everything. frames: of a light robot's session; None: the whole drive. small_disks: store
    and first agent on disks that can be filled.
    """

    light: int
    real: int
    replicas: int = 3
    frames: int | None = None
    small_disks: bool = False


@contextmanager
def open_field(folder: Path, material: Callable[[], Material], size: Size) -> Iterator[Field]:
    """The stack, started while the drive is made; then the robots. At the end every session is finished and judged.

    material: called once, in a thread of its own. What was wrong is in `field.wrong` when the block is left.
    """
    with ExitStack() as cleanup:
        making = cleanup.enter_context(ThreadPoolExecutor(1)).submit(material)
        clock = cleanup.enter_context(wall_clock(folder / "clock"))
        agent_disk = store_disk = None
        if size.small_disks:
            agent_disk = cleanup.enter_context(small_disk(folder / "robot-1" / "state", 8))
            store_disk = cleanup.enter_context(small_disk(folder / "stack" / "postgres", 512))
        stack = cleanup.enter_context(Stack(folder / "stack", size.replicas))
        audit = Audit(stack.store_url)
        made = making.result()
        fleet = Fleet(size.light, stack.address, made.undisturbed, frames=size.frames, stagger_s=_STAGGER_S)
        links = [cleanup.enter_context(Link(stack.address, seed=k)) for k in range(size.real)]
        agents = [
            Agent(f"robot-{k}", made.drive, link.address, folder / f"robot-{k}") for k, link in enumerate(links, 1)
        ]
        field = Field(folder, stack, fleet, made.undisturbed, agents, links, clock, agent_disk, store_disk)
        fleet.start()
        for agent in agents:
            agent.began_s = time.monotonic() + AGENT_START_S
            agent.start()
            cleanup.callback(agent.stop)
        yield field
        field.all_up()
        fleet.finish()
        for agent in agents:
            field.expect(agent.wait(made.undisturbed.duration_s + 60.0), f"{agent.name} did not come to its end")
            field.wrong += agent_kept(agent, stack.address, made.undisturbed)
        field.wrong += fleet.wrong + one_owner(audit.notes())
        processes = field.processes()
    field.wrong += nobody_left(processes)
