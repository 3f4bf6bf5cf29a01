"""A small fleet: an authority, one service behind two proxies (certificates; tokens), and calls to it."""

from __future__ import annotations

import contextlib
import json
import re
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import grpc

from splitslam.security.authority import Authority, Issued
from splitslam.security.client import Connector
from splitslam.security.identity import Identity
from splitslam.security.settings import ClientTls
from splitslam.stack import EnvoyProxy, Replica
from splitslam.stack.process import wait_until
from splitslam.stack.stack import service_tls
from splitslam.wire import dense_pb2, dense_pb2_grpc, view_pb2, view_pb2_grpc
from splitslam.wire import pose_pb2 as pose_pb
from splitslam.wire import pose_pb2_grpc as pose_rpc
from splitslam.wire import session_pb2 as pb
from splitslam.wire import session_pb2_grpc as rpc
from tests.conftest import ROOT
from tests.map_service.harness import frame, hello, new_run
from tests.stack.conftest import FAKE

FLEET, HOST = "farm.example", "127.0.0.1"
CALL_S = 30.0
_TLS_REASONS = ("no_certificate", "expired", "unknown_authority", "wrong_purpose")


@dataclass
class Fleet:
    """`authority` signs; `replica` serves; clients come by `envoy`, by `token_envoy`, or straight."""

    folder: Path
    authority: Authority
    replica: Replica
    envoy: EnvoyProxy
    token_envoy: EnvoyProxy
    _made: dict[Identity, Issued] = field(default_factory=dict)

    @property
    def ca(self) -> Path:
        return self.authority.folder / "ca.pem"

    def certificate(self, role: str, name: str = "", site: str = "", fleet: str = FLEET) -> Issued:
        """The same one each time."""
        identity = Identity(fleet, role, name, site)  # pyright: ignore[reportArgumentType]
        if identity not in self._made:
            self._made[identity] = self.authority.issue(identity, 5)
        return self._made[identity]

    def tls(self, issued: Issued | None = None, token: str | None = None) -> ClientTls:
        """With a certificate, a token, both, or neither (`ca` alone is what a stranger can have)."""
        values: dict[str, Any] = {"ca": self.ca}
        if issued is not None:
            values |= {"cert": issued.path, "key": issued.path.with_suffix(".key")}
        if token is not None:
            values["token"] = self.folder / f"token-{token[:8]}"
            values["token"].write_text(token)
        return ClientTls(**values)

    def counters(self) -> dict[str, int]:
        """Everything that counts refusals: of the service and of the mTLS proxy."""
        samples = self.replica.metrics()
        found = {}
        for name, value in samples.items():
            if match := re.fullmatch(r'splitslam_map_auth_refused_total\{reason="(\w+)"\}', name):
                found[match[1]] = int(value)
        for reason in _TLS_REASONS:
            found[f"envoy {reason}"] = self.envoy.stat(f"tls_refused.{reason}")
        return found


def rises(before: dict[str, int], after: dict[str, int]) -> set[str]:
    """Names of the counters that rose."""
    return {name for name, value in after.items() if value > before.get(name, 0)}


def rise_of(fleet: Fleet, before: dict[str, int], *expected: str) -> set[str]:
    """The same, once these have risen: a proxy may count a refusal a moment after it was felt."""
    wait_until(lambda: rises(before, fleet.counters()) >= set(expected), CALL_S, f"{expected} counted")
    return rises(before, fleet.counters())


@contextlib.contextmanager
def fleet_of(folder: Path) -> Iterator[Fleet]:
    with contextlib.ExitStack() as cleanup:
        cleanup.enter_context(contextlib.chdir(ROOT))
        authority = Authority.make(folder / "certs", FLEET, 10)
        for role in ("service", "envoy"):
            authority.issue(Identity(FLEET, role), 5, [HOST])  # pyright: ignore[reportArgumentType]
        settings = {"tls": service_tls(authority.folder)}
        replica = Replica("service", folder, f"sqlite:///{folder / 'map.db'}", settings, FAKE)
        cleanup.callback(replica.kill)
        replica.start()
        proxies = []
        for name in ("mtls", "token"):
            (folder / name).mkdir()
            proxy = EnvoyProxy(folder / name, tls=authority.folder, tokens=name == "token")
            cleanup.callback(proxy.kill)
            proxy.set_endpoints([replica.address])
            proxy.start()
            proxies.append(proxy)
        for proxy in proxies:
            wait_until(lambda p=proxy: p.healthy() == {replica.address}, 30.0, "the service healthy for the proxy")
        yield Fleet(folder, authority, replica, *proxies)


@dataclass
class Watched:
    """Whose scans somebody has seen; why: it has ended."""

    sessions: set[str] = field(default_factory=set)
    why: str = ""


