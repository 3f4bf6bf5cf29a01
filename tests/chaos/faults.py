"""What is done to the system. Each fault takes the field, does its harm, mends it, and returns."""

from __future__ import annotations

import os
import random
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial

from splitslam.chaos.link import Quality
from splitslam.stack import Replica
from tests import tolerances as bars
from tests.chaos.field import Field
from tests.chaos.invariants import family
from tests.chaos.rude_robot import be_rude
from tests.chaos.version import other_version


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
    """Down to two replicas, up to three, down to two, and up again for what follows."""
    for _ in range(2):
        going = _busiest(field)
        exit_code = field.stack.remove_replica(going)
        field.expect(exit_code == 0, f"{going.name} was removed with exit code {exit_code}")
        time.sleep(1.0)
        field.stack.add_replica()
        time.sleep(2.0)


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


def frames_twice_early_and_flipped(field: Field) -> None:
    """A robot that misbehaves has its own session and harms no other."""
    be_rude(field.stack.address, field.undisturbed, field.expect)


def clocks_jump(field: Field, seconds: float = 3600.0) -> None:
    """The wall clock of every replica and agent goes an hour ahead, then an hour back."""
    for shift_s in (seconds, -seconds, 0.0):
        field.clock.shift(shift_s)
        time.sleep(2.0)


def agents_disk_full(field: Field, seconds: float = 6.0) -> None:
    """Not a byte left where an agent keeps its spool, while the network is away too."""
    if (disk := field.agent_disk) is None:
        field.skip("an agent's disk full: needs the right to mount")
        return
    disk.fill()
    robots_cut_off(field, seconds)
    time.sleep(1.0)
    disk.free()


def stores_disk_full(field: Field, seconds: float = 6.0) -> None:
    """Not a byte left where PostgreSQL keeps its data. It may stop; its supervisor starts it when there is room."""
    if (disk := field.store_disk) is None:
        field.skip("the store's disk full: needs the right to mount")
        return
    disk.fill()
    time.sleep(seconds)
    disk.free()
    assert field.stack.postgres is not None
    if not field.stack.postgres.ready:
        field.stack.postgres.kill()
        field.stack.postgres.start()


def upgraded_in_a_row(field: Field) -> None:
    """Each replica is drained and comes back with another version of the program; both serve side by side meanwhile."""
    program = other_version(field.folder / "other", field.previous)
    for replica in list(field.stack.replicas):
        before, replica.program = replica.program, program
        _restart_drained(field, replica)
        field.upgraded.append((replica, before))


def downgraded_in_a_row(field: Field) -> None:
    """And back."""
    for replica, before in field.upgraded:
        replica.program = before
        _restart_drained(field, replica)
    field.upgraded.clear()


def _restart_drained(field: Field, replica: Replica) -> None:
    field.expect(replica.drain() == 0, f"{replica.name} drained with exit code {replica.exit_code}")
    replica.start()
    field.stack.wait_healthy(20.0)


REPLICA_KILLED = Fault("replica killed", replica_killed, bars.KILLED_REPLICA_GAP_S)
REPLICA_DRAINED = Fault("replica drained", replica_drained, bars.DRAINED_REPLICA_GAP_S)
REPLICA_FROZEN = Fault("replica frozen 6 s", replica_frozen, bars.FROZEN_REPLICA_GAP_S)
STORE_KILLED = Fault("store killed 3 s", store_killed, bars.KILLED_STORE_GAP_S)
WORKER_KILLED = Fault("worker killed", worker_killed)
PROXY_KILLED = Fault("proxy killed", proxy_killed)
AGENT_KILLED = Fault("agent killed", agent_killed)
CUT_OFF = Fault("network away 5 s", robots_cut_off)
RESET = Fault("connections reset", connections_reset)
RUDE = Fault("frames twice, early, flipped", frames_twice_early_and_flipped)
SLOW = Fault("links of 500 kbit/s", partial(links_slow, kbps=500.0))

SHORT = (
    *(AGENT_KILLED, REPLICA_KILLED, RESET, REPLICA_FROZEN, STORE_KILLED),
    *(RUDE, CUT_OFF, WORKER_KILLED, REPLICA_DRAINED, PROXY_KILLED),
)
# What concerns real agents comes first, while their drive lasts.
LONG = (
    AGENT_KILLED,
    Fault("agent's disk full", agents_disk_full),
    Fault("network away 60 s", partial(robots_cut_off, seconds=60.0)),
    Fault("clocks jump an hour", clocks_jump),
    SLOW,
    *(fault for fault in SHORT if fault is not AGENT_KILLED),
    Fault("links of 5 Mbit/s", partial(links_slow, kbps=5000.0)),
    Fault("scaled 2 -> 3 -> 2", scaled_up_and_down),
    Fault("store's disk full", stores_disk_full),
    Fault("upgraded in a row", upgraded_in_a_row),
    Fault("and back again", downgraded_in_a_row),
)
# What may come at any time in the soak, one at a time.
RANDOM = (
    *(REPLICA_KILLED, WORKER_KILLED, REPLICA_DRAINED, REPLICA_FROZEN, STORE_KILLED, PROXY_KILLED),
    *(CUT_OFF, RESET, RUDE, SLOW),
)


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
