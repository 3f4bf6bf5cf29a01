"""A ROS 1 graph through `rospy`. Only bytes pass through it: no message package is needed besides rospy's own."""

from __future__ import annotations

import contextlib
import importlib
import os
import sys
import threading
from collections import Counter
from pathlib import Path
from typing import Any

from edge_agent.ros.codec import Codec
from edge_agent.ros.graph import Delivery, Receive, Send
from edge_agent.ros.patience import Patience
from edge_agent.ros.settings import Ros1Settings
from splitslam.errors import InputError

_DEBIAN = Path("/usr/lib/python3/dist-packages")
_BUFFER_BYTES = 16 * 2**20  # rospy reads a socket in pieces of this size: at 64 KiB a cloud lags behind


class RospyGraph:
    """Graph: this process as a node of a ROS 1 master. There can be one in a process."""

    def __init__(self, settings: Ros1Settings, stop: threading.Event) -> None:
        """Raises InputError without rospy, or when no master is there in time; StoppedError on `stop`."""
        self._rospy = _rospy(settings)
        master = settings.master or os.environ.get("ROS_MASTER_URI", "http://localhost:11311")
        os.environ["ROS_MASTER_URI"] = master
        os.environ["ROS_NAMESPACE"] = settings.namespace
        self.name = f"ROS 1 at {master}"
        self.codec = Codec("ros1")
        self.lost: Counter[str] = Counter()
        self._closed = False
        self._ends: list[Any] = []
        self._lock = threading.Lock()
        rosgraph: Any = importlib.import_module("rosgraph")
        patience = Patience(settings.wait_s, stop)
        while not rosgraph.is_master_online():
            if patience.over:
                raise InputError(f"{self.name}: no master answers; expected a running roscore there (ROS_MASTER_URI)")
            patience.pause(self.name)
        self._rospy.core.configure_logging = lambda *_: None  # it would set up the logs of the whole process
        self._rospy.init_node(settings.node, disable_signals=True, disable_rosout=True)

    def topics(self) -> dict[str, str]:
        own = {end.resolved_name for end in self._ends if hasattr(end, "publish")}
        return {
            topic: msgtype.replace("/", "/msg/")
            for topic, msgtype in self._rospy.get_published_topics()
            if topic not in own
        }

    def subscribe(self, topic: str, msgtype: str, delivery: Delivery, receive: Receive) -> None:
        def on_message(message: Any) -> None:
            if not self._closed:
                receive(message._buff)

        kind = _message_class(msgtype, self.codec)
        end = self._rospy.Subscriber(topic, kind, on_message, buff_size=_BUFFER_BYTES, tcp_nodelay=True)
        with self._lock:
            self._ends.append(end)

    def advertise(self, topic: str, msgtype: str, delivery: Delivery) -> Send:
        kind = _message_class(msgtype, self.codec)
        end = self._rospy.Publisher(topic, kind, latch=delivery.latched, queue_size=delivery.keep, tcp_nodelay=True)
        with self._lock:
            self._ends.append(end)
        return lambda raw: end.publish(kind(raw))

    def close(self) -> None:
        if self._closed:
            return
        self._closed = True
        for end in self._ends:
            end.unregister()
        # No signal_shutdown: it closes the socket that another thread accepts on, and its number may be given out again
        # before that thread looks. The process ends anyway.


def _message_class(msgtype: str, codec: Codec) -> Any:
    """A class as ROS 1's generated ones, whose only content is the message's bytes."""
    genpy: Any = importlib.import_module("genpy")
    definition, digest = codec.definition(msgtype)

    class Raw(genpy.Message):
        _type = msgtype.replace("/msg/", "/")
        _md5sum = digest
        _full_text = definition
        _has_header = False  # else rospy would count in `seq`
        __slots__ = ("_buff",)
        _slot_types = ("uint8[]",)

        def __init__(self, raw: bytes = b"") -> None:
            self._buff = raw

        def serialize(self, buff: Any) -> None:
            buff.write(self._buff)

        def deserialize(self, data: bytes) -> Raw:
            self._buff = bytes(data)
            return self

    return Raw


def _rospy(settings: Ros1Settings) -> Any:
    """The module, from the agent's own environment or from Debian's packages."""
    for folder in (None, settings.python_path or _DEBIAN):
        if folder is not None:
            if not (folder / "rospy").is_dir():
                break
            sys.path.append(str(folder))  # last: our own versions of everything else stay
        with contextlib.suppress(ModuleNotFoundError):
            return importlib.import_module("rospy")
    raise InputError(
        f"ros1: rospy is not there: expected it in the agent's environment or in {settings.python_path or _DEBIAN}"
        " (Debian: apt-get install python3-rospy; see docs/ros.md)"
    )
