"""A fleet that is watched: one stack, two real agents, odd robots; first nothing is done to it, then a lot."""

from __future__ import annotations

import os
import resource
import signal
import sys
import time
import urllib.request
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from splitslam.chaos.agent import PROGRAM, Agent, Drive
from splitslam.chaos.link import Link
from splitslam.stack import Stack
from splitslam.stack.process import free_port, wait_until
from splitslam.stack.reel import Reel, record
from splitslam.stack.robot import LightRobot
from splitslam.top.command import Top
from splitslam.top.page import Page
from splitslam.top.view import Screen
from tests.map_service.harness import Robot7
from tests.monitoring import harmed_drive, odd_frames
from tests.monitoring.prometheus import Prometheus

CALM, SICK = "rover-1", "rover-2"  # the network, disk and process of the first are harmed later, the other's sensors
_STREAMS = 4  # that a robot may have open
_REPLICAS = {
    "replica": {"beat_s": 0.2, "rest_s": 0.4},
    "quota": {"sites": {"yard": 10**9}},
    "limits": {"client": {"streams": _STREAMS}, "max_delay_s": 60.0},  # a slow machine is not what is tested
}
_SMALL_SPOOL = {"spool": {"max_bytes": 2**16}, "uplink": {"copies_bytes": 0}, "output": {"dir": None}}
_BUDGET = {"uplink": {"max_kbps": 100.0}, "pipeline": {"deskew": "fpga"}}
_ON_A_SICK_BOARD = (sys.executable, "-m", "tests.monitoring.sick_logic")
_GET_READY_S = 8.0
_CALM_S, _AWAY_S, _DISK_S, _STORE_S = 4.0, 4.0, 1.0, 1.5
_SCRAPES_S = 2.5  # after the last fault, so that it is on two pages
_REEL_SCANS, _BLIND_AFTER = 60, 15


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
        fleet = _Fleet(folder, stack, drives, cleanup)
        reel = record(drives[0].recording, drives[0].robot, max_scans=_REEL_SCANS)  # while the agents get ready
        prometheus, began_s = cleanup.enter_context(Prometheus(folder, fleet.targets, rules)), time.time()
        top = Top([*fleet.targets["edge-agent"], *fleet.targets["map-service"]])
        fleet.wait_tracking()
        calm_s = time.time()
        top.read()
        time.sleep(_CALM_S)
        top.read()
        calm, harmed_s = top.screen(), time.time()
        _harm(fleet, stack, reel)
        top.read()
        yield Watched(prometheus, (calm_s, harmed_s), (began_s, time.time()), (calm, top.screen()))


def _prepare(folder: Path, cleanup: ExitStack) -> tuple[Stack, tuple[Drive, Drive]]:
    """The stack starts while the drive is made."""
    pool = cleanup.enter_context(ThreadPoolExecutor(1))
    stack = Stack(folder / "stack", replicas=2, settings=_REPLICAS)
    starting = pool.submit(cleanup.enter_context, stack)
    drive = harmed_drive.make(folder / "drive")
    harmed = harmed_drive.harm(drive, folder / "harmed")
    starting.result()
    return stack, (drive, harmed)


class _Fleet:
    """The two agents, each on its own drive, the first behind a link."""

    def __init__(self, folder: Path, stack: Stack, drives: tuple[Drive, Drive], cleanup: ExitStack) -> None:
        self.link = cleanup.enter_context(Link(stack.address))
        began_s = time.monotonic() + _GET_READY_S

        def start(name: str, drive: Drive, server: str, settings: dict[str, Any], program: tuple[str, ...]) -> Agent:
            agent = Agent(
                *(name, drive, server, folder / name),
                began_s=began_s,
                metrics_port=free_port(),
                settings=settings,
                program=program,
            )
            cleanup.callback(agent.stop)
            agent.start()
            return agent

        self.calm = start(CALM, drives[0], self.link.address, _SMALL_SPOOL, PROGRAM)
        self.sick = start(SICK, drives[1], stack.address, _BUDGET, _ON_A_SICK_BOARD)
        self.targets: dict[str, dict[str, dict[str, str]]] = {
            "edge-agent": {_metrics_of(agent): {"robot": agent.name} for agent in (self.calm, self.sick)},
            "map-service": {f"127.0.0.1:{replica.metrics_port}": {} for replica in stack.replicas},
        }

    def wait_tracking(self) -> None:
        wait_until(lambda: _tracks(self.calm) and _tracks(self.sick), 60.0, "both agents tracking")


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
        time.sleep(_DISK_S)
    os.kill(stack.replicas[0].workers()[-1], signal.SIGKILL)
    assert stack.postgres is not None
    stack.postgres.kill()
    time.sleep(_STORE_S)
    stack.postgres.start()
    fleet.calm.process.kill()
    time.sleep(1.0)
    wait_until(lambda: _page(fleet.calm).has("splitslam_"), 60.0, "the agent again")
    wait_until(lambda: fleet.sick.done or _page(fleet.sick).value("splitslam_edge_check_problems") > 0, 60.0, "a check")
    time.sleep(_SCRAPES_S)
    for robot in (blind, *crowd):
        robot.close()


def _refused(stack: Stack, reel: Reel) -> None:
    """A robot that describes itself as no service can use it."""
    hello = reel.hello_of("nobody")
    hello.robot_file_yaml = "robot: {id: nobody, legs: 4}"
    robot = Robot7(stack.address, hello)
    robot.next("refused")
    robot.close()


def _flood(stack: Stack, reel: Reel) -> None:
    """One stream more than a robot may have."""
    robots = [Robot7(stack.replicas[1].address, reel.hello_of("flood")) for _ in range(_STREAMS + 1)]
    robots[-1].next("refused")
    for robot in robots:
        robot.close()


def _rude(stack: Stack, reel: Reel) -> None:
    """Flipped bits, and a frame that is not the next one."""
    robot = Robot7(stack.address, reel.hello_of("rude"))
    robot.next("welcome")
    for frame in reel.frames[:3]:
        robot.ask(frame)
    robot.ask(odd_frames.flipped(reel.frames[3]))
    robot.send(reel.frames[40])
    robot.end()
    robot.close()


def _stolen(stack: Stack, robot: LightRobot) -> None:
    """Somebody opens its session at the other replica, as a robot would that has given the first one up."""
    thief = Robot7(stack.replicas[1].address, robot.hello)
    thief.next("welcome")
    time.sleep(1.2)  # the owner's next commit
    thief.close()


@contextmanager
def _no_disk(pid: int) -> Iterator[None]:
    """Every write of that process to a file fails meanwhile (EFBIG)."""
    _, hard = resource.prlimit(pid, resource.RLIMIT_FSIZE)
    resource.prlimit(pid, resource.RLIMIT_FSIZE, (0, hard))
    try:
        yield
    finally:
        resource.prlimit(pid, resource.RLIMIT_FSIZE, (hard, hard))
