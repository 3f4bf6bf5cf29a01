"""The front's end of the socket to a worker process (channel.py)."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable
from typing import Any

from map_service import channel


class WorkerLink(asyncio.Protocol):
    """Hands each message to `take` in the turn of the event loop in which it arrives: a reader that is woken for the
    head and again for the body of each costs as much as what is in it.
    """

    def __init__(self, take: Callable[[Any], None]) -> None:
        self._take = take
        self._received = bytearray()
        self._transport: asyncio.WriteTransport | None = None
        self._room = asyncio.Event()
        self._room.set()
        self._lost = asyncio.Event()

    @classmethod
    async def over(cls, sock: socket.socket, take: Callable[[Any], None]) -> WorkerLink:
        """On a connected socket, which is its own from now on."""
        link = cls(take)
        await asyncio.get_running_loop().create_unix_connection(lambda: link, sock=sock)
        return link

    def write(self, message: Any) -> None:
        """Never waits. What is written to a worker that has died is lost."""
        if self._transport is not None and not self._lost.is_set():
            self._transport.write(channel.pack(message))

    async def send(self, message: Any) -> None:
        """Waits, after it, while the worker takes no more."""
        self.write(message)
        if not self._room.is_set():
            await self._room.wait()

    async def until_lost(self) -> None:
        """The worker has ended, or is as good as that."""
        await self._lost.wait()

    def close(self) -> None:
        if self._transport is not None:
            self._transport.close()

    # -- called by the event loop -------------------------------------------------------------------------------

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.WriteTransport)
        self._transport = transport

    def data_received(self, data: bytes) -> None:
        self._received += data
        for message in channel.take_whole(self._received):
            self._take(message)

    def pause_writing(self) -> None:
        self._room.clear()

    def resume_writing(self) -> None:
        self._room.set()

    def connection_lost(self, _error: Exception | None) -> None:
        self._lost.set()
        self._room.set()
