"""Legal and illegal sequences of messages of one robot against the service's sessions, with a model that knows better.

The service is the real one but for the sockets: SessionHost, its store (SQLite on disk), its committing thread, which
is held so that commits land when the sequence says so (what a kill loses must not depend on the clock). The pipeline
counts: the k-th frame that it maps lies at x = k m (tests/map_service/fakes.py), so a frame that was mapped
twice, or never, shows in every pose after it.
"""

from __future__ import annotations

import itertools
import threading
import uuid
from typing import Any

from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, precondition, rule

from map_service import integrity
from map_service.channel import Abort, Close, Forget, Handed, HandOver, Open, Reply, Request
from map_service.config import CommitConfig, ServiceConfig
from map_service.host import SessionHost
from map_service.settings import PipelineSettings
from map_service.store import Store
from splitslam.wire import session_pb2 as pb
from tests.fuzz.target import scratch
from tests.map_service.fakes import FakeEngine, payload
from tests.map_service.harness import frame, hello

WORST_S = 5.0


class StreamMachine(RuleBasedStateMachine):
    """The model: `applied` seq; what became of each (x in m, or why it was rejected); runs that are over.

    Without a stream the only thing to do is to open one, so that most steps are spent on one.
    """

    def __init__(self) -> None:
        super().__init__()
        self.folder, self.remove = scratch()
        self.url = f"sqlite:///{self.folder / 'map.db'}"
        self.streams = itertools.count(1)
        self.sent: list[Any] = []
        self.runs = (str(uuid.UUID(int=n)) for n in itertools.count(7))
        self.over: list[str] = []
        self.stream = 0  # 0: none open
        self.next_run()
        self.start()

    def next_run(self) -> None:
        self.run_id = next(self.runs)
        self.applied, self.mapped = 0, 0
        self.became: dict[int, float | str] = {}
        self.stamps: dict[int, int] = {}

    def start(self) -> None:
        self.store = Store(self.url)
        engine: Any = FakeEngine(PipelineSettings(), 1)
        config = ServiceConfig(store=self.url, commit=CommitConfig(every_s=1e6))
        self.host = SessionHost(config, engine, self.store, self.sent.append)
        self.hold()

    def hold(self) -> None:
        self.gate = threading.Event()
        self.host._committer.run(self.gate.wait)  # pyright: ignore[reportArgumentType]

    def land(self) -> None:
        """Everything handed over is written, and the session hears of it and hands over what has come meanwhile."""
        self.gate.set()
        while True:
            self.host._committer.run(lambda: None).result(WORST_S)
            self.care()
            if not self.host.sessions.committing:
                break
        self.hold()

    def care(self) -> None:
        """As a worker does that nobody asks for anything."""
        while self.host.care():
            pass
        self.host.look_after()

    @property
    def poisoned(self) -> int | None:
        """The frame on which the pipeline has failed before."""
        return self.host._frames._failed.get(f"rover-7/{self.run_id}")

    def stop(self) -> None:
        """As a kill does: what the committing thread has not begun is lost."""
        self.host._committer._thread.shutdown(wait=False, cancel_futures=True)
        self.gate.set()
        self.host._committer._thread.shutdown()
        self.store.close()

    def teardown(self) -> None:
        """However it went, the store is sound."""
        self.stop()
        left = Store(self.url)
        try:
            found = list(integrity.findings(left, integrity.Seen()))
            assert [line for line in found if "factor" not in line] == []  # the pipeline's are no real ones
        finally:
            left.close()
            self.remove()

    # --- what the service is told, and what it says ------------------------------------------------------------

    def tell(self, message: Any) -> list[Any]:
        """What it answers, commits included."""
        self.sent.clear()
        self.host.handle(message)
        self.care()
        return list(self.sent)

    def ask(self, **request: Any) -> list[Any]:
        return self.tell(Request(self.stream, pb.StreamRequest(**request).SerializeToString(), 0))

    def answer(self, said: list[Any]) -> pb.Odometry:
        (reply,) = said
        assert isinstance(reply, Reply), said
        assert reply.answer
        return pb.StreamResponse.FromString(reply.body).odometry

    def ends(self, said: list[Any], status: str) -> None:
        """The stream is ended, and what it had applied stays."""
        (abort,) = said
        assert isinstance(abort, Abort), said
        assert (abort.stream, abort.status) == (self.stream, status)
        self.stream = 0

    # --- opening -----------------------------------------------------------------------------------------------

    @rule()
    def open(self) -> None:
        """The newest stream wins; the one before is told."""
        self.land()  # who takes over waits for it
        before, self.stream = self.stream, next(self.streams)
        greeting = hello(self.run_id).SerializeToString()
        said = self.tell(Open(self.stream, f"rover-7/{self.run_id}", greeting))
        if before:
            assert said[0] == Abort(before, "ABORTED", "another stream has opened the session")
        welcome = pb.StreamResponse.FromString(said[-1].body).welcome
        assert welcome.applied_seq == self.applied
        assert welcome.durable_seq <= self.applied

    @precondition(lambda self: self.stream and self.over)
    @rule(data=st.data())
    def open_what_is_over(self, data: st.DataObject) -> None:
        run_id = data.draw(st.sampled_from(self.over))
        (reply,) = self.tell(Open(next(self.streams), f"rover-7/{run_id}", hello(run_id).SerializeToString()))
        assert pb.StreamResponse.FromString(reply.body).refused.reason == pb.REFUSED_REASON_FINISHED

    @precondition(lambda self: self.stream)
    @rule(change=st.sampled_from([("robot_id", "../x"), ("run_id", "1"), ("deskew", "no"), ("wire_version", 9)]))
    def open_badly(self, change: tuple[str, Any]) -> None:
        """Another stream's bad Hello costs the open one nothing."""
        number = next(self.streams)
        greeting = hello(self.run_id, **dict([change])).SerializeToString()
        (reply,) = self.tell(Open(number, "x/y", greeting))
        assert reply.last
        assert pb.StreamResponse.FromString(reply.body).HasField("refused")

    # --- frames ------------------------------------------------------------------------------------------------

    @precondition(lambda self: self.stream)
    @rule()
    def next_frame(self) -> None:
        self.take(self.applied + 1, payload(), mapped=True)

    @precondition(lambda self: self.stream)
    @rule(count=st.integers(2, 12))
    def next_frames(self, count: int) -> None:
        """A commit is due at each keyframe: every fifth."""
        for _ in range(count):
            self.next_frame()

    @precondition(lambda self: self.stream)
    @rule(ahead=st.integers(2, 50))
    def frame_after_a_declared_hole(self, ahead: int) -> None:
        if self.applied:
            self.take(self.applied + ahead, payload(), mapped=True, follows_seq=self.applied)

    @precondition(lambda self: self.stream)
    @rule(content=st.sampled_from(["corrupt", "codec", "time"]))
    def unusable_frame(self, content: str) -> None:
        again = {"stamp_ns": max(self.stamps.values(), default=0)}
        changes: dict[str, Any] = {"codec": {"codec_version": 99}, "time": again}.get(content, {})
        self.take(self.applied + 1, payload("corrupt"), mapped=False, **changes)

    def take(self, seq: int, content: bytes, *, mapped: bool, **changes: Any) -> None:
        mapped &= seq != self.poisoned  # the pipeline has failed on that one before
        message = frame(seq, content, **changes)
        answer = self.answer(self.ask(frame=message))
        self.stamps[seq] = message.stamp_ns
        assert not answer.duplicate
        assert bool(answer.rejected) != mapped
        self.mapped += mapped
        self.applied = seq
        self.became[seq] = float(self.mapped) if mapped else answer.rejected
        self.check(answer, seq)

    def check(self, answer: pb.Odometry, seq: int) -> None:
        became = self.became[seq]
        assert answer.seq == seq
        if isinstance(became, str):
            assert answer.rejected == became
        else:
            assert answer.pose_map_lidar.tx_m == became
        assert answer.durable_seq <= answer.applied_seq == self.applied

    @precondition(lambda self: self.stream and self.became)
    @rule(data=st.data())
    def frame_again(self, data: st.DataObject) -> None:
        """However often, and after any restart: its first answer."""
        seq = data.draw(st.sampled_from(sorted(self.became)))
        answer = self.answer(self.ask(frame=frame(seq, payload(), follows_seq=seq // 2)))
        assert answer.duplicate
        self.check(answer, seq)

    @precondition(lambda self: self.stream)
    @rule(ahead=st.integers(2, 1 << 40))
    def frame_after_a_gap(self, ahead: int) -> None:
        follows = self.applied + 1 if ahead % 2 else 0  # or a hole after a frame that is not there
        self.ends(self.ask(frame=frame(self.applied + ahead, stamp_ns=1, follows_seq=follows)), "ABORTED")

    @precondition(lambda self: self.stream)
    @rule()
    def frame_zero(self) -> None:
        self.ends(self.ask(frame=frame(0)), "ABORTED")

    @precondition(lambda self: self.stream)
    @rule()
    def frame_that_breaks_the_pipeline(self) -> None:
        """The session goes on from the store; the same frame again is rejected."""
        if self.applied + 1 == self.poisoned:
            self.take(self.applied + 1, payload("raise"), mapped=False)
            return
        self.ends(self.ask(frame=frame(self.applied + 1, payload("raise"))), "INTERNAL")
        self.fall_back()
        self.open()
        if self.applied + 1 != self.poisoned:
            return  # commits were lost with the pipeline: another frame is next
        self.take(self.applied + 1, payload("raise"), mapped=False)

    # --- everything else ---------------------------------------------------------------------------------------

    @precondition(lambda self: self.stream)
    @rule(body=st.binary(max_size=40).filter(lambda b: not _is_request(b)))
    def not_a_message(self, body: bytes) -> None:
        self.ends(self.tell(Request(self.stream, body, 0)), "INVALID_ARGUMENT")

    @precondition(lambda self: self.stream)
    @rule()
    def hello_again(self) -> None:
        self.ends(self.ask(hello=hello(self.run_id)), "INVALID_ARGUMENT")

    @precondition(lambda self: self.stream)
    @rule(counts=st.dictionaries(st.text(max_size=5), st.integers(0, 2**64 - 1), max_size=3))
    def report(self, counts: dict[str, int]) -> None:
        assert self.ask(report=pb.EdgeReport(dropped_by_reason=counts)) == []

    @precondition(lambda self: self.stream)
    @rule(stream=st.integers(1000, 1010), kind=st.sampled_from(["request", "close", "hand over", "forget"]))
    def about_a_stream_that_is_not_there(self, stream: int, kind: str) -> None:
        body = pb.StreamRequest(frame=frame(1)).SerializeToString()
        messages = {"request": Request(stream, body, 0), "close": Close(stream), "hand over": HandOver(stream)}
        assert self.tell(messages.get(kind, Forget("nobody/nothing"))) == []

    @precondition(lambda self: self.stream)
    @rule()
    def close(self) -> None:
        assert self.tell(Close(self.stream)) == []
        self.stream = 0

    @precondition(lambda self: self.stream)
    @rule()
    def hand_over(self) -> None:
        said = self.tell(HandOver(self.stream)) or self.landed()
        assert said == [Handed(self.stream, self.applied)]
        self.stream = 0

    @precondition(lambda self: self.stream)
    @rule(off=st.integers(-3, 3))
    def bye(self, off: int) -> None:
        last = max(0, self.applied + off)
        said = self.ask(bye=pb.Bye(last_seq=last))
        if last != self.applied:
            self.ends(said, "ABORTED")
            return
        said = said or self.landed()
        finished = pb.StreamResponse.FromString(said[-1].body).finished
        assert finished.mapped == self.mapped
        self.over.append(self.run_id)
        self.stream = 0
        self.next_run()

    @precondition(lambda self: self.stream)
    @rule()
    def commits_land(self) -> None:
        self.sent.clear()
        self.land()
        assert self.sent == []

    @precondition(lambda self: self.stream)
    @rule()
    def killed_and_started_again(self) -> None:
        """What was not committed is forgotten, all of it and nothing else."""
        self.stop()
        self.sent.clear()
        self.stream = 0
        self.start()
        self.fall_back()

    def fall_back(self) -> None:
        """To what the store has, once it has what is under way: the model asks the store itself."""
        self.land()
        with self.store.reading() as connection:
            row = connection.exec_driver_sql("select last_seq from sessions where run_id = ?", (self.run_id,)).first()
        self.applied = 0 if row is None else int(row[0])
        self.became = {seq: value for seq, value in self.became.items() if seq <= self.applied}
        self.stamps = {seq: stamp_ns for seq, stamp_ns in self.stamps.items() if seq <= self.applied}
        self.mapped = int(max((v for v in self.became.values() if isinstance(v, float)), default=0))

    def landed(self) -> list[Any]:
        """What it says once everything is written."""
        self.sent.clear()
        self.land()
        return list(self.sent)


def _is_request(body: bytes) -> bool:
    try:
        return pb.StreamRequest.FromString(body).WhichOneof("message") in ("frame", "bye", "report")
    except Exception:
        return False
