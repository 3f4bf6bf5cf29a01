"""What a stack's replicas say about who serves whom."""

from __future__ import annotations

import json

from splitslam.stack import Replica, Stack
from splitslam.stack.robot import LightRobot


def streams(replica: Replica) -> int:
    return int(replica.metrics()["splitslam_map_streams"]) if replica.alive else 0


def loads(stack: Stack) -> list[int]:
    """Robots of each replica, ascending."""
    return sorted(map(streams, stack.replicas))


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
