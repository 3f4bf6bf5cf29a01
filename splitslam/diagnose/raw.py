"""The ring of raw messages as a recording that `splitslam run` and `splitslam check` read."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import get_types_from_idl, get_types_from_msg

from edge_agent.raw_ring import RawStream, read_ring
from edge_agent.sources.bag import typestore

_ROS1 = "ros1"


@dataclass(frozen=True, slots=True)
class RawPart:
    """What there was. path: raw.bag, or the folder of a ROS 2 recording (mcap); None without any message."""

    path: Path | None
    seconds: float
    messages: dict[str, int]

    def rate_hz(self, topic: str) -> float | None:
        count = self.messages.get(topic, 0)
        return (count - 1) / self.seconds if count > 1 and self.seconds > 0 else None


def write_raw(ring: Path, seconds: float, out: Path) -> RawPart:
    """The last `seconds` of the ring as a recording in the folder `out`, of the kind that the source was."""
    writer: Any = None
    connections: dict[RawStream, Any] = {}
    counts: Counter[str] = Counter()
    first_ns = last_ns = 0
    path: Path | None = None
    try:
        for stream, arrival_ns, raw in read_ring(ring, seconds):
            if writer is None:
                path = out / ("raw.bag" if stream.encoding == _ROS1 else "raw")
                first_ns = arrival_ns
                writer = _writer(path, stream.encoding)
                writer.open()
            if stream not in connections:
                connections[stream] = _connection(writer, stream)
            writer.write(connections[stream], arrival_ns, raw)
            counts[stream.topic] += 1
            last_ns = max(last_ns, arrival_ns)
    finally:
        if writer is not None:
            writer.close()
    return RawPart(path, (last_ns - first_ns) * 1e-9, dict(counts))


def _writer(path: Path, encoding: str) -> Any:
    return Writer1(path) if encoding == _ROS1 else Writer2(path, version=9, storage_plugin=StoragePlugin.MCAP)


def _connection(writer: Any, stream: RawStream) -> Any:
    if isinstance(writer, Writer1):
        return writer.add_connection(stream.topic, stream.msgtype, msgdef=stream.definition, md5sum=stream.digest)
    store = typestore()
    if stream.definition:
        read = get_types_from_idl if stream.format == "idl" else None
        types = read(stream.definition) if read else get_types_from_msg(stream.definition, stream.msgtype)
        store.register({name: type_ for name, type_ in types.items() if name not in store.fielddefs})
    return writer.add_connection(stream.topic, stream.msgtype, typestore=store)
