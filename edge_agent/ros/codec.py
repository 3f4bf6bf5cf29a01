"""Messages of ROS 1 and ROS 2 between their bytes and records, by `rosbags`, as the bags are read."""

from __future__ import annotations

from typing import Any, Literal

from rosbags.typesys import Stores

from edge_agent.raw_ring import RawStream
from edge_agent.sources.bag import typestore
from splitslam.errors import DataError

CLOCK = "rosgraph_msgs/msg/Clock"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
TF = "tf2_msgs/msg/TFMessage"
Encoding = Literal["ros1", "cdr"]


class Codec:
    """Types by their ROS 2 names (`sensor_msgs/msg/Imu`) in either encoding."""

    def __init__(self, encoding: Encoding) -> None:
        self.encoding: Encoding = encoding
        self.types = typestore(Stores.ROS1_NOETIC if encoding == "ros1" else Stores.ROS2_HUMBLE)
        store = self.types
        self._decode = store.deserialize_ros1 if encoding == "ros1" else store.deserialize_cdr
        self._encode = store.serialize_ros1 if encoding == "ros1" else store.serialize_cdr

    def decode(self, raw: bytes, msgtype: str) -> Any:
        """Bytes -> record; large arrays are views of `raw`. DataError `decode`."""
        try:
            return self._decode(raw, msgtype)
        except Exception as error:  # a parser raises whatever it trips over
            raise DataError("decode", " ".join(f"{error}".split())) from error

    def encode(self, message: Any) -> bytes:
        """Record -> bytes."""
        return bytes(self._encode(message, message.__msgtype__))

    def make(self, msgtype: str, *values: Any) -> Any:
        """A record of the type, its fields in the order of the definition."""
        return self.types.types[msgtype](*values)

    def header(self, stamp_ns: int, frame: str) -> Any:
        """std_msgs/Header."""
        seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
        stamp = self.make("builtin_interfaces/msg/Time", seconds, nanoseconds)
        counted = (0,) if self.encoding == "ros1" else ()  # seq, which publishers fill in
        return self.make("std_msgs/msg/Header", *counted, stamp, frame)

    def definition(self, msgtype: str) -> tuple[str, str]:
        """Text of a type's definition with all that it contains, and its MD5 sum, by ROS 1's rules."""
        return self.types.generate_msgdef(msgtype, ros_version=1)

    def stream(self, topic: str, msgtype: str) -> RawStream:
        """A topic as the raw ring knows it."""
        version = 1 if self.encoding == "ros1" else 2
        definition, digest = self.types.generate_msgdef(msgtype, ros_version=version)
        digest = digest if version == 1 else self.types.hash_rihs01(msgtype)
        return RawStream(topic, msgtype, self.encoding, definition, "msg", digest)
