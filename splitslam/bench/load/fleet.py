"""Many robots in one thread: encoded frames by the clock over real gRPC, a connection each, no edge behind them.

An edge agent's own uplink takes four threads a robot, which is right for one robot, but forty of them on the service's
cores would measure the generator. Here a frame is serialised once for all robots, and a robot costs what asyncio and
gRPC cost.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import grpc

from edge_agent.stream import ROUTE_KEY, route_key
from edge_agent.tcp_meter import TcpBytes, TcpMeter
from splitslam.bench.load.account import Account
from splitslam.stack.reel import Reel
from splitslam.wire import session_pb2 as pb

_METHOD = "/splitslam.v1.EdgeService/Stream"
_OPTIONS = [("grpc.use_local_subchannel_pool", 1), ("grpc.enable_http_proxy", 0), ("grpc.http2.bdp_probe", 0)]
_WELCOME_S, _LAST_S = 30.0, 30.0


@dataclass(frozen=True, slots=True)
class Played:
    """What a fleet did: a list of runs for each robot, TCP payload of all, and the generator's own CPU time, s."""

    accounts: list[Account]
    tcp: TcpBytes
    cpu_s: float
    seconds: float


class _Robot:
    """One run. `ready` once it is welcome; from `begin_s` on it sends a frame each period until `until_s`."""

    def __init__(self, server: str, reel: Reel, requests: Sequence[bytes], name: str, period_s: float) -> None:
        self.account = Account(name, reel)
        self._requests, self._period_s = requests, period_s
        hello = reel.hello_of(name)
        self._hello = pb.StreamRequest(hello=hello).SerializeToString()
        self._channel = grpc.aio.insecure_channel(server, _OPTIONS)
        self._call = self._channel.stream_stream(_METHOD)(metadata=((ROUTE_KEY, route_key(hello)),))
        self._window, self._changed = 1, asyncio.Event()
        self._listener: asyncio.Task[None] | None = None
        self._closing = False

    async def connect(self) -> None:
        """Until Welcome. Raises TimeoutError, grpc.RpcError."""
        await self._call.write(self._hello)
        async with asyncio.timeout(_WELCOME_S):
            while (response := await self._read()) is not None:
                if response.HasField("welcome"):
                    self._listener = asyncio.create_task(self._listen())
                    return
                if response.HasField("refused"):
                    break
        said = "the stream ended" if response is None else f"refused: {response.refused.detail}"
        self.account.complain(f"no Welcome: {said}")

    async def _read(self) -> pb.StreamResponse | None:
        body = await self._call.read()
        return pb.StreamResponse.FromString(body) if isinstance(body, bytes) else None  # grpc.aio.EOF

    async def _listen(self) -> None:
        account = self.account
        try:
            while (response := await self._read()) is not None:
                kind = response.WhichOneof("message")
                if kind == "odometry":
                    account.answer(response.odometry, time.monotonic())
                elif kind == "credit":
                    self._window = response.credit.window or self._window
                elif kind == "finished":
                    account.end(response.finished)
                elif kind in ("refused", "drain"):
                    account.complain(f"{kind} after {len(account.answered_s)} answers")
                self._changed.set()
        except grpc.RpcError as error:
            if self._closing:  # our own cancelling, which a stream that has just ended tells as an error
                return
            account.complain(f"the stream broke: {error.code().name}: {error.details()}")
        self._changed.set()

    async def play(self, begin_s: float, until_s: float) -> None:
        """Frames by the clock, until the last is answered; what goes wrong is in the account."""
        with self._told():
            for number, request in enumerate(self._requests):
                due_s = begin_s + number * self._period_s
                if due_s >= until_s or self._listener is None:
                    break
                if (wait_s := due_s - time.monotonic()) > 0:
                    await asyncio.sleep(wait_s)
                await self._until(lambda: self.account.unanswered < self._window)
                self.account.sent(due_s, time.monotonic())
                await self._call.write(request)
            await self._until(lambda: self.account.unanswered == 0)

    async def finish(self) -> None:
        """Says Bye, until the service has closed the session."""
        with self._told():
            bye = pb.Bye(last_seq=len(self.account.sent_s))
            await self._call.write(pb.StreamRequest(bye=bye).SerializeToString())
            await self._until(lambda: self.account.finished is not None)

    @contextmanager
    def _told(self) -> Iterator[None]:
        try:
            yield
        except TimeoutError:
            what = f"{self.account.unanswered} frames" if self.account.unanswered else "Bye"
            self.account.complain(f"{what} unanswered for {_LAST_S:g} s")
        except (grpc.RpcError, asyncio.InvalidStateError) as error:
            self.account.complain(f"cannot send: {error}")

    async def _until(self, done: Callable[[], bool]) -> None:
        """Raises TimeoutError; returns also when the stream is over, which the account then holds."""
        if done():
            return
        async with asyncio.timeout(_LAST_S):
            while not done() and self._listener is not None and not self._listener.done():
                self._changed.clear()
                await self._changed.wait()

    async def close(self) -> None:
        self._closing = True
        self._call.cancel()
        if self._listener is not None:
            await asyncio.gather(self._listener, return_exceptions=True)
        await self._channel.close()


class Fleet:
    """`robots` robots at `server`, each at `rate_hz`; robot i begins `offsets_s[i]` after the first."""

    def __init__(self, server: str, reel: Reel, offsets_s: Sequence[float], rate_hz: float = 10.0) -> None:
        self._server, self._reel, self._offsets_s = server, reel, offsets_s
        self._period_s = 1.0 / rate_hz
        self._requests = [pb.StreamRequest(frame=frame).SerializeToString() for frame in reel.frames]

    def play(self, seconds: float, look: Callable[[], None]) -> Played:
        """For that long, or the drive's length if that is shorter; `look` is called before the first frame of all and
        after the last answer.
        """
        return asyncio.run(self._play(seconds, look))

    async def _play(self, seconds: float, look: Callable[[], None]) -> Played:
        robots = [
            _Robot(self._server, self._reel, self._requests, f"rover-{i + 1}", self._period_s)
            for i in range(len(self._offsets_s))
        ]
        host, _, port = self._server.rpartition(":")
        meter = TcpMeter(host, int(port))
        try:
            for robot in robots:
                await robot.connect()
            meter.discover()
            look()
            opened, cpu_s = meter.read(), time.process_time()
            begin_s = time.monotonic() + 0.1
            length_s = min(seconds, len(self._requests) * self._period_s)
            play = [
                robot.play(begin_s + offset_s, begin_s + offset_s + length_s)
                for robot, offset_s in zip(robots, self._offsets_s, strict=True)
            ]
            await asyncio.gather(*play)
            tcp, cpu_s = meter.read(), time.process_time() - cpu_s
            look()  # while nobody waits: it holds up the processes that are looked at
            await asyncio.gather(*(robot.finish() for robot in robots))
            used = TcpBytes(tcp.sent - opened.sent, tcp.received - opened.received)
            return Played([robot.account for robot in robots], used, cpu_s, length_s)
        finally:
            await asyncio.gather(*(robot.close() for robot in robots))
            meter.settle()
