"""A ROS graph inside the test: what others publish is said, what the agent sends is written down."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable
from typing import Any, Literal

from edge_agent.ros.codec import Codec
from edge_agent.ros.graph import Delivery, Receive, Send


class FakeGraph:
    """Implements edge_agent.ros.graph.Graph. there: what `topics` says. sent: topic -> decoded messages."""

    def __init__(self, encoding: Literal["ros1", "cdr"] = "cdr", there: dict[str, str] | None = None) -> None:
        self.name = "a graph"
        self.codec = Codec(encoding)
        self.lost: Counter[str] = Counter()
        self.there = there or {}
        self.sent: defaultdict[str, list[Any]] = defaultdict(list)
        self.advertised: list[str] = []
        self.deliveries: dict[str, Delivery] = {}
        self.receivers: defaultdict[str, list[Receive]] = defaultdict(list)
        self.on_subscribe: Callable[[str], None] = lambda topic: None
        self.broken = False
        self.closed = False

    def topics(self) -> dict[str, str]:
        return self.there

    def subscribe(self, topic: str, msgtype: str, delivery: Delivery, receive: Receive) -> None:
        self.receivers[topic].append(receive)
        self.deliveries[topic] = delivery
        self.on_subscribe(topic)

    def advertise(self, topic: str, msgtype: str, delivery: Delivery) -> Send:
        self.advertised.append(topic)

        def send(raw: bytes) -> None:
            if self.broken:
                raise RuntimeError("no route")
            self.sent[topic].append(self.codec.decode(raw, msgtype))
            for receive in self.receivers[topic]:  # a node hears itself
                receive(raw)

        return send

    def say(self, topic: str, message: Any) -> None:
        """Another node publishes."""
        raw = self.codec.encode(message)
        for receive in self.receivers[topic]:
            receive(raw)

    def close(self) -> None:
        self.closed = True
