"""What the agent needs of a ROS graph, whichever way it is reached. Messages are bytes; `Codec` reads them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from edge_agent.ros.codec import Codec

Receive = Callable[[bytes], None]
Send = Callable[[bytes], None]


@dataclass(frozen=True, slots=True)
class Delivery:
    """How a topic is delivered. keep: messages kept for a reader that is late. latched: the last ones also for readers
    that come later (ROS 2: transient local). sensor: the newest matters, not each one (ROS 2: best effort when the
    publisher offers no more)."""

    keep: int = 10
    latched: bool = False
    sensor: bool = False


RELIABLE = Delivery()
TRANSFORMS = Delivery(keep=100)
STATIC = Delivery(keep=100, latched=True)
SCANS = Delivery(keep=50, sensor=True)
SAMPLES = Delivery(keep=2000, sensor=True)


class Graph(Protocol):
    """A node in a graph. name: for people. lost: messages that the middleware says it has lost, by reason."""

    name: str
    codec: Codec
    lost: Counter[str]

    def topics(self) -> dict[str, str]:
        """What others publish now: topic -> type, as `/imu/data` -> `sensor_msgs/msg/Imu`."""
        ...

    def subscribe(self, topic: str, msgtype: str, delivery: Delivery, receive: Receive) -> None:
        """Calls `receive` with each message, in a thread of the graph's own."""
        ...

    def advertise(self, topic: str, msgtype: str, delivery: Delivery) -> Send:
        """What it returns publishes one message, from any thread, and does not wait for readers."""
        ...

    def close(self) -> None:
        """Leaves the graph; no `receive` is called any more when it returns. Twice is no error."""
        ...


def in_namespace(name: str, namespace: str) -> str:
    """A topic in full: `/name` as it is, `name` within the namespace."""
    if name.startswith("/"):
        return name
    return f"/{namespace}/{name}" if namespace else f"/{name}"
