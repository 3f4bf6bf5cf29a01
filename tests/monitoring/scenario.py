"""A fleet that is watched: one stack, two real agents, odd robots; first nothing is done to it, then a lot."""

from __future__ import annotations

import os
import resource
import signal
import sys
import time
import urllib.request
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from splitslam.chaos.agent import PROGRAM, Agent, Drive
from splitslam.chaos.link import Link
from splitslam.stack import Stack, StackError
from splitslam.stack.process import free_port, wait_until
from splitslam.stack.reel import Reel, record
from splitslam.stack.robot import LightRobot
from splitslam.top.command import Top
from splitslam.top.page import Page
from splitslam.top.view import Screen
from tests.map_service.harness import Robot7
from tests.monitoring import harmed_drive, odd_frames
from tests.monitoring.prometheus import Prometheus, binary

CALM, SICK = "rover-1", "rover-2"  # the network, disk and process of the first are harmed later, the other's sensors
_STREAMS = 4  # that a robot may have open
_REPLICAS = {
    "replica": {"beat_s": 0.4, "rest_s": 0.8},
    "quota": {"sites": {"yard": 10**9}},
    "limits": {"client": {"streams": _STREAMS}, "max_delay_s": 60.0},  # a slow machine is not what is tested
}
_SMALL_SPOOL = {"spool": {"max_bytes": 2**16}, "uplink": {"copies_bytes": 0}, "output": {"dir": None}}
_BUDGET = {"uplink": {"max_kbps": 100.0}, "pipeline": {"deskew": "fpga"}}
_ON_A_SICK_BOARD = (sys.executable, "-m", "tests.monitoring.sick_logic")
_GET_READY_S = 8.0
_CALM_S, _AWAY_S, _STORE_S, _DEAD_S = 4.0, 4.0, 1.5, 1.0
_WAIT_S = 60.0  # on a busy machine
_COMMIT_S = 1.2  # in which every session is committed
_SCRAPES_S = 2.5  # after the last fault, so that it is on two pages
_REEL_SCANS, _BLIND_AFTER = 100, 15


@dataclass(frozen=True, slots=True)
class Watched:
    """calm, whole: spans of Unix time, of peace and of the run. screens: of `splitslam top`, in peace and after."""

    prometheus: Prometheus
    calm: tuple[float, float]
    whole: tuple[float, float]
    screens: tuple[Screen, Screen]


@contextmanager
def watched_fleet(folder: Path, rules: Path) -> Iterator[Watched]:
    """Runs all of it; inside the block Prometheus still answers."""
    with ExitStack() as cleanup:
        stack, drives = _prepare(folder, cleanup)
        ports = {CALM: free_port(), SICK: free_port()}
        targets = {
            "edge-agent": {f"127.0.0.1:{port}": {"robot": name} for name, port in ports.items()},
            "map-service": {f"127.0.0.1:{replica.metrics_port}": {} for replica in stack.replicas},
        }
        # It looks for pages before there are any: what has happened by the first look it does not see rise.
        prometheus, began_s = cleanup.enter_context(Prometheus(folder, targets, rules)), time.time()
        wait_until(lambda: _reached(prometheus) == 2, _WAIT_S, "a page of each replica")
        fleet = _Fleet(folder, stack, drives, ports, cleanup)
        reel = record(drives[0].recording, drives[0].robot, max_scans=_REEL_SCANS)  # while the agents get ready
        top = Top([*targets["edge-agent"], *targets["map-service"]])
        fleet.wait_tracking()
        wait_until(lambda: _reached(prometheus) == 4, _WAIT_S, "a page of each of the four")
        calm_s = time.time()
        top.read()
        time.sleep(_CALM_S)
        top.read()
        calm, harmed_s = top.screen(), time.time()
        _harm(fleet, stack, reel)
        top.read()
        yield Watched(prometheus, (calm_s, harmed_s), (began_s, time.time()), (calm, top.screen()))


def _prepare(folder: Path, cleanup: ExitStack) -> tuple[Stack, tuple[Drive, Drive]]:
    """The stack starts while the drive is made. Prometheus is fetched before: the drive does not wait for it later."""
    binary("prometheus")
    pool = cleanup.enter_context(ThreadPoolExecutor(1))
    stack = Stack(folder / "stack", replicas=2, settings=_REPLICAS)
    starting = pool.submit(cleanup.enter_context, stack)
    drive = harmed_drive.make(folder / "drive")
    harmed = harmed_drive.harm(drive, folder / "harmed")
    starting.result()
    return stack, (drive, harmed)


class _Fleet:
    """The two agents, each on its own drive, the first behind a link."""

    def __init__(
        self, folder: Path, stack: Stack, drives: tuple[Drive, Drive], ports: dict[str, int], cleanup: ExitStack
    ) -> None:
        """ports: of each robot's metrics."""
        self.link = cleanup.enter_context(Link(stack.address))
        began_s = time.monotonic() + _GET_READY_S

        def start(name: str, drive: Drive, server: str, settings: dict[str, Any], program: tuple[str, ...]) -> Agent:
            agent = Agent(
                *(name, drive, server, folder / name),
                began_s=began_s,
                metrics_port=ports[name],
                settings=settings,
                program=program,
            )
            cleanup.callback(agent.stop)
            agent.start()
            return agent

        self.calm = start(CALM, drives[0], self.link.address, _SMALL_SPOOL, PROGRAM)
        self.sick = start(SICK, drives[1], stack.address, _BUDGET, _ON_A_SICK_BOARD)

    def wait_tracking(self) -> None:
        wait_until(lambda: _tracks(self.calm) and _tracks(self.sick), _WAIT_S, "both agents tracking")


