"""Messages between the front and a worker process, and the blocking end that the worker reads.

One socket pair a worker; a message is a length and a pickle: both ends are this program, nothing else can write there.
"""

from __future__ import annotations

import pickle
import select
import socket
import struct
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

HEADER = struct.Struct("!I")
_READ_BYTES = 1 << 18


@dataclass(frozen=True, slots=True)
class Open:
    """A robot's stream has begun with this Hello (serialised)."""

    stream: int
    session_id: str
    hello: bytes


@dataclass(frozen=True, slots=True)
class Request:
    """A StreamRequest (serialised) that is not a Hello. front_cpu_ns: CPU time of the front so far."""

    stream: int
    body: bytes
    front_cpu_ns: int


@dataclass(frozen=True, slots=True)
class Close:
    """The stream is gone; the session stays."""

    stream: int


@dataclass(frozen=True, slots=True)
class Forget:
    """The session was deleted from the store."""

    session_id: str


@dataclass(frozen=True, slots=True)
class HandOver:
    """Commit the session of this stream, answer Handed; the robot goes elsewhere and the stream ends."""

    stream: int


@dataclass(frozen=True, slots=True)
class Watch:
    """Whose scans somebody looks at: of these robots, or of all. Said anew whenever somebody begins or ends to."""

    robots: frozenset[str] = frozenset()
    all_robots: bool = False

    def wants(self, session_id: str) -> bool:
        return self.all_robots or session_id.partition("/")[0] in self.robots


@dataclass(frozen=True, slots=True)
class DrainAll:
    """Answer what is queued, commit every session, say Handed for each stream and Drained, exit."""


@dataclass(frozen=True, slots=True)
class Ready:
    """The worker is warm and takes streams."""

    pid: int


@dataclass(frozen=True, slots=True)
class Reply:
    """A StreamResponse (serialised). answer: it answers a frame. last: the stream ends well after it."""

    stream: int
    body: bytes
    answer: bool = False
    last: bool = False


@dataclass(frozen=True, slots=True)
class Seen:
    """What those who watch see of a session: a WatchScansResponse (serialised). stream: None without one."""

    stream: int | None
    session_id: str
    site_id: str
    body: bytes


@dataclass(frozen=True, slots=True)
class Abort:
    """The stream ends with this status (a name of grpc.StatusCode); the robot resumes."""

    stream: int
    status: str
    detail: str


@dataclass(frozen=True, slots=True)
class Handed:
    """All that was answered on this stream is durable."""

    stream: int
    durable_seq: int


@dataclass(frozen=True, slots=True)
class RobotStanding:
    """One session as its worker sees it. stream: None without one. times on the system's monotonic clock."""

    session_id: str
    stream: int | None
    state: int
    scans: int
    last_stamp_ns: int
    opened_s: float
    undurable_frames: int
    backlog_frames: int
    position_sigma_m: float
    rotation_sigma_rad: float

    @property
    def robot_id(self) -> str:
        return self.session_id.partition("/")[0]


@dataclass(frozen=True, slots=True)
class Beat:
    """Sign of life twice a second: what happened since the last one, and where every open stream stands.

    counts: (metric, label values...) -> increment. observations: ((metric, label values...), value).
    busy_s: how long the pipeline thread has been at its present job. durable: stream -> durable_seq.
    sessions: number by state. robots: each of them, where gauges by robot are wanted.
    queue_messages, undurable_frames: what waits for the thread, and for the store. cpu_s: loop verifiers included.
    """

    counts: dict[tuple[str, ...], float]
    observations: list[tuple[tuple[str, ...], float]]
    busy_s: float
    durable: dict[int, int]
    sessions: dict[str, int]
    released: list[str] = field(default_factory=list)
    robots: list[RobotStanding] = field(default_factory=list)
    queue_messages: int = 0
    undurable_frames: int = 0
    cpu_s: float = 0.0
    resident_bytes: int = 0


@dataclass(frozen=True, slots=True)
class Drained:
    """Everything is committed; the worker is about to exit."""

    durable: dict[int, int]


_KINDS = (Open, Request, Close, Forget, HandOver, Watch, DrainAll)
_KINDS += (Ready, Reply, Seen, Abort, Handed, Beat, Drained)
_NUMBERS = {kind: (number, kind.__slots__) for number, kind in enumerate(_KINDS)}


def pack(message: Any) -> bytes:
    """As its kind's number and its fields: a frozen dataclass pickled by itself takes twice as long."""
    number, names = _NUMBERS[type(message)]
    body = pickle.dumps((number, *[getattr(message, name) for name in names]), pickle.HIGHEST_PROTOCOL)
    return HEADER.pack(len(body)) + body


def unpack(body: bytes | bytearray) -> Any:
    """What `pack` made, without its header."""
    number, *values = pickle.loads(body)
    return _KINDS[number](*values)


def take_whole(received: bytearray) -> Iterator[Any]:
    """Takes the messages that are complete off the beginning of what was received."""
    begin = 0
    while len(received) - begin >= HEADER.size:
        (size,) = HEADER.unpack_from(received, begin)
        end = begin + HEADER.size + size
        if len(received) < end:
            break
        message = unpack(received[begin + HEADER.size : end])
        begin = end
        yield message
    del received[:begin]


class WorkerEnd:
    """The worker's end. `send` may be called by any thread, `receive` by one."""

    def __init__(self, sock: socket.socket) -> None:
        sock.setblocking(True)
        self._sock = sock
        self._readable = select.poll()
        self._readable.register(sock, select.POLLIN)
        self._received = bytearray()
        self._lock = threading.Lock()

    def send(self, message: Any) -> None:
        """Raises OSError when the front is gone."""
        data = pack(message)
        with self._lock:
            self._sock.sendall(data)

    def receive(self, timeout_s: float) -> list[Any] | None:
        """The messages that have come, none if none comes in time; None when the front is gone."""
        if not self._readable.poll(timeout_s * 1e3):
            return []
        data = self._sock.recv(_READ_BYTES)
        if not data:
            return None
        self._received += data
        return list(take_whole(self._received))
