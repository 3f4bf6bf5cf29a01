"""A service process on a free port and a robot that speaks the protocol to it."""

from __future__ import annotations

import json
import queue
import signal
import subprocess
import sys
import threading
import time
import urllib.request
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import grpc
import yaml

from splitslam.robot import Robot, robot_to_yaml
from splitslam.stack.process import free_port, wait_until
from splitslam.wire import session_pb2 as pb
from splitslam.wire import session_pb2_grpc as rpc
from tests.conftest import ROOT
from tests.map_service.fakes import payload

WAIT_S = 30.0
STAMP_0_NS = 1_700_000_000_000_000_000


def running(pid: int) -> bool:
    """Alive, and no zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def descendants(pid: int) -> list[int]:
    try:
        tasks = list(Path(f"/proc/{pid}/task").iterdir())
        children = [int(c) for task in tasks for c in (task / "children").read_text().split()]
    except (FileNotFoundError, ProcessLookupError):
        return []
    return children + [d for child in children for d in descendants(child)]


class Service:
    """The service with the fake pipeline; the port stays the same over restarts."""

    def __init__(self, folder: Path, **settings: Any) -> None:
        self.folder = folder
        self.store_url = settings.pop("store", f"sqlite:///{folder}/map.db")
        self.port = free_port()
        self.settings = {
            "listen": f"127.0.0.1:{self.port}",
            "store": self.store_url,
            "workers": 1,
            "metrics": {"port": 0},
            "log": {"format": "json", "level": "debug"},
            **settings,
        }
        self.process: subprocess.Popen[str] | None = None

    @property
    def address(self) -> str:
        return f"127.0.0.1:{self.port}"

    @property
    def pid(self) -> int:
        assert self.process is not None
        return self.process.pid

    @property
    def log(self) -> str:
        return (self.folder / f"service-{self.port}.log").read_text()

    def start(self) -> dict[str, Any]:
        config = self.folder / f"service-{self.port}.yaml"
        config.write_text(yaml.safe_dump(self.settings))
        command = [sys.executable, "-m", "tests.map_service.fake_service", str(config)]
        self.close()
        with (self.folder / f"service-{self.port}.log").open("a") as log:
            self.process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=log, text=True)
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        assert line, self.log
        self.started = json.loads(line)
        return self.started

    def workers(self) -> list[int]:
        return [int(json.loads(line)["pid"]) for line in self.log.splitlines() if '"event": "worker ready"' in line]

    def kill(self) -> None:
        """SIGKILL."""
        assert self.process is not None
        self.process.kill()
        self.process.wait(WAIT_S)

    def terminate(self) -> int:
        assert self.process is not None
        self.process.send_signal(signal.SIGTERM)
        return self.process.wait(WAIT_S)

    def close(self) -> None:
        if self.process is not None:
            if self.process.poll() is None:
                self.kill()
            assert self.process.stdout is not None
            self.process.stdout.close()

    def metrics(self) -> dict[str, float]:
        with urllib.request.urlopen(f"http://{self.started['metrics']}/metrics", timeout=WAIT_S) as page:
            lines = page.read().decode().splitlines()
        return {name: float(value) for name, value in (l.rsplit(" ", 1) for l in lines if not l.startswith("#"))}

    def wait_metrics(self, done: Callable[[dict[str, float]], bool], what: str) -> dict[str, float]:
        """The first page of which `done` is true: workers tell what they count twice a second."""
        until_s = time.monotonic() + WAIT_S
        while not done(page := self.metrics()):
            assert time.monotonic() < until_s, what
            time.sleep(0.05)
        return page


def hello(run_id: str, /, **changes: Any) -> pb.Hello:
    robot = Robot()
    values: dict[str, Any] = {
        "robot_id": "rover-7",
        "run_id": run_id,
        "robot_file_yaml": robot_to_yaml(robot),
        "beam_elevations_rad": [0.01 * i for i in range(robot.lidar.rings)],
        "wire_version": 1,
        "codec_version": 1,
        "deskew": "cpu",
        "lockstep": True,
    }
    return pb.Hello(**(values | changes))


class Held:
    """A frame that keeps its worker busy until the test has seen what it wants, however slow the machine is."""

    def __init__(self, folder: Path) -> None:
        self._begun, self._over = folder / "begun", folder / "over"
        self.content = payload("wait", begun=str(self._begun), over=str(self._over))

    def wait_begun(self) -> None:
        wait_until(self._begun.exists, WAIT_S, "the frame at work")

    def end(self) -> None:
        self._over.touch()


def frame(seq: int, content: bytes | None = None, **changes: Any) -> pb.Frame:
    stamp_ns = STAMP_0_NS + seq * 100_000_000
    values = {"seq": seq, "stamp_ns": stamp_ns, "codec_version": 1, "trace_id": f"{seq:016x}"}
    return pb.Frame(payload=content or payload(), **(values | changes))


class Robot7:
    """One stream. Every response goes into `inbox` in order; the status of its end into `status`."""

    def __init__(self, address: str, first: pb.Hello | pb.StreamRequest) -> None:
        self.channel = grpc.insecure_channel(address, options=[("grpc.use_local_subchannel_pool", 1)])
        grpc.channel_ready_future(self.channel).result(WAIT_S)
        self.requests: queue.Queue[pb.StreamRequest | None] = queue.Queue()
        self.inbox: queue.Queue[pb.StreamResponse | None] = queue.Queue()
        self.status: grpc.StatusCode | None = None
        self.detail = ""
        self.requests.put(pb.StreamRequest(hello=first) if isinstance(first, pb.Hello) else first)
        self.call = rpc.EdgeServiceStub(self.channel).Stream(self._requests())
        self.reader = threading.Thread(target=self._read, daemon=True)
        self.reader.start()

    def _requests(self) -> Iterator[pb.StreamRequest]:
        while (request := self.requests.get()) is not None:
            yield request

    def _read(self) -> None:
        try:
            for response in self.call:
                self.inbox.put(response)
            self.status = grpc.StatusCode.OK
        except grpc.RpcError as error:
            call: Any = error
            self.status, self.detail = call.code(), call.details() or ""
        self.inbox.put(None)

    def send(self, message: pb.Frame | pb.Bye | pb.EdgeReport) -> None:
        kind = {pb.Frame: "frame", pb.Bye: "bye", pb.EdgeReport: "report"}[type(message)]
        self.requests.put(pb.StreamRequest(**{kind: message}))  # pyright: ignore[reportArgumentType]

    def next(self, kind: str, timeout_s: float = WAIT_S) -> Any:
        """The next response of this kind; those of other kinds before it are dropped."""
        while True:
            response = self.inbox.get(timeout=timeout_s)
            assert response is not None, f"the stream ended with {self.status}: {self.detail}"
            if response.WhichOneof("message") == kind:
                return getattr(response, kind)

    def ask(self, message: pb.Frame) -> pb.Odometry:
        self.send(message)
        return self.next("odometry")

    def wait_durable(self, seq: int) -> None:
        while self.next("credit").durable_seq < seq:
            pass

    def end(self) -> grpc.StatusCode:
        """Waits until the service ends the stream."""
        self.reader.join(WAIT_S)
        assert self.status is not None
        return self.status

    def close(self) -> None:
        self.requests.put(None)
        self.call.cancel()
        self.reader.join(WAIT_S)
        self.channel.close()


class Operator:
    """SessionService."""

    def __init__(self, address: str) -> None:
        self.channel = grpc.insecure_channel(address)
        self.stub = rpc.SessionServiceStub(self.channel)

    def poses(self, session_id: str) -> list[tuple[int, float]]:
        """(seq, x in m) of the stored trajectory."""
        pages = self.stub.Trajectory(pb.TrajectoryRequest(session_id=session_id))
        return [(pose.seq, pose.pose.tx_m) for page in pages for pose in page.poses]

    def get(self, session_id: str) -> pb.SessionInfo:
        return self.stub.Get(pb.GetRequest(session_id=session_id)).session

    def close(self) -> None:
        self.channel.close()


def new_run() -> str:
    return str(uuid.uuid4())
