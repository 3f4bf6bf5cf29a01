"""A ROS 2 graph through CycloneDDS alone: ROS 2's topics as they are on the wire, without a ROS installation.

There the topic `/imu/data` is `rt/imu/data`, its type `sensor_msgs/msg/Imu` is `sensor_msgs::msg::dds_::Imu_`, and the
graph is the DDS domain $ROS_DOMAIN_ID (design.ros2.org, "Topic and Service name mapping to DDS").
"""

from __future__ import annotations

import os
import threading
import time
from collections import Counter
from typing import Any

from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
from cyclonedds.core import DDSException, GuardCondition, InstanceState, WaitSet
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from edge_agent.ros.codec import Codec
from edge_agent.ros.dds.subscription import TAKE, Subscription, qos_of
from edge_agent.ros.dds.types import raw_type, ros_type_name
from edge_agent.ros.graph import Delivery, Receive, Send
from edge_agent.ros.guard import Guard
from edge_agent.ros.settings import Ros2Settings
from splitslam.errors import InputError

_PREFIX = "rt/"
_LOOK_MS = 200  # for publishers of another kind
_FAILED_S = 0.2  # a middleware that fails each time is not asked without end


def domain_of(settings: Ros2Settings) -> int:
    """The DDS domain. Raises InputError for a ROS_DOMAIN_ID that is none."""
    if settings.domain_id is not None:
        return settings.domain_id
    text = os.environ.get("ROS_DOMAIN_ID") or "0"
    if not text.isdecimal() or int(text) > 232:
        raise InputError(f"ROS_DOMAIN_ID={text}: expected a number from 0 to 232")
    return int(text)


class DdsGraph:
    """Graph: one participant, and a thread that takes what has come."""

    def __init__(self, settings: Ros2Settings) -> None:
        """Raises InputError when there can be no participant, as with a CYCLONEDDS_URI that is wrong."""
        domain = domain_of(settings)
        self.name = f"ROS 2 domain {domain} (CycloneDDS)"
        self.codec = Codec("cdr")
        self.lost: Counter[str] = Counter()
        self._guard = Guard(self.lost)
        try:
            self._participant = DomainParticipant(domain)
        except DDSException as error:
            raise InputError(f"{self.name}: cannot be joined: {error}; see CYCLONEDDS_URI") from error
        self._published = BuiltinDataReader(self._participant, BuiltinTopicDcpsPublication)
        self._writers: dict[Any, Any] = {}  # of others, by key
        self._topics: dict[str, Topic] = {}
        self._subscriptions: list[Subscription] = []
        self._own: list[DataWriter] = []  # CycloneDDS takes back what nobody holds
        self._lock = threading.Lock()
        self._waitset = WaitSet(self._participant)
        self._closing = GuardCondition(self._participant)
        self._waitset.attach(self._closing)
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="ros2", daemon=True)
        self._thread.start()

    # --- who is there -------------------------------------------------------------------------------------------

    def topics(self) -> dict[str, str]:
        found: dict[str, str] = {}
        for writer in self._others():
            msgtype = ros_type_name(writer.type_name)
            if msgtype is not None and writer.topic_name.startswith(_PREFIX):
                found["/" + writer.topic_name.removeprefix(_PREFIX)] = msgtype
        return found

    def _others(self) -> list[Any]:
        """Writers of other participants, on this machine and on others."""
        own = self._participant.guid
        with self._lock:
            while samples := self._published.take(TAKE):
                for writer in samples:
                    if writer.sample_info.instance_state == InstanceState.Alive:
                        self._writers[writer.key] = writer
                    else:
                        self._writers.pop(writer.key, None)
            return [writer for writer in self._writers.values() if writer.participant_key != own]

    # --- messages -----------------------------------------------------------------------------------------------

    def subscribe(self, topic: str, msgtype: str, delivery: Delivery, receive: Receive) -> None:
        dds = self._topic(topic, msgtype)
        guarded = self._guard.guarded(topic, receive)
        subscription = Subscription(self._participant, dds, delivery, guarded, self._on_lost)
        with self._lock:
            self._subscriptions = [*self._subscriptions, subscription]
            self._waitset.attach(subscription.condition)

    def advertise(self, topic: str, msgtype: str, delivery: Delivery) -> Send:
        dds = self._topic(topic, msgtype)
        writer = DataWriter(self._participant, dds, qos_of(delivery, reliable=True))
        self._own.append(writer)
        return lambda raw: writer.write(dds.data_type(raw))

    def _topic(self, topic: str, msgtype: str) -> Topic:
        with self._lock:
            if topic not in self._topics:
                kind = raw_type(msgtype, self.codec.types)
                self._topics[topic] = Topic(self._participant, _dds_name(topic), kind)
            return self._topics[topic]

    def _on_lost(self, count: int) -> None:
        self.lost["ros_lost"] += count

    def _run(self) -> None:
        while not self._closed:
            try:
                self._take()
            except Exception:
                self._guard.failed(self.name)
                time.sleep(_FAILED_S)

    def _take(self) -> None:
        self._waitset.wait(duration(milliseconds=_LOOK_MS))
        for subscription in self._subscriptions:
            if (condition := subscription.widened()) is not None:
                self._waitset.attach(condition)
            if not self._closed:
                subscription.take()

    def close(self) -> None:
        if not self._closed:
            self._closed = True
            self._closing.set(True)
            self._thread.join()
            for writer in self._own:
                writer.wait_for_acks(duration(milliseconds=200))
            self._participant.__del__()  # with all that is in it, and not when Python comes round to it


def _dds_name(topic: str) -> str:
    return _PREFIX + topic.removeprefix("/")
