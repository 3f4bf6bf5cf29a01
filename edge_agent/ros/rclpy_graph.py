"""A ROS 2 graph through `rclpy`, where a ROS 2 is sourced; its middleware is then whatever that one uses.

Messages pass as the bytes they are on the wire: rclpy only needs the type's Python package to know its type support.
"""

from __future__ import annotations

import importlib
import threading
from collections import Counter
from typing import Any

from edge_agent.ros.codec import Codec
from edge_agent.ros.graph import Delivery, Receive, Send
from edge_agent.ros.guard import Guard
from edge_agent.ros.settings import Ros2Settings
from splitslam.errors import InputError


class RclpyGraph:
    """Graph: one node in a context of its own, spun by one thread."""

    def __init__(self, settings: Ros2Settings) -> None:
        """Raises InputError without rclpy."""
        try:
            self._rclpy: Any = importlib.import_module("rclpy")
        except ImportError as error:
            what = "rclpy is not there" if getattr(error, "name", "") == "rclpy" else f"rclpy: {error}"
            raise InputError(f"ros2.via: {what}: expected a sourced ROS 2 of this Python's version") from error
        rclpy = self._rclpy
        self._qos: Any = importlib.import_module("rclpy.qos")
        self._events: Any = importlib.import_module("rclpy.event_handler")
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=settings.domain_id)
        self._node = rclpy.create_node(settings.node, namespace=settings.namespace, context=self._context)
        self.name = f"ROS 2 domain {self._context.get_domain_id()} (rclpy)"
        self.codec = Codec("cdr")
        self.lost: Counter[str] = Counter()
        self._guard = Guard(self.lost)
        executors: Any = importlib.import_module("rclpy.executors")
        self._executor = executors.SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._closed = False
        self._thread = threading.Thread(target=self._executor.spin, name="ros2", daemon=True)
        self._thread.start()

    def topics(self) -> dict[str, str]:
        return {
            topic: kinds[0] for topic, kinds in self._node.get_topic_names_and_types() if self._publishers_of(topic)
        }

    def _publishers_of(self, topic: str) -> list[Any]:
        """Those of other nodes."""
        own = self._node.get_name(), self._node.get_namespace()
        there = self._node.get_publishers_info_by_topic(topic)
        return [info for info in there if (info.node_name, info.node_namespace) != own]

    def subscribe(self, topic: str, msgtype: str, delivery: Delivery, receive: Receive) -> None:
        reliable = not delivery.sensor or self._is_reliable(topic)
        events = self._events.SubscriptionEventCallbacks(message_lost=self._on_lost)
        profile = self._profile(delivery, reliable)
        guarded = self._guard.guarded(topic, receive)  # an exception would end the executor
        self._node.create_subscription(_class(msgtype), topic, guarded, profile, event_callbacks=events, raw=True)

    def _is_reliable(self, topic: str) -> bool:
        offers = [info.qos_profile.reliability for info in self._publishers_of(topic)]
        return bool(offers) and all(offer == self._qos.ReliabilityPolicy.RELIABLE for offer in offers)

    def advertise(self, topic: str, msgtype: str, delivery: Delivery) -> Send:
        return self._node.create_publisher(_class(msgtype), topic, self._profile(delivery, reliable=True)).publish

    def _profile(self, delivery: Delivery, reliable: bool) -> Any:
        qos = self._qos
        return qos.QoSProfile(
            history=qos.HistoryPolicy.KEEP_LAST,
            depth=delivery.keep,
            reliability=qos.ReliabilityPolicy.RELIABLE if reliable else qos.ReliabilityPolicy.BEST_EFFORT,
            durability=qos.DurabilityPolicy.TRANSIENT_LOCAL if delivery.latched else qos.DurabilityPolicy.VOLATILE,
        )

    def _on_lost(self, event: Any) -> None:
        self.lost["ros_lost"] += event.total_count_change

    def close(self) -> None:
        if not self._closed:
            self._closed = True
            self._executor.shutdown()
            self._thread.join()
            self._node.destroy_node()
            self._context.try_shutdown()


def _class(msgtype: str) -> Any:
    """`sensor_msgs/msg/Imu` -> sensor_msgs.msg.Imu. Raises InputError when its package is not installed."""
    package, _, name = msgtype.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ModuleNotFoundError, AttributeError) as error:
        raise InputError(f"ros2: the type {msgtype} is not there: expected the ROS package {package}") from error
