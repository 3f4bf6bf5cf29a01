"""What became of every scan of a real agent, from its files, its supervisor and the store."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitslam.chaos.agent import Agent
from splitslam.run.session_client import as_trajectory
from splitslam.tum import Trajectory, read_tum
from splitslam.wire.types_pb2 import StampedPose

# Scans that were being taken, or waited in the queue, when the agent died.
_UNDER_WAY_NS = 500_000_000
_NO_SCANS = frozenset({"feed_slow_reader", "buffer_full_after_answer"})
_STAMP_NS = 2_000_000  # the recording's stamps are rounded


@dataclass(frozen=True, slots=True, eq=False)
class Account:
    """due: scans of the recording. mapped: in the store, each once. dropped: said by the agent to be dropped. unseen:
    passed while no agent was running. lost: none of these. twice: in the store under a second seq.

    final: optimised T_map_lidar. odom_step_m: jumps.odom_max_m of every life that came to report it.
    """

    due: int
    mapped: int
    dropped: int
    unseen: int
    lost: int
    twice: int
    odom_step_m: float
    final: Trajectory


def session_of(agent: Agent) -> str:
    """The session's id, by its last life's report. Raises ValueError when that has none."""
    report = agent.lives[-1].report
    if report is None:
        raise ValueError(f"{agent.name}: its last life has left no edge.json")
    return str(report["session_id"])


def account_of(agent: Agent, stored: Sequence[StampedPose]) -> Account:
    """`stored`: every pose of its session, in order of time."""
    truth_ns = read_tum(agent.drive.truth).stamps_ns
    stamps_ns = np.array([pose.stamp_ns for pose in stored], np.int64)
    unique = [pose for k, pose in enumerate(stored) if k == 0 or pose.stamp_ns > stored[k - 1].stamp_ns]
    missing_ns = truth_ns[~_near(truth_ns, stamps_ns)]
    unseen = missing_ns[_between(missing_ns, _dead_ns(agent, stamps_ns, int(truth_ns[0])))]
    reports = [report for life in agent.lives if (report := life.report) is not None]
    dropped = sum(
        count for report in reports for reason, count in report["dropped_by_reason"].items() if reason not in _NO_SCANS
    )
    return Account(
        due=len(truth_ns),
        mapped=len(unique),
        dropped=dropped,
        unseen=len(unseen),
        lost=max(0, len(missing_ns) - len(unseen) - dropped),
        twice=len(stored) - len(unique),
        odom_step_m=max((report["jumps"]["odom_max_m"] or 0.0 for report in reports), default=0.0),
        final=as_trajectory(unique),
    )


def _near(stamps_ns: NDArray[np.int64], others_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(N,) Which of the stamps are among the others."""
    if not len(others_ns):
        return np.zeros(len(stamps_ns), bool)
    after = np.searchsorted(others_ns, stamps_ns - _STAMP_NS).clip(max=len(others_ns) - 1)
    return np.abs(others_ns[after] - stamps_ns) <= _STAMP_NS


def _dead_ns(agent: Agent, mapped_ns: NDArray[np.int64], origin_ns: int) -> list[tuple[int, int]]:
    """When no agent ran, in the recording's time: until the first scan in the store, and from each death to the next
    life's first one.
    """
    if agent.began_s is None or not len(mapped_ns):
        return []
    first = agent.lives[0].report
    late = first is None or first["passed_scans"] > 0
    spans = [(origin_ns, int(mapped_ns[0]))] if late else []
    for life, following in zip(agent.lives, agent.lives[1:], strict=False):
        assert life.ended_s is not None
        died_ns = origin_ns + int((life.ended_s - agent.began_s) * 1e9)
        began_ns = origin_ns + int((following.began_s - agent.began_s) * 1e9)
        again = mapped_ns[mapped_ns > began_ns]
        spans.append((died_ns - _UNDER_WAY_NS, int(again[0]) if len(again) else 2**62))
    return spans


def _between(stamps_ns: NDArray[np.int64], spans: list[tuple[int, int]]) -> NDArray[np.bool_]:
    inside = np.zeros(len(stamps_ns), bool)
    for begin_ns, end_ns in spans:
        inside |= (stamps_ns >= begin_ns) & (stamps_ns < end_ns)
    return inside
