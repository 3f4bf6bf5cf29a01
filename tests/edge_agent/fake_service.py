"""A map service in a few lines: the session protocol on a free port, with faults that tests ask for."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Iterator
from concurrent import futures
from dataclasses import dataclass, field
from enum import Enum, auto

import grpc

from splitslam.stack.process import free_port
from splitslam.wire import session_pb2 as pb
from splitslam.wire import session_pb2_grpc as rpc
from splitslam.wire import types_pb2 as types

_END = None


class Fault(Enum):
    """What goes wrong, once, when the frame it is set for arrives."""

    KILL = auto()  # the stream breaks before the frame is applied
    KILL_AFTER = auto()  # ... after it is applied, before the answer
    DRAIN = auto()
    SILENT = auto()  # nothing is sent any more, the stream stays open
    STUCK = auto()  # credits go on, answers do not
    FORGET = auto()  # as if the process had died: all that was not durable is gone
    DUPLICATE = auto()  # the answer comes twice
    WRONG_SEQ = auto()  # an answer to a frame that was never sent comes first
    NAN = auto()  # the answer's pose is not finite


@dataclass
class FakeService(rpc.EdgeServiceServicer):
    """State of one session, shared by its streams; `faults` maps seq to what happens there."""

    faults: dict[int, Fault] = field(default_factory=dict)
    hello_replies: list[pb.StreamResponse | None] = field(default_factory=list)  # instead of Welcome; None: silence
    commit_every: int = 5
    window: int = 4
    credit_s: float = 0.2
    answer_delay_s: float = 0.0
    advice: pb.Advice | None = None  # after the Welcome
    welcome_after_s: float = 0.0  # with credits meanwhile
    welcome_when: Callable[[], bool] = lambda: True  # not before; with credits meanwhile
    name: str = ""  # what a proxy calls this replica
    drain_to: str = ""
    pose_x_m: Callable[[int], float] = float
    hellos: list[pb.Hello] = field(default_factory=list)
    route_keys: list[str] = field(default_factory=list)
    wishes: list[str] = field(default_factory=list)  # which replica each stream wanted
    received: list[int] = field(default_factory=list)
    applied: dict[int, pb.Odometry] = field(default_factory=dict)
    holes: list[int] = field(default_factory=list)
    max_in_flight: int = 0
    durable_seq: int = 0
    reports: list[pb.EdgeReport] = field(default_factory=list)
    finished: bool = False
    epoch: int = 0

    def __post_init__(self) -> None:
        self._server: grpc.Server | None = None
        self.port = free_port()  # which no outgoing connection takes while the service is stopped

    # --- life -------------------------------------------------------------------------------------------------

    def __enter__(self) -> FakeService:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start(self) -> None:
        """Opens the port, after `stop` again."""
        self._server = grpc.server(futures.ThreadPoolExecutor(8), options=[("grpc.so_reuseport", 0)])
        rpc.add_EdgeServiceServicer_to_server(self, self._server)
        self._server.add_insecure_port(f"127.0.0.1:{self.port}")
        self._server.start()

    def stop(self) -> None:
        if self._server is not None:
            self._server.stop(grace=None).wait()
            self._server = None

    @property
    def address(self) -> str:
        return f"127.0.0.1:{self.port}"

    # --- the protocol -----------------------------------------------------------------------------------------

    def Stream(self, request_iterator: Iterator[pb.StreamRequest], context: grpc.ServicerContext):
        metadata = dict(context.invocation_metadata())
        self.route_keys.append(str(metadata.get("splitslam-route-key")))
        self.wishes.append(str(metadata.get("splitslam-replica", "")))
        if self.name:
            context.send_initial_metadata((("splitslam-replica", self.name),))
        hello = next(request_iterator).hello
        self.hellos.append(hello)
        if self.hello_replies:
            instead = self.hello_replies.pop(0)
            if instead is None:
                self._wait_for_end(context)
                return
            yield instead
            return
        if self.finished:
            yield pb.StreamResponse(refused=pb.Refused(reason=pb.REFUSED_REASON_FINISHED))
            return
        until_s = time.monotonic() + self.welcome_after_s
        while time.monotonic() < until_s or not self.welcome_when():
            if not context.is_active():
                return
            yield pb.StreamResponse(credit=pb.Credit(window=self.window))  # it has not read the session yet
            time.sleep(self.credit_s)
        self.epoch += 1
        out: queue.Queue[pb.StreamResponse | None] = queue.Queue()
        out.put(pb.StreamResponse(welcome=self._welcome()))
        out.put(self._credit())
        if self.advice is not None:
            out.put(pb.StreamResponse(advice=self.advice))
        stream = _Connection(self, out, context)
        threading.Thread(target=stream.read, args=(request_iterator,), daemon=True).start()
        while True:
            try:
                response = out.get(timeout=self.credit_s)
            except queue.Empty:
                if not context.is_active():
                    return
                response = self._credit()
            if response is _END:
                return
            if not stream.silent:
                yield response

    def _welcome(self) -> pb.Welcome:
        applied_seq = max(self.applied, default=0)
        welcome = pb.Welcome(epoch=self.epoch, durable_seq=self.durable_seq, applied_seq=applied_seq, session_id="fake")
        if applied_seq:
            last = self.applied[applied_seq]
            welcome.last_poses.add(seq=applied_seq, stamp_ns=last.stamp_ns, pose=last.pose_map_lidar)
        return welcome

    def _credit(self) -> pb.StreamResponse:
        return pb.StreamResponse(credit=pb.Credit(window=self.window, durable_seq=self.durable_seq))

    @staticmethod
    def _wait_for_end(context: grpc.ServicerContext) -> None:
        over = threading.Event()
        context.add_callback(over.set)
        over.wait(60.0)

    def apply(self, frame: pb.Frame) -> pb.Odometry:
        """The stored answer for a frame seen before, a new one otherwise."""
        if frame.seq in self.applied:
            stored = pb.Odometry()
            stored.CopyFrom(self.applied[frame.seq])
            stored.duplicate = True
            return stored
        if frame.seq != max(self.applied, default=0) + 1:
            self.holes.append(frame.seq)
        pose = types.Transform(tx_m=self.pose_x_m(frame.seq), qw=1.0)
        if frame.seq % self.commit_every == 0:
            self.durable_seq = frame.seq
        answer = pb.Odometry(
            seq=frame.seq,
            stamp_ns=frame.stamp_ns,
            pose_map_lidar=pose,
            pose_map_odom=types.Transform(qw=1.0),
            covariance=[1.0 if i % 7 == 0 else 0.0 for i in range(36)],
            state=types.TRACKING_STATE_TRACKING,
            applied_seq=frame.seq,
            durable_seq=self.durable_seq,
        )
        self.applied[frame.seq] = answer
        return answer

    def forget(self) -> None:
        """What a restart from the store leaves."""
        self.applied = {seq: answer for seq, answer in self.applied.items() if seq <= self.durable_seq}


class _Connection:
    """The reading half of one stream."""

    def __init__(self, service: FakeService, out: queue.Queue, context: grpc.ServicerContext) -> None:
        self.service, self.out, self.context = service, out, context
        self.silent = False
        self.stuck = False

    def read(self, requests: Iterator[pb.StreamRequest]) -> None:
        try:
            for request in requests:
                kind = request.WhichOneof("message")
                if kind == "frame":
                    self._on_frame(request.frame)
                elif kind == "report":
                    self.service.reports.append(request.report)
                elif kind == "bye":
                    self.service.finished = True
                    mapped = len(self.service.applied)
                    self.out.put(pb.StreamResponse(finished=pb.Finished(mapped=mapped)))
        except grpc.RpcError:
            pass
        except Exception as error:
            if "Requests" not in str(error) and self.context.is_active():
                raise
        finally:
            self.out.put(_END)

    def _on_frame(self, frame: pb.Frame) -> None:
        service = self.service
        service.received.append(frame.seq)
        fault = service.faults.pop(frame.seq, None)
        if fault is Fault.FORGET:
            service.forget()
        if fault in (Fault.KILL, Fault.FORGET):
            self.context.cancel()
            return
        if fault is Fault.DRAIN:
            drain = pb.Drain(reason=pb.DRAIN_REASON_REBALANCE, retry_after_ms=50, replica=service.drain_to)
            self.out.put(pb.StreamResponse(drain=drain))
            self.stuck = True
            return
        self.silent |= fault is Fault.SILENT
        self.stuck |= fault is Fault.STUCK
        if self.silent or self.stuck or not self.context.is_active():
            return
        if service.answer_delay_s:
            time.sleep(service.answer_delay_s)
        answer = service.apply(frame)
        if fault is Fault.KILL_AFTER:
            self.context.cancel()
            return
        if fault is Fault.WRONG_SEQ:
            self.out.put(pb.StreamResponse(odometry=pb.Odometry(seq=frame.seq + 1000)))
        if fault is Fault.NAN:
            answer = pb.Odometry.FromString(answer.SerializeToString())
            answer.pose_map_lidar.tx_m = float("nan")
        self.out.put(pb.StreamResponse(odometry=answer))
        if fault is Fault.DUPLICATE:
            self.out.put(pb.StreamResponse(odometry=answer))
