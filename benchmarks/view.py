"""How the viewer keeps up with several robots: `python -m benchmarks.view BAG ROBOT.yaml [--robots 2]`.

A drive is run once, and what its service has shown of it is kept. Then a stand-in for the service plays that by the
clock for several robots at once, side by side, to `splitslam view --web` and its page in headless Chromium without a
GPU. So the figures are the viewer's alone. Counted are frames in which the page has drawn by WebGL while the drive goes
on. CPU time a frame, by thread, is what can be compared on a busy machine: a page is as fast as its slowest thread, and
as the cores that all its threads share.
"""

from __future__ import annotations

import argparse
import json
import shlex
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import grpc
import numpy as np
import yaml

from benchmarks.chromium import chromium
from benchmarks.processes import threads_s, tree
from splitslam.run.service import embedded_service
from splitslam.wire import session_pb2_grpc, view_pb2, view_pb2_grpc

BIN = Path(sys.executable).parent
APART_M = 45.0
_PERIOD_S = 0.1


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("bag", type=Path)
    parser.add_argument("robot", type=Path)
    parser.add_argument("--robots", type=int, default=2)
    parser.add_argument("--max-scans", type=int, default=500)
    parser.add_argument("--after", type=float, default=25.0, help="seconds of driving before frames are counted")
    parser.add_argument("--seconds", type=float, default=15.0, help="how long they are counted")
    parser.add_argument("--size", default="1280x720", help="of the page, pixels")
    parser.add_argument("--gl", default="swiftshader", help="swiftshader, or gl-egl: Mesa's, where it is installed")
    parser.add_argument("--view", default="", metavar="'OPTIONS'", help="of splitslam view, as --view='--voxel 0.2'")
    parser.add_argument("--chromium", type=Path, default=Path(shutil.which("chromium") or "chromium"))
    parser.add_argument("--picture", type=Path)
    print(json.dumps(measure(parser.parse_args(arguments)), indent=1))


def measure(asked: argparse.Namespace) -> dict[str, Any]:
    width, _, height = asked.size.partition("x")
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="view-")))
        shown = captured(asked.bag, asked.robot, asked.max_scans, folder)
        replay = Replay(shown, asked.robots)
        address = stack.enter_context(served(replay))
        command = (str(BIN / "splitslam"), "view", address, "--web", *shlex.split(asked.view))
        view = stack.enter_context(subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True))
        stack.callback(view.terminate)
        assert view.stdout is not None
        assert view.stderr is not None
        url = view.stdout.readline().strip()
        page = stack.enter_context(chromium(asked.chromium, (int(width), int(height)), gl=asked.gl))
        page.darken()
        page.open(url)
        time.sleep(asked.after)
        before, sent = _cpu(view.pid, page.pid), replay.scans
        begun_s = time.monotonic()
        frames = page.frames(asked.seconds)
        lasted_s = time.monotonic() - begun_s
        cpu = {who: value - before.get(who, 0.0) for who, value in _cpu(view.pid, page.pid).items()}
        sent = replay.scans - sent
        if asked.picture is not None:
            page.save(asked.picture)
        view.terminate()
        said = view.stderr.read().strip().splitlines()
    if replay.over:
        sys.exit(f"the drive was over before the frames were counted: expected more scans than {asked.max_scans}")
    drawn, drawing = len(frames.drawn_s), {name: s for (where, name), s in cpu.items() if where == "page" and s}
    slowest = max(drawing, key=drawing.__getitem__)
    return {
        "robots": asked.robots,
        "page": f"{asked.size}, {asked.gl}",
        "view": asked.view,
        "drawn_per_s": round(drawn / lasted_s, 2),
        "drawn_with_news_per_s": round(len(frames.fresh_s) / lasted_s, 2),
        "longest_gap_ms": round(float(np.diff(frames.drawn_s).max(initial=0.0)) * 1e3),
        "sent_scans_per_s": round(sent / lasted_s, 1),
        "received_kbytes_per_s": round(frames.received_bytes / lasted_s / 1e3, 1),
        "cpu_ms_per_frame": {name: round(s / drawn * 1e3, 1) for name, s in _largest(drawing)},
        "cpu_ms_per_frame_all": round(sum(drawing.values()) / drawn * 1e3, 1),
        "frames_per_s_on_idle_cores": {
            "one a thread": round(drawn / drawing[slowest], 1),
            "two": round(2.0 * drawn / sum(drawing.values()), 1),
        },
        "cpu_share": {
            where: round(sum(s for (of, _), s in cpu.items() if of == where) / lasted_s, 3)
            for where in ("view", "rerun")
        },
        "load": Path("/proc/loadavg").read_text().split()[0],
        "viewer": said[-1:],
    }


def _largest(cpu_s: Mapping[str, float], count: int = 6) -> list[tuple[str, float]]:
    return sorted(cpu_s.items(), key=lambda one: -one[1])[:count]