class Client:
    """Somebody who calls `address`; every method returns "" when it was served, else why not."""

    def __init__(self, address: str, tls: ClientTls, metadata: tuple[tuple[str, str], ...] = ()) -> None:
        self._address, self._tls, self._metadata = address, tls, metadata

    @contextlib.contextmanager
    def _channel(self) -> Iterator[tuple[grpc.Channel, tuple[tuple[str, str], ...]]]:
        tls = self._tls
        if tls.cert is None and tls.token is None:  # what our own client refuses to do
            credentials = grpc.ssl_channel_credentials(tls.ca.read_bytes())  # pyright: ignore
            with grpc.secure_channel(self._address, credentials) as channel:
                yield channel, self._metadata
            return
        connector = Connector(self._address, tls)
        with connector.channel([("grpc.use_local_subchannel_pool", 1)]) as channel:
            yield channel, (*self._metadata, *connector.metadata())

    def drive(self, robot_id: str, run_id: str = "", frames: int = 2, **changes: Any) -> str:
        """A whole run of a robot, Bye included."""
        greeting = hello(run_id or new_run(), robot_id=robot_id, **changes)
        messages = [pb.StreamRequest(hello=greeting)]
        messages += [pb.StreamRequest(frame=frame(seq)) for seq in range(1, frames + 1)]
        messages.append(pb.StreamRequest(bye=pb.Bye(last_seq=frames)))
        with self._channel() as (channel, metadata):
            call = rpc.EdgeServiceStub(channel).Stream(iter(messages), metadata=metadata, timeout=CALL_S)
            try:
                for response in call:
                    if response.HasField("refused"):
                        return response.refused.detail
                    if response.HasField("finished"):
                        return ""
            except grpc.RpcError as error:
                return f"{error.code().name}: {error.details()}"  # pyright: ignore
        return "the stream ended"

    def _ask(self, name: str, request: Any) -> tuple[Any, str]:
        with self._channel() as (channel, metadata):
            method = getattr(rpc.SessionServiceStub(channel), name)
            try:
                answer = method(request, metadata=metadata, timeout=CALL_S)
                return (list(answer) if name in ("Trajectory", "StreamMap") else answer), ""
            except grpc.RpcError as error:
                return None, f"{error.code().name}: {error.details()}"  # pyright: ignore

    def _ask_poses(self, name: str, request: Any) -> tuple[Any, str]:
        """The first message of an answer, and why there is none."""
        with self._channel() as (channel, metadata):
            call = getattr(pose_rpc.PoseServiceStub(channel), name)
            try:
                answer = call(request, metadata=metadata, timeout=CALL_S)
                return (answer if name == "PoseAt" else next(answer)), ""
            except grpc.RpcError as error:
                return None, f"{error.code().name}: {error.details()}"  # pyright: ignore

    def watch_poses(self, **selection: Any) -> tuple[set[str], str]:
        """(sessions that are told of, why not)."""
        request = pose_pb.WatchPosesRequest(sessions=pose_pb.SessionSelection(**selection))
        answer, why = self._ask_poses("WatchPoses", request)
        return (set() if answer is None else set(json.loads(answer.cursor)[1])), why

    def events(self, **selection: Any) -> tuple[set[str], str]:
        """(sessions that are told of, why not)."""
        request = pose_pb.EventsRequest(sessions=pose_pb.SessionSelection(**selection), cursor="[0,{}]")
        answer, why = self._ask_poses("Events", request)
        return (set() if answer is None else {event.session_id for event in answer.events}), why

    def pose_at(self, session_id: str) -> str:
        stamp_ns = frame(1).stamp_ns
        return self._ask_poses("PoseAt", pose_pb.PoseAtRequest(session_id=session_id, stamp_ns=stamp_ns))[1]

    def local_map(self, session_id: str) -> str:
        return self._ask_poses("LocalMap", pose_pb.LocalMapRequest(session_id=session_id, radius_m=5.0))[1]

    def sessions(self, site_id: str = "") -> tuple[set[str], str]:
        """(session ids, why not)."""
        answer, why = self._ask("List", pb.ListRequest(site_id=site_id))
        return (set() if answer is None else {s.session_id for s in answer.sessions}), why

    def upload(self, robot_id: str, run_id: str = "", **changes: Any) -> str:
        """Offers a whole scan of frame 1; why not."""
        opening = dense_pb2.UploadOpen(robot_id=robot_id, run_id=run_id or new_run(), **changes)
        offer = dense_pb2.CloudOffer(seq=1, stamp_ns=1, size=1)
        requests = [dense_pb2.UploadRequest(open=opening), dense_pb2.UploadRequest(offer=offer)]
        with self._channel() as (channel, metadata):
            call = dense_pb2_grpc.DenseServiceStub(channel).Upload(iter(requests), metadata=metadata, timeout=CALL_S)
            try:
                return "" if len(list(call)) == 2 else "not answered"
            except grpc.RpcError as error:
                return f"{error.code().name}: {error.details()}"  # pyright: ignore

    def get(self, session_id: str) -> str:
        return self._ask("Get", pb.GetRequest(session_id=session_id))[1]

    def trajectory(self, session_id: str) -> str:
        return self._ask("Trajectory", pb.TrajectoryRequest(session_id=session_id))[1]

    def stream_map(self, session_id: str) -> str:
        return self._ask("StreamMap", pb.StreamMapRequest(session_id=session_id))[1]

    @contextlib.contextmanager
    def watching(self, robot_id: str = "", site_id: str = "") -> Iterator[Watched]:
        """Watches while the block runs."""
        request = view_pb2.WatchScansRequest(robot_id=robot_id, site_id=site_id)
        watched, begun = Watched(), threading.Event()
        with self._channel() as (channel, metadata):
            call = view_pb2_grpc.ViewServiceStub(channel).WatchScans(request, metadata=metadata)

            def read() -> None:
                try:
                    for response in call:
                        begun.set()
                        watched.sessions.update({response.session_id} - {""})
                except grpc.RpcError as error:
                    watched.why = f"{error.code().name}: {error.details()}"  # pyright: ignore
                begun.set()

            reader = threading.Thread(target=read, daemon=True)
            reader.start()
            assert begun.wait(CALL_S)
            yield watched
            call.cancel()
            reader.join(CALL_S)

    def delete(self, session_id: str) -> str:
        return self._ask("Delete", pb.DeleteRequest(session_id=session_id))[1]
