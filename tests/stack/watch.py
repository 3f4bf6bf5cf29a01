"""What a stack's replicas say about who serves whom."""

from __future__ import annotations

import json
import time

from splitslam.stack import Replica, Stack, StackError
from splitslam.stack.robot import LightRobot

_STILL_S = 1.5  # longer than the balance of replicas takes to act on what it has seen, with this stack's settings


def streams(replica: Replica) -> int:
    return int(replica.metrics()["splitslam_map_streams"]) if replica.alive else 0


def loads(stack: Stack) -> list[int]:
    """Robots of each replica, ascending."""
    return sorted(map(streams, stack.replicas))


def wait_level(stack: Stack, expected: list[int], timeout_s: float = 60.0) -> None:
    """Those loads, and nobody about to be sent elsewhere: replicas decide by what they saw a moment ago."""
    deadline_s = time.monotonic() + timeout_s
    moves, since_s = -1, 0.0
    while loads(stack) != expected or rebalanced(stack) != moves or time.monotonic() - since_s < _STILL_S:
        if time.monotonic() > deadline_s:
            raise StackError(f"robots {expected}, and there to stay: not within {timeout_s:g} s, now {loads(stack)}")
        if loads(stack) != expected or rebalanced(stack) != moves:
            moves, since_s = rebalanced(stack), time.monotonic()
        time.sleep(0.05)


def fullest(stack: Stack) -> Replica:
    return max(stack.replicas, key=streams)


def rebalanced(stack: Stack) -> int:
    """Sessions given away so far."""
    name = 'splitslam_map_drained_total{reason="rebalance"}'
    return int(sum(replica.metrics()[name] for replica in stack.replicas))


def fenced(replica: Replica) -> int:
    return int(replica.metrics()["splitslam_map_fenced_total"])


def owner(stack: Stack, robot: LightRobot) -> str:
    """The replica that opened the session last."""
    opened = {}
    for replica in stack.replicas:
        for line in events(replica, "session open"):
            if line["session_id"] == robot.session_id:
                opened[line["epoch"]] = replica.name
    return opened[max(opened)]


def events(replica: Replica, event: str) -> list[dict]:
    """Its log lines of that name."""
    lines = replica.log.read_text().splitlines()
    return [json.loads(line) for line in lines if f'"event": "{event}"' in line]