def _cpu(view: int, page: int) -> dict[tuple[str, str], float]:
    """CPU seconds so far by thread, those of one name together: of our program, Rerun's server, and Chromium.

    Chromium's threads run beside each other: the renderer's main one is the page, those of the GPU process draw.
    """
    found: defaultdict[tuple[str, str], float] = defaultdict(float)
    for pid, command in tree(view):
        where = "rerun" if "--bind" in command else "view"
        for (_, name), s in threads_s([pid]).items():
            found[where, name] += s
    for pid, command in tree(page):
        process = command.partition("--type=")[2].partition(" ")[0] or "browser"
        for (thread, name), s in threads_s([pid]).items():
            found["page", f"{process} {'main' if thread == pid else name}"] += s
    return found


def captured(bag: Path, robot: Path, max_scans: int, folder: Path) -> list[view_pb2.WatchScansResponse]:
    """Everything that a service shows of a run of the recording."""
    path, shown = folder / "map.yaml", []
    settings = {"listen": "127.0.0.1:0", "store": f"sqlite:///{folder / 'map.db'}", "workers": 1}
    path.write_text(yaml.safe_dump({**settings, "metrics": {"port": None}}))
    with (
        embedded_service((sys.executable, "-m", "map_service"), path) as service,
        grpc.insecure_channel(service.address) as channel,
    ):
        call = view_pb2_grpc.ViewServiceStub(channel).WatchScans(view_pb2.WatchScansRequest())
        next(call)

        def keep() -> None:
            try:
                shown.extend(response for response in call if response.session_id)
            except grpc.RpcError:  # cancelled
                return

        reader = threading.Thread(target=keep)
        reader.start()
        run = ("run", str(bag), "--robot", str(robot), "--out", str(folder / "out"), "--server", service.address)
        subprocess.run([str(BIN / "splitslam"), *run, "--max-scans", str(max_scans)], check=True, capture_output=True)
        time.sleep(1.0)
        call.cancel()
        reader.join()
    return shown


class Replay(view_pb2_grpc.ViewServiceServicer):
    """Plays it by the clock from the first call on, robots side by side; who joins later sees what comes then.

    scans: how many have been sent. over: the drive has ended.
    """

    def __init__(self, shown: Sequence[view_pb2.WatchScansResponse], robots: int) -> None:
        self._shown = [[_moved(response, k) for k in range(robots)] for response in shown]
        self.scans = 0
        self.over = False

    def WatchScans(
        self, request: view_pb2.WatchScansRequest, context: grpc.ServicerContext
    ) -> Iterator[view_pb2.WatchScansResponse]:
        yield view_pb2.WatchScansResponse(replica="here")
        due_s = time.monotonic()
        for responses in self._shown:
            yield from responses
            if responses[0].HasField("scan"):
                self.scans += len(responses)
                due_s += _PERIOD_S
            time.sleep(max(due_s - time.monotonic(), 0.0))
        self.over = True
        while context.is_active():
            yield view_pb2.WatchScansResponse(replica="here")
            time.sleep(1.0)


def _moved(response: view_pb2.WatchScansResponse, number: int) -> view_pb2.WatchScansResponse:
    """The same of another robot, some way off."""
    moved = view_pb2.WatchScansResponse()
    moved.CopyFrom(response)
    robot_id, _, run_id = response.session_id.partition("/")
    moved.session_id = f"{robot_id}-{number + 1}/{run_id}"
    if moved.HasField("scan"):
        moved.scan.answer.pose_map_lidar.ty_m += number * APART_M
    poses = np.frombuffer(response.map.poses_map_lidar, "<f4").reshape(-1, 3, 4).copy()
    fixes = np.frombuffer(response.map.fixes_map, "<f4").reshape(-1, 3).copy()
    poses[:, 1, 3] += number * APART_M
    fixes[:, 1] += number * APART_M
    moved.map.poses_map_lidar, moved.map.fixes_map = poses.tobytes(), fixes.tobytes()
    return moved


@contextmanager
def served(replay: Replay) -> Iterator[str]:
    """Its address."""

    class Nothing(session_pb2_grpc.SessionServiceServicer):
        def Trajectory(self, request: Any, context: Any) -> Iterator[Any]:
            return iter(())

        def StreamMap(self, request: Any, context: Any) -> Iterator[Any]:
            return iter(())

    server = grpc.server(ThreadPoolExecutor(4))
    view_pb2_grpc.add_ViewServiceServicer_to_server(replay, server)
    session_pb2_grpc.add_SessionServiceServicer_to_server(Nothing(), server)
    port = server.add_insecure_port("127.0.0.1:0")
    server.start()
    try:
        yield f"127.0.0.1:{port}"
    finally:
        server.stop(None)


if __name__ == "__main__":
    main()