def _reached(prometheus: Prometheus) -> float:
    """Targets that it has pages of; it begins to look for them seconds after its start."""
    (answer,) = prometheus.ask("query", query="sum(up)")["result"] or [{"value": (0, "0")}]
    return float(answer["value"][1])


def _metrics_of(agent: Agent) -> str:
    return f"127.0.0.1:{agent.metrics_port}"


def _tracks(agent: Agent) -> bool:
    return _page(agent).value("splitslam_edge_state") == 2


def _page(agent: Agent) -> Page:
    """Empty when it does not answer."""
    with suppress(OSError), urllib.request.urlopen(f"http://{_metrics_of(agent)}/metrics", timeout=2.0) as answer:
        return Page.parse(answer.read().decode(), time.monotonic())
    return Page(time.monotonic(), {})


# --- what is done to it -------------------------------------------------------------------------------------------


def _harm(fleet: _Fleet, stack: Stack, reel: Reel) -> None:
    """What takes time goes on beside the rest; the robots that nobody harms come to an end by themselves."""
    _refused(stack, reel)
    _rude(stack, reel)
    _flood(stack, reel)
    blind = LightRobot(stack.address, odd_frames.only_the_floor(reel, _BLIND_AFTER), "blind")
    crowd = [LightRobot(stack.replicas[0].address, reel, f"crowd-{k}") for k in range(3)]  # not by the proxy: uneven
    for robot in (blind, *crowd):
        robot.start()
    fleet.link.partition()
    healed_s = time.monotonic() + _AWAY_S
    _stolen(stack, crowd[0])
    time.sleep(max(0.0, healed_s - time.monotonic()))
    fleet.link.heal()
    with _no_disk(fleet.calm.process.pid):
        _until(fleet.calm, "splitslam_edge_spool_errors_total", "a frame that the disk does not take")
    os.kill(stack.replicas[0].workers()[-1], signal.SIGKILL)
    assert stack.postgres is not None
    stack.postgres.kill()
    time.sleep(_STORE_S)
    stack.postgres.start()
    fleet.calm.process.kill()
    time.sleep(_DEAD_S)
    wait_until(lambda: _page(fleet.calm).has("splitslam_"), _WAIT_S, "the agent again")
    _until(fleet.sick, "splitslam_edge_clock_steps_total", "the step of its IMU's clock")
    _until(fleet.sick, "splitslam_edge_check_problems", "what the robot file is wrong about")
    time.sleep(_SCRAPES_S)
    for robot in (blind, *crowd):
        robot.close()


def _until(agent: Agent, metric: str, what: str) -> None:
    """Waits until it counts something there; an agent that has come to its end has been scraped before."""
    wait_until(lambda: agent.done or _page(agent).value(metric) > 0, _WAIT_S, what)


def _again(stack: Stack, counters: tuple[str, ...], do: Callable[[], None]) -> None:
    """Does it until each of these has counted, as the balance of replicas may end a stream before its time."""
    deadline_s = time.monotonic() + _WAIT_S
    before = _counted(stack)
    while not all(_counted(stack)[name] > before[name] for name in counters):
        if time.monotonic() > deadline_s:
            raise StackError(f"{counters}: not within {_WAIT_S:g} s")
        do()


def _counted(stack: Stack) -> Counter[str]:
    """Every sample of the service, all replicas together."""
    return sum((Counter(replica.metrics()) for replica in stack.replicas), Counter())


def _refused(stack: Stack, reel: Reel) -> None:
    """A robot that describes itself as no service can use it."""
    hello = reel.hello_of("nobody")
    hello.robot_file_yaml = "robot: {id: nobody, legs: 4}"
    robot = Robot7(stack.address, hello)
    robot.next("refused")
    robot.close()


def _flood(stack: Stack, reel: Reel) -> None:
    """More streams than a robot may have."""
    robots: list[Robot7] = []
    replica = stack.replicas[1]
    denied = ('splitslam_map_auth_refused_total{reason="streams"}',)
    _again(stack, denied, lambda: robots.append(Robot7(replica.address, reel.hello_of("flood"))))
    for robot in robots:
        robot.close()


def _rude(stack: Stack, reel: Reel) -> None:
    """Flipped bits, and a frame that is not the next one."""

    def be_rude() -> None:
        robot = Robot7(stack.address, reel.hello_of("rude"))
        for frame in (*reel.frames[:3], odd_frames.flipped(reel.frames[3]), reel.frames[_REEL_SCANS // 2]):
            robot.send(frame)
        robot.end()
        robot.close()

    counters = ('splitslam_map_rejected_total{reason="corrupt"}', 'splitslam_map_frames_total{result="gap"}')
    _again(stack, counters, be_rude)


def _stolen(stack: Stack, robot: LightRobot) -> None:
    """Somebody opens its session at the other replica, as a robot would that has given the first one up.

    The owner, if it was the first replica just then, finds at its next commit that it is not any more.
    """

    def steal() -> None:
        thief = Robot7(stack.replicas[1].address, robot.hello)
        time.sleep(_COMMIT_S)
        thief.close()

    robot.wait_answers(5, _WAIT_S)
    _again(stack, ("splitslam_map_fenced_total",), steal)


@contextmanager
def _no_disk(pid: int) -> Iterator[None]:
    """Every write of that process to a file fails meanwhile (EFBIG)."""
    _, hard = resource.prlimit(pid, resource.RLIMIT_FSIZE)
    resource.prlimit(pid, resource.RLIMIT_FSIZE, (0, hard))
    try:
        yield
    finally:
        resource.prlimit(pid, resource.RLIMIT_FSIZE, (hard, hard))
