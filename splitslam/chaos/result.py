"""What a chaos demo has shown, from the agents' files and the store: one row a robot, one a fault."""

from __future__ import annotations

import itertools
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitslam.alignment import interpolate, umeyama
from splitslam.chaos.account import Account
from splitslam.chaos.agent import Agent
from splitslam.chaos.show import Inflicted
from splitslam.evaluate import evaluate
from splitslam.tum import Trajectory, read_tum

_OFF_M = 0.1  # more than undisturbed: a map that a robot cannot be driven by
_AFTER_S = 2.0  # a fault's drift is looked for until so long after it was mended


@dataclass(frozen=True, slots=True)
class RobotResult:
    """Scans as in Account; longest_gap_s without an answer; errors of the optimised trajectory, m."""

    robot: str
    due: int
    mapped: int
    dropped: int
    unseen: int
    lost: int
    twice: int
    longest_gap_s: float
    ate_m: float
    ate_undisturbed_m: float
    odom_step_m: float

    @property
    def off(self) -> bool:
        """What was done to it has bent its trajectory."""
        return not self.ate_m <= self.ate_undisturbed_m + _OFF_M


@dataclass(frozen=True, slots=True)
class FaultResult:
    """gap_s: the longest time that a robot waited for its next answer. drift_m: how far a robot's own pose, as it was
    known at the time, was from the truth at most, until shortly after.
    """

    fault: str
    at_s: float
    lasted_s: float
    gap_s: float
    drift_m: float


@dataclass(frozen=True, slots=True)
class ChaosResult:
    robots: tuple[RobotResult, ...]
    faults: tuple[FaultResult, ...]

    @property
    def passed(self) -> bool:
        """Nothing lost, nothing mapped twice, and every trajectory as good as one that nobody disturbed."""
        return not any(robot.lost or robot.twice or robot.off for robot in self.robots)

    def as_dict(self) -> dict[str, Any]:
        """chaos.json."""
        return asdict(self)


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """One robot's run. answers_s: when the first answer to each frame came, in order. stamps_s, error_m: its own pose
    against the truth. Times since the drive's begin.
    """

    answers_s: NDArray[np.float64]
    stamps_s: NDArray[np.float64]
    error_m: NDArray[np.float64]

    def gap_s(self, from_s: float = -np.inf, to_s: float = np.inf) -> float:
        """The longest time without an answer that touches the two times."""
        pairs = itertools.pairwise(self.answers_s.tolist())
        return max((b - a for a, b in pairs if b >= from_s and a <= to_s), default=0.0)

    def drift_m(self, from_s: float, to_s: float) -> float:
        """The largest error between the two times."""
        inside = (self.stamps_s >= from_s) & (self.stamps_s <= to_s)
        return float(self.error_m[inside].max(initial=0.0))


def seen_by(agent: Agent, account: Account) -> Seen:
    """From the files of all of its lives."""
    truth = read_tum(agent.drive.truth)
    dense = read_tum(agent.drive.truth.with_suffix(".imu_truth.tum"))
    origin_ns = int(truth.stamps_ns[0])
    T_truth_map = _alignment(account.final, truth)
    answers, stamps, errors = [], [], []
    for life in agent.lives:
        online = life.trajectory("online.tum")
        if online is None:
            continue
        answers.append(_answers_s(life.report, online, origin_ns))
        imu = life.trajectory("imu.tum")
        if imu is not None:
            known = (imu.stamps_ns >= online.stamps_ns[0]) & (imu.stamps_ns <= dense.stamps_ns[-1])
            imu = imu[known]
            reference = interpolate(dense, imu.stamps_ns)
            placed = imu.positions_m @ T_truth_map[:3, :3].T + T_truth_map[:3, 3]
            stamps.append((imu.stamps_ns - origin_ns) * 1e-9)
            errors.append(np.linalg.norm(placed - reference.positions_m, axis=1))
    empty = [np.zeros(0)]
    return Seen(
        np.sort(np.concatenate(answers or empty)), np.concatenate(stamps or empty), np.concatenate(errors or empty)
    )


def _answers_s(report: dict[str, Any] | None, online: Trajectory, origin_ns: int) -> NDArray[np.float64]:
    """Of a life that was ended by force only the scans' own times are known: answers came as soon as they could."""
    if report is None:
        return np.asarray((online.stamps_ns - origin_ns) * 1e-9, np.float64)
    trips = zip(report["stamps_ns_by_scan"], report["round_trip_ms_by_scan"], strict=True)
    return np.array([(ns - origin_ns) * 1e-9 + ms * 1e-3 for ns, ms in trips if ms is not None], np.float64)


def _alignment(estimate: Trajectory, truth: Trajectory) -> NDArray[np.float64]:
    return umeyama(estimate.positions_m, interpolate(truth, estimate.stamps_ns).positions_m)


def robot_result(agent: Agent, account: Account, seen: Seen, undisturbed: Trajectory) -> RobotResult:
    """`undisturbed`: the optimised trajectory of the same drive with nothing done to it."""
    truth = read_tum(agent.drive.truth)
    return RobotResult(
        robot=agent.name,
        due=account.due,
        mapped=account.mapped,
        dropped=account.dropped,
        unseen=account.unseen,
        lost=account.lost,
        twice=account.twice,
        longest_gap_s=seen.gap_s(),
        ate_m=evaluate(account.final, truth).ate_m,
        ate_undisturbed_m=evaluate(undisturbed, truth).ate_m,
        odom_step_m=account.odom_step_m,
    )


def fault_result(fault: Inflicted, seen: list[Seen]) -> FaultResult:
    """Over all robots."""
    to_s = fault.to_s + _AFTER_S
    return FaultResult(
        fault=fault.what,
        at_s=fault.from_s,
        lasted_s=fault.to_s - fault.from_s,
        gap_s=max(robot.gap_s(fault.from_s, fault.to_s) for robot in seen),
        drift_m=max(robot.drift_m(fault.from_s, to_s) for robot in seen),
    )
