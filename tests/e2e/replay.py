"""Both pipelines in one process and in lockstep, between a recording whose stream a test may harm and the truth."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edge_agent.odometry.settings import OdometrySettings
from map_service.pipeline import MapPipeline
from map_service.types import State
from splitslam.bench.in_one_process import Harm, Outcome, TimedEvent, run_both
from splitslam.evaluate import Evaluation, evaluate
from splitslam.robot import Robot
from splitslam.tum import read_tum

__all__ = ["Harm", "Replayed", "TimedEvent", "replay"]


@dataclass
class Replayed:
    """What came out, by scan."""

    outcome: Outcome

    @property
    def stamps_ns(self) -> list[int]:
        return [mapped.stamp_ns for mapped in self.outcome.answers]

    @property
    def states(self) -> list[State]:
        return [mapped.state for mapped in self.outcome.answers]

    @property
    def covariances(self) -> list[NDArray[np.float64]]:
        return [mapped.covariance for mapped in self.outcome.answers]

    @property
    def T_map_lidar(self) -> list[NDArray[np.float64]]:
        return [mapped.T_map_lidar for mapped in self.outcome.answers]

    @property
    def T_odom_lidar(self) -> list[NDArray[np.float64]]:
        return self.outcome.scans_odom.T

    @property
    def dropped(self) -> Counter[str]:
        return self.outcome.dropped

    @property
    def uncovered(self) -> int:
        return self.outcome.sequencer.uncovered

    @property
    def pipeline(self) -> MapPipeline:
        return self.outcome.service

    @property
    def jumps(self) -> dict[str, float]:
        return self.outcome.node.jumps

    def evaluation(self, truth: Path, final: bool = True) -> Evaluation:
        """Of the optimised trajectory, or of the answers as they came."""
        return evaluate(self.outcome.final() if final else self.outcome.online(), read_tum(truth))


def replay(
    recording: Path,
    harm: Harm = lambda events: events,
    *,
    max_scans: int | None = None,
    disable: tuple[str, ...] = ("loops",),
    robot: Robot | None = None,
    arrives: Callable[[int], bool] = lambda seq: True,
) -> Replayed:
    """Runs the recording through `harm` and both pipelines; robot: None for the robot file beside it.

    arrives: which answers reach the robot; the edge's own odometry is off.
    """
    return Replayed(
        run_both(
            recording,
            robot or recording.with_suffix(".yaml"),
            harm=harm,
            arrives=arrives,
            max_scans=max_scans,
            disable=disable,
            odometry=OdometrySettings(enabled=False),
        )
    )
