"""A robot's network link that can be made bad: a TCP relay between the agent and the proxy.

The agent is told the relay's address instead of the service's. What a packet network does is done to the byte stream,
as TCP shows it to a program: a lost packet is a stall of one retransmission timeout, a partition is silence.
"""

from __future__ import annotations

import asyncio
import random
import socket
import struct
import threading
import time
from collections import deque
from collections.abc import Callable, Coroutine, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Self

_CHUNK_BYTES = 16 * 1024
_BACKLOG = 64
_FILLERS = 2  # an accept queue of length 0 holds one connection
_QUEUED_CHUNKS = 64
_RETRANSMISSION_S = 0.2  # Linux's smallest retransmission timeout
_RESET = struct.pack("ii", 1, 0)  # SO_LINGER, zero: close() sends RST


@dataclass(frozen=True, slots=True)
class Quality:
    """What the link is like while it is up.

    kbps: of each direction, shared by all connections; None: unlimited. delay_s: one way. loss: share of chunks that
    are lost once. burst_bytes: what a full token bucket lets through at once.
    """

    kbps: float | None = None
    delay_s: float = 0.0
    loss: float = 0.0
    burst_bytes: int = 16 * 1024


class Link:
    """Listens on a free port and forwards to `target`. Every method may be called from any thread.

    partition(): nothing passes and nobody is told, new connections included; heal() lets what waited go on.
    cut(): every connection is reset; new ones are accepted.
    """

    def __init__(self, target: str, seed: int = 0) -> None:
        self._target = target.rpartition(":")[::2]
        self._random = random.Random(seed)
        self.quality = Quality()
        self.bytes_up = self.bytes_down = 0
        self._listener = socket.create_server(("127.0.0.1", 0), backlog=_BACKLOG)
        self._listener.setblocking(False)
        self.address = f"127.0.0.1:{self._listener.getsockname()[1]}"
        self._fillers: list[socket.socket] = []
        self._connections: dict[asyncio.Task[None], tuple[socket.socket, socket.socket]] = {}
        self._loop = asyncio.new_event_loop()
        self._open = asyncio.Event()
        self._buckets = {"up": _Bucket(), "down": _Bucket()}
        self._thread = threading.Thread(target=self._run, name="link", daemon=True)
        self._thread.start()

    # --- what can be done to it -------------------------------------------------------------------------------

    def partition(self) -> None:
        """Silence from now on, in both directions."""
        self._call(self._partition)

    def heal(self) -> None:
        """The end of a partition: what was under way arrives after all."""
        self._call(self._heal)

    def cut(self) -> None:
        """Resets every connection."""
        self._call(self._cut)

    @property
    def up(self) -> bool:
        """Not partitioned."""
        return self._open.is_set()

    def close(self) -> None:
        """Ends the relay and every connection."""
        if self._thread.is_alive():
            self._call(self._loop.stop)
            self._thread.join()
        self._listener.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # --- on the relay's own thread ----------------------------------------------------------------------------

    def _call(self, action: Callable[[], None]) -> None:
        done = threading.Event()

        def act() -> None:
            try:
                action()
            finally:
                done.set()

        self._loop.call_soon_threadsafe(act)
        done.wait()

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        self._heal()
        self._loop.run_forever()
        self._partition()
        self._drop_fillers()
        self._cut()
        self._loop.run_until_complete(asyncio.gather(*self._connections, return_exceptions=True))
        self._loop.close()

    def _partition(self) -> None:
        if not self._open.is_set():
            return
        self._open.clear()
        self._accepting.cancel()
        # A full accept queue makes the kernel ignore new connections, as a network that swallows them would.
        self._listener.listen(0)
        for _ in range(_FILLERS):
            filler = socket.socket()
            filler.setblocking(False)
            filler.connect_ex(self._listener.getsockname())
            self._fillers.append(filler)

    def _heal(self) -> None:
        if self._open.is_set():
            return
        self._drop_fillers()
        self._listener.listen(_BACKLOG)
        self._open.set()
        self._accepting = self._loop.create_task(self._accept())

    def _drop_fillers(self) -> None:
        for filler in self._fillers:
            filler.close()
        self._fillers.clear()

    def _cut(self) -> None:
        for task, pair in self._connections.items():
            for end in pair:
                with suppress(OSError):  # it has just come to its end by itself
                    end.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET)
            task.cancel()

    async def _accept(self) -> None:
        while True:
            near, _ = await self._loop.sock_accept(self._listener)
            near.setblocking(False)
            far = socket.socket()
            far.setblocking(False)
            task = self._loop.create_task(self._carry(near, far))
            self._connections[task] = near, far
            task.add_done_callback(self._connections.pop)

    async def _carry(self, near: socket.socket, far: socket.socket) -> None:
        """One connection from its beginning to its end."""
        with near, far:
            for end in (near, far):
                end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            host, port = self._target
            try:
                await self._loop.sock_connect(far, (host, int(port)))
            except OSError:  # refused there, so refused here
                near.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET)
                return
            ways = [_Pump(self, "up").run(near, far), _Pump(self, "down").run(far, near)]
            await _first(ways)

    def count(self, way: str, size: int) -> None:
        if way == "up":
            self.bytes_up += size
        else:
            self.bytes_down += size

    async def ready(self, way: str, size: int) -> None:
        """Returns when `size` bytes may pass now."""
        if (quality := self.quality).kbps is not None:
            await asyncio.sleep(self._buckets[way].wait_s(size, quality.kbps, quality.burst_bytes, time.monotonic()))
        if self._random.random() < quality.loss:
            await asyncio.sleep(_RETRANSMISSION_S + 2 * quality.delay_s)
        await self._open.wait()

    async def opened(self) -> None:
        """Returns when there is no partition."""
        await self._open.wait()


