"""What is done to the system. Each fault takes the field, does its harm, mends it, and returns."""

from __future__ import annotations

import os
import random
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

from splitslam.chaos.link import Quality
from splitslam.stack import Replica
from tests.chaos.field import Field
from tests.chaos.invariants import family


@dataclass(frozen=True, slots=True)
class Fault:
    """One kind of harm. gap_s: the longest silence that it may cost a robot; None: as long as it lasts."""

    name: str
    do: Callable[[Field], None]
    gap_s: float | None = None


def replica_killed(field: Field) -> None:
    """kill -9 of the front; its workers go with it. The supervisor starts it again."""
    replica = _busiest(field)
    replica.kill()
    field.later(replica.start)


def worker_killed(field: Field) -> None:
    """kill -9 of one worker process: its replica starts another."""
    os.kill(_busiest(field).workers()[-1], signal.SIGKILL)


def replica_drained(field: Field) -> None:
    """SIGTERM, then started again: a restart as operators do it."""
    replica = _busiest(field)
    field.expect(replica.drain() == 0, f"{replica.name} drained with exit code {replica.exit_code}")
    field.later(replica.start)


def replica_frozen(field: Field, seconds: float = 6.0) -> None:
    """SIGSTOP to all of its processes, then SIGCONT: what wakes up believes that it still owns its sessions."""
    replica = _busiest(field)
    members = family(replica.pid)
    for pid in members:
        os.kill(pid, signal.SIGSTOP)
    time.sleep(seconds)
    for pid in members:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGCONT)


def store_killed(field: Field, seconds: float = 3.0) -> None:
    """kill -9 of PostgreSQL and all its backends; started again after `seconds`."""
    assert field.stack.postgres is not None
    field.stack.postgres.kill()
    time.sleep(seconds)
    field.stack.postgres.start()


def proxy_killed(field: Field) -> None:
    """kill -9 of Envoy; started again at once."""
    field.stack.envoy.kill()
    field.stack.envoy.start()


def scaled_up_and_down(field: Field) -> None:
    """One replica less (drained), one more, which takes its share, and that one goes again."""
    added = field.stack.add_replica()
    time.sleep(1.0)
    exit_code = field.stack.remove_replica(added)
    field.expect(exit_code == 0, f"{added.name} was removed with exit code {exit_code}")


def robots_cut_off(field: Field, seconds: float = 5.0) -> None:
    """Silence between every robot and the rack."""
    for link in field.links:
        link.partition()
    time.sleep(seconds)
    for link in field.links:
        link.heal()


def connections_reset(field: Field) -> None:
    """RST on every connection of every robot."""
    for link in field.links:
        link.cut()


def links_slow(field: Field, kbps: float, seconds: float = 8.0) -> None:
    """So many kbit/s for each robot, 40 ms of delay, one packet in a hundred lost."""
    for link in field.links:
        link.quality = Quality(kbps=kbps, delay_s=0.04, loss=0.01)
    time.sleep(seconds)
    for link in field.links:
        link.quality = Quality()


def agent_killed(field: Field) -> None:
    """kill -9 of a real edge agent; its supervisor starts it again."""
    if living := [agent for agent in field.agents if not agent.done]:
        living[0].process.kill()


def _busiest(field: Field) -> Replica:
    """The replica that has most of the sessions now."""
    streams = {replica: _streams(replica) for replica in field.stack.replicas if replica.alive}
    most = max(streams.values())
    return random.Random(field.seed).choice([replica for replica, count in streams.items() if count == most])


def _streams(replica: Replica) -> float:
    try:
        return replica.metrics()["splitslam_map_streams"]
    except OSError:
        return -1.0
