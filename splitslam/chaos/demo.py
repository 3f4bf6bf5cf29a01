"""`splitslam demo --chaos`: four made robots, three replicas, Envoy, PostgreSQL; plugs are pulled, and it is shown."""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path

from splitslam.alignment import interpolate, umeyama
from splitslam.chaos import drives
from splitslam.chaos.account import account_of, session_of
from splitslam.chaos.agent import Agent, Drive
from splitslam.chaos.keys import Keys
from splitslam.chaos.link import Link
from splitslam.chaos.result import ChaosResult, fault_result, robot_result, seen_by
from splitslam.chaos.script import HARMS as LASTS_S
from splitslam.chaos.script import KEYS, Harm
from splitslam.chaos.show import Show
from splitslam.chaos.view import Point, Snapshot
from splitslam.errors import InputError
from splitslam.run.options import check_installed
from splitslam.run.processes import RunFailedError, interruptible
from splitslam.run.progress import Progress
from splitslam.run.session_client import as_trajectory, session_client
from splitslam.stack import Stack, StackError, check_stack_installed
from splitslam.stack.process import free_port
from splitslam.tum import Trajectory, read_tum

SECONDS, MIN_S = 40.0, 10.0
_GET_READY_S = 8.0  # four interpreters and their kernels on two cores
_UNDISTURBED_S, _END_S = 120.0, 60.0
_FRAME_S = 0.2

Watcher = Callable[[Snapshot], None]


def chaos_demo(
    out: Path,
    progress: Progress,
    script: tuple[Harm, ...] | None,
    watch: Watcher,
    *,
    seconds: float | None = None,
    seed: int = 1,
) -> ChaosResult:
    """Makes the drives, runs them undisturbed, then by the clock while `script` or the keys (None) do their harm.

    watch: called five times a second meanwhile. Writes chaos.json into `out`. Raises InputError for what can be seen
    before the start, RunFailedError when the demo itself cannot go on; every process has ended then.
    """
    seconds = SECONDS if seconds is None else seconds
    if not seconds >= MIN_S:
        raise InputError(f"--seconds: expected at least {MIN_S:g}, found {seconds:g}")
    check_installed(("sim", "edge", "server"))
    check_stack_installed()
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--out {out}: expected a folder that can be written ({error.strerror})") from None
    # a folder of its own, short enough for the path of a Unix socket
    with interruptible(), tempfile.TemporaryDirectory(prefix="splitslam-") as work, ExitStack() as cleanup:
        try:
            result = _Demo(Path(work), progress, cleanup, seconds, seed).run(script, watch)
        except StackError as error:
            raise RunFailedError(str(error)) from None
    (out / "chaos.json").write_text(json.dumps(result.as_dict(), indent=1) + "\n")
    return result


class _Demo:
    """One demo; `cleanup` ends its processes in the reverse order of their start."""

    def __init__(self, work: Path, progress: Progress, cleanup: ExitStack, seconds: float, seed: int) -> None:
        self._work, self._progress, self._cleanup = work, progress, cleanup
        self._seconds, self._seed = seconds, seed

    def run(self, script: tuple[Harm, ...] | None, watch: Watcher) -> ChaosResult:
        self._progress.stage("making four drives")
        with ThreadPoolExecutor(1) as pool:
            stack = Stack(self._work / "stack", 3)
            starting = pool.submit(self._cleanup.enter_context, stack)
            made = drives.make(drives.specs(self._seconds, self._seed), self._work / "drives", self._progress.made)
            starting.result()
        undisturbed = self._undisturbed(stack, made)
        self._progress.stage("the robots get ready")
        show = self._begin(stack, made, undisturbed, script is None)
        self._play(show, script, watch)
        return self._result(show, undisturbed)

    def _undisturbed(self, stack: Stack, made: list[Drive]) -> list[Trajectory]:
        """The optimised trajectories of the same drives when nobody pulls a plug."""
        self._progress.stage("the same drives undisturbed")
        agents = [
            Agent(f"calm-{k}", drive, stack.address, self._work / f"calm-{k}") for k, drive in enumerate(made, start=1)
        ]
        for agent in agents:
            self._cleanup.callback(agent.stop)
            agent.start()
        until_s = time.monotonic() + _UNDISTURBED_S + 4 * self._seconds
        for done, agent in enumerate(agents, start=1):
            if not agent.wait(until_s - time.monotonic()) or agent.failure:
                raise RunFailedError(agent.failure or f"{agent.name}: expected its end by now")
            self._progress.made(done, len(agents))
        return [_stored(stack, agent)[1] for agent in agents]

    def _begin(self, stack: Stack, made: list[Drive], undisturbed: list[Trajectory], keys: bool) -> Show:
        began_s = time.monotonic() + _GET_READY_S
        links = [self._cleanup.enter_context(Link(stack.address, seed=k)) for k in range(len(made))]
        agents = []
        for k, (drive, link) in enumerate(zip(made, links, strict=True), start=1):
            agent = Agent(
                f"robot-{k}",
                drive,
                link.address,
                self._work / f"robot-{k}",
                began_s=began_s,
                metrics_port=free_port(),
                socket=self._work / f"{k}.sock",
            )
            self._cleanup.callback(agent.stop)
            agent.start()
            agents.append(agent)
        truths = [read_tum(drive.truth) for drive in made]
        T_yard_map = [
            umeyama(calm.positions_m, interpolate(truth, calm.stamps_ns).positions_m)
            for calm, truth in zip(undisturbed, truths, strict=True)
        ]
        show = Show(stack, agents, links, began_s, self._seconds, T_yard_map, _lap(truths), keys)
        self._cleanup.callback(show.stop)
        show.start()
        return show

    def _play(self, show: Show, script: tuple[Harm, ...] | None, watch: Watcher) -> None:
        waiting = list(script or ())
        until_s = self._seconds + _END_S
        with Keys(script is None) as keys:
            while not show.over and show.now_s < until_s:
                while waiting and show.now_s >= waiting[0].at_s:
                    show.do(waiting.pop(0))
                if (key := keys.pressed(_FRAME_S)) == "q":
                    raise KeyboardInterrupt
                if key in KEYS and show.now_s > 0:
                    show.do(Harm(show.now_s, KEYS[key], LASTS_S[KEYS[key]]))
                watch(show.snapshot())
        for agent in show.agents:
            if agent.failure or not agent.done:
                raise RunFailedError(agent.failure or f"{agent.name}: expected its end {_END_S:g} s after the drive")

    def _result(self, show: Show, undisturbed: list[Trajectory]) -> ChaosResult:
        show.stop()
        accounts = [account_of(agent, _stored(show.stack, agent)[0]) for agent in show.agents]
        seen = [seen_by(agent, account) for agent, account in zip(show.agents, accounts, strict=True)]
        rows = zip(show.agents, accounts, seen, undisturbed, strict=True)
        return ChaosResult(
            tuple(robot_result(*row) for row in rows),
            tuple(fault_result(fault, seen) for fault in sorted(show.done, key=lambda fault: fault.from_s)),
        )


def _stored(stack: Stack, agent: Agent) -> tuple[list, Trajectory]:
    with session_client(stack.address, session_of(agent)) as session:
        poses = session.stored_poses()
    return poses, as_trajectory(poses)


def _lap(truths: list[Trajectory]) -> tuple[Point, ...]:
    """Where any of the robots will have been, m, in the yard."""
    return tuple((float(x), float(y)) for truth in truths for x, y in truth.positions_m[:, :2])