class _Bucket:
    """A token bucket that may be overdrawn: whoever overdraws it waits until the debt is paid."""

    def __init__(self) -> None:
        self._bytes, self._at_s = 0.0, float("-inf")

    def wait_s(self, size: int, kbps: float, burst_bytes: int, now_s: float) -> float:
        bytes_per_s = kbps * 1000 / 8
        self._bytes = min(self._bytes + (now_s - self._at_s) * bytes_per_s, burst_bytes) - size
        self._at_s = now_s
        return max(0.0, -self._bytes / bytes_per_s)


class _Pump:
    """One direction of one connection. Reading and writing are two tasks, so that delay costs no throughput."""

    def __init__(self, link: Link, way: str) -> None:
        self._link, self._way = link, way
        self._loop = asyncio.get_running_loop()
        self._waiting: deque[tuple[float, bytes]] = deque()
        self._changed = asyncio.Condition()

    async def run(self, source: socket.socket, sink: socket.socket) -> None:
        """Until the end of `source` has reached `sink`, or `sink` is gone."""
        reading = asyncio.ensure_future(self._read(source))
        try:
            await self._write(sink)
        finally:
            reading.cancel()

    async def _read(self, source: socket.socket) -> None:
        while True:
            await self._link.opened()
            try:
                data = await self._loop.sock_recv(source, _CHUNK_BYTES)
            except OSError:
                data = b""
            async with self._changed:
                self._waiting.append((time.monotonic() + self._link.quality.delay_s, data))
                self._changed.notify()
                await self._changed.wait_for(lambda: len(self._waiting) < _QUEUED_CHUNKS)
            if not data:
                return

    async def _write(self, sink: socket.socket) -> None:
        while True:
            async with self._changed:
                await self._changed.wait_for(lambda: self._waiting)
                due_s, data = self._waiting.popleft()
                self._changed.notify()
            await asyncio.sleep(max(0.0, due_s - time.monotonic()))
            await self._link.ready(self._way, len(data))
            if not data:
                return
            self._link.count(self._way, len(data))  # first: whoever has got the bytes may look at once
            await self._loop.sock_sendall(sink, data)


async def _first(work: Sequence[Coroutine[Any, Any, None]]) -> None:
    """Runs all until one ends, well or not; then none is left."""
    tasks = [asyncio.ensure_future(each) for each in work]
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
