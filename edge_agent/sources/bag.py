"""ROS 1 and ROS 2 recordings through `rosbags`: opening, topics, messages; every failure is one clear line."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection, ConnectionExtRosbag1, MessageDefinitionFormat, Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from edge_agent.raw_ring import RawStream
from edge_agent.sources.source import Tap
from splitslam.errors import DataError, InputError

_MORE_TYPES = {
    "velodyne_msgs/msg/VelodynePacket": "builtin_interfaces/Time stamp\nuint8[1206] data\n",
    "velodyne_msgs/msg/VelodyneScan": "std_msgs/Header header\nvelodyne_msgs/VelodynePacket[] packets\n",
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms\n",  # not in the store of ROS 1
}
_EXPECTED = "expected a ROS 1 .bag, a ROS 2 bag folder, .db3 or .mcap"


class Bag:
    """An open recording. Use as a context manager or call `close`."""

    def __init__(self, path: Path) -> None:
        """Raises InputError: missing, not a recording, truncated."""
        self.path = path
        _look_at(path)
        try:
            self._reader = AnyReader([path], default_typestore=typestore())
            self._reader.open()
        except Exception as error:  # the readers raise whatever their parser trips over
            raise InputError(f"{path}: {_reason(error)}") from error
        self.connections: list[Connection] = list(self._reader.connections)

    def topics(self) -> dict[str, str]:
        """Topic -> message type, sorted by topic."""
        return {c.topic: c.msgtype for c in sorted(self.connections, key=lambda c: c.topic)}

    def count(self, topic: str) -> int:
        """Messages on a topic as the recording's index says."""
        return sum(c.msgcount for c in self.connections if c.topic == topic)

    def check_definitions(self, topics: set[str]) -> None:
        """Raises InputError where a recording's own definition of a type lacks what that type has elsewhere."""
        usual = typestore()
        for connection in self.connections:
            if connection.topic in topics:
                try:
                    lacking = _lacking(self._reader.typestore, usual, connection.msgtype)
                except Exception as error:  # it names types that are not there
                    lacking = _one_line(error)
                if lacking:
                    of = f"{connection.topic}: the recording's definition of {connection.msgtype}"
                    raise InputError(f"{self.path}: {of} is not the usual one; expected a field {lacking}")

    def messages(self, topics: set[str], tap: Tap | None = None) -> Iterator[tuple[str, int, Any]]:
        """(topic, arrival time ns, message or DataError), recording order. InputError when the file is damaged.

        tap: gets each message as it is in the recording, also one that does not parse.
        """
        streams = {c.id: stream_of(c) for c in self.connections if tap is not None}
        connections = [c for c in self.connections if c.topic in topics]
        raw_messages: Generator[tuple[Connection, int, bytes], None, None] = self._reader.messages(connections)
        read = 0
        while True:
            try:
                connection, arrival_ns, raw = next(raw_messages)
            except StopIteration:
                return
            except Exception as error:
                raise InputError(f"{self.path}: damaged after {read} messages: {_one_line(error)}") from error
            read += 1
            if tap is not None:
                tap(streams[connection.id], arrival_ns, raw)
            try:
                message = self._reader.deserialize(raw, connection.msgtype)
            except Exception as error:  # a message that does not parse is dropped, the stream goes on
                message = DataError("decode", _one_line(error))
            yield connection.topic, arrival_ns, message

    def close(self) -> None:
        """Closes the files; a second call does nothing."""
        if self._reader.stack is not None:
            self._reader.close()

    def __enter__(self) -> Bag:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def stream_of(connection: Connection) -> RawStream:
    """A topic of a recording as the raw ring knows it."""
    return RawStream(
        topic=connection.topic,
        msgtype=connection.msgtype,
        encoding="ros1" if isinstance(connection.ext, ConnectionExtRosbag1) else "cdr",
        definition=connection.msgdef.data,
        format="idl" if connection.msgdef.format is MessageDefinitionFormat.IDL else "msg",
        digest=connection.digest,
    )


def typestore(base: Stores = Stores.ROS2_HUMBLE) -> Typestore:
    """Types where no definitions come along: ROS 2 recordings (sqlite3 ones before Iron), live graphs."""
    store = get_typestore(base)
    types: dict[str, Any] = {}
    for name, definition in _MORE_TYPES.items():
        if name not in store.fielddefs:
            types.update(get_types_from_msg(definition, name))
    store.register(types)
    return store


def _lacking(types: Typestore, usual: Typestore, name: str) -> str:
    """The first field that the usual type has, of that very type, and the other has not; "" when none is missing."""
    found = dict(types.fielddefs[name][1])
    for field, kind in usual.fielddefs[name][1]:
        if found.get(field) != kind:
            return f"{name}.{field}"
        if (inner := _named(kind)) and (lacking := _lacking(types, usual, inner)):
            return lacking
    return ""


def _named(kind: Any) -> str | None:
    """The message type in a field, or in a list of them."""
    node, of = kind
    if node is Nodetype.NAME:
        return str(of)
    return _named(of[0]) if node in (Nodetype.ARRAY, Nodetype.SEQUENCE) else None


def _look_at(path: Path) -> None:
    """The plain mistakes, before a parser sees the file."""
    if not path.exists():
        raise InputError(f"{path}: no such recording; {_EXPECTED}")
    if path.is_dir():
        if not (path / "metadata.yaml").is_file():
            raise InputError(f"{path}: not a recording: no metadata.yaml in the folder; {_EXPECTED}")
        return
    magic = {".bag": b"#ROSBAG V2.0", ".db3": b"SQLite format 3\0", ".mcap": b"\x89MCAP0"}.get(path.suffix)
    if magic is None:
        raise InputError(f"{path}: not a recording; {_EXPECTED}")
    try:
        with path.open("rb") as file:
            head = file.read(len(magic))
    except OSError as error:
        raise InputError(f"{path}: cannot read: {error.strerror or error}") from error
    if head != magic:
        raise InputError(f"{path}: not a recording: it does not start as a {path.suffix} file; {_EXPECTED}")


def _reason(error: Exception) -> str:
    text = _one_line(error)
    if any(
        hint in text.lower()
        for hint in ("index", "footer", "magic", "malformed", "chunk", "end of file", "memoryerror")
    ):
        return f"truncated or damaged recording: {text}; expected a complete one (try `rosbag reindex`)"
    return f"not a readable recording: {text}"


def _one_line(error: BaseException) -> str:
    return " ".join(f"{error}".split()) or type(error).__name__
