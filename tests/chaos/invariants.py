"""What must hold whatever is done to the system. Each returns what is wrong, a line each; none is a good answer."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splitslam import se3
from splitslam.chaos.account import account_of, session_of
from splitslam.chaos.agent import Agent
from splitslam.evaluate import evaluate
from splitslam.run.processes import RunFailedError
from splitslam.run.session_client import as_trajectory, session_client
from splitslam.stack.reel import Reel
from splitslam.tum import Trajectory, read_tum
from splitslam.wire.types_pb2 import StampedPose
from tests import tolerances as bars
from tests.chaos.light_robot import LightRobot

_GONE_S, _ASK_S = 30.0, 30.0


@dataclass(frozen=True, slots=True, eq=False)
class Undisturbed:
    """The same drive with nothing done to it. final: the optimised trajectory."""

    reel: Reel
    final: Trajectory
    truth: Path

    @property
    def duration_s(self) -> float:
        """Of the drive."""
        return float(self.final.stamps_ns[-1] - self.final.stamps_ns[0]) * 1e-9

    @classmethod
    def of(cls, reel: Reel, truth: Path) -> Undisturbed:
        stamps_ns = np.array([frame.stamp_ns for frame in reel.frames], np.int64)
        poses = np.array(reel.final_T_map_lidar)
        quats = np.array([se3.quat_from_matrix(T[:3, :3]) for T in poses])
        return cls(reel, Trajectory(stamps_ns, poses[:, :3, 3].copy(), quats), truth)


def session_kept(robot: LightRobot, server: str, undisturbed: Undisturbed) -> list[str]:
    """Of a session that has ended: every scan mapped once, answered once, as the protocol says, and where it was."""
    wrong = list(robot.witness.wrong)
    if robot.failure is not None:
        return [*wrong, f"{robot.name}: {robot.failure}"]
    unanswered = robot.sent - len(robot.arrivals)
    if unanswered or robot.finished is None:
        return [*wrong, f"{robot.name}: {unanswered} of {robot.sent} frames unanswered, finished: {robot.finished}"]
    off_m = float(robot.off_m().max())
    if off_m > bars.CHAOS_WORSE_M:
        wrong.append(f"{robot.name}: an answer is {off_m:.3f} m off the undisturbed run's")
    stored = stored_poses(server, robot.session_id)
    wrong += mapped_once(robot.name, [pose.seq for pose in stored], robot.sent)
    final, truth = undisturbed.final[: robot.sent], read_tum(undisturbed.truth)
    return wrong + not_worse(robot.name, as_trajectory(stored), final, truth)


def stored_poses(server: str, session_id: str) -> list[StampedPose]:
    """What the store has of a session; asked again while the fault goes on. Raises RunFailedError."""
    until_s = time.monotonic() + _ASK_S
    while True:
        try:
            with session_client(server, session_id) as client:
                return client.stored_poses()
        except RunFailedError:
            if time.monotonic() > until_s:
                raise
            time.sleep(0.5)


def agent_kept(agent: Agent, server: str, undisturbed: Undisturbed) -> list[str]:
    """Of a real agent at the end of its drive: nothing lost but what passed while it was dead; `odom` never stepped."""
    if agent.failure is not None or not agent.done:
        return [agent.failure or f"{agent.name} is not done"]
    account = account_of(agent, stored_poses(server, session_of(agent)))
    wrong = [f"{agent.name}: {account.lost} scans lost"] if account.lost else []
    if account.twice:
        wrong.append(f"{agent.name}: {account.twice} scans mapped twice")
    if account.odom_step_m > bars.ODOM_STEP_M:
        wrong.append(f"{agent.name}: odom stepped by {account.odom_step_m:.3f} m")
    return wrong + not_worse(agent.name, account.final, undisturbed.final, read_tum(undisturbed.truth))


def mapped_once(name: str, seqs: Iterable[int], last_seq: int) -> list[str]:
    """The stored frames are 1, 2, ..., last_seq."""
    found = list(seqs)
    missing = sorted(set(range(1, last_seq + 1)) - set(found))
    more_than_once = sorted({seq for seq in found if found.count(seq) > 1} | (set(found) - set(range(1, last_seq + 1))))
    wrong = [f"{name}: scans not mapped: {missing}"] if missing else []
    return wrong + ([f"{name}: scans mapped twice or never sent: {more_than_once}"] if more_than_once else [])


def not_worse(name: str, estimate: Trajectory, undisturbed: Trajectory, truth: Trajectory) -> list[str]:
    """ATE at most max(2 cm, 10 %) above that of the undisturbed run."""
    ate_m, before_m = evaluate(estimate, truth).ate_m, evaluate(undisturbed, truth).ate_m
    if ate_m <= before_m + max(bars.CHAOS_WORSE_M, bars.CHAOS_WORSE_SHARE * before_m):
        return []
    return [f"{name}: ATE {ate_m * 1e3:.1f} mm, undisturbed {before_m * 1e3:.1f} mm"]


def nobody_left(pids: Iterable[int]) -> list[str]:
    """No process of a stack that was taken down."""
    until_s, left = time.monotonic() + _GONE_S, list(pids)
    while (left := [pid for pid in left if _running(pid)]) and time.monotonic() < until_s:
        time.sleep(0.02)
    return [f"process {pid} was left behind: {_command(pid)}" for pid in left]


def memory_bounded(name: str, rss_bytes: list[int]) -> list[str]:
    """Of one process over its life: what it takes at the end is not much more than after its first third."""
    third = len(rss_bytes) // 3
    if third < 3:
        return []
    early, late = float(np.max(rss_bytes[third : 2 * third])), float(np.max(rss_bytes[2 * third :]))
    if late <= early * bars.CHAOS_MEMORY_RATIO:
        return []
    return [f"{name}: {late / 2**20:.0f} MiB, a third of its life earlier {early / 2**20:.0f}"]


def family(pid: int) -> list[int]:
    """The process and all that it has started, directly or not."""
    try:
        tasks = list(Path(f"/proc/{pid}/task").iterdir())
        children = [int(child) for task in tasks for child in (task / "children").read_text().split()]
    except OSError:
        return []
    return [pid, *(member for child in children for member in family(child))]


def rss_bytes(pid: int) -> int:
    """Resident memory; 0 when it has gone."""
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * 4096
    except OSError:
        return 0


def _running(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def _command(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode()[:120]
    except OSError:
        return "gone"
