"""How good the robot's pose is when the map service's answers are late.

The paper says that more than 100 ms have almost no effect, and shows no figure. What a robot has is not the answer,
which is always of a scan long past, but T_map_odom as it knows it then times its own T_odom_lidar: that is what is
scored, at IMU rate, beside the answers themselves. Both pipelines run in one process by the recording's clock, so that
the result is the same each time.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge_agent.odometry.settings import OdometrySettings
from splitslam.alignment import aligned, interpolate
from splitslam.bench.in_one_process import Network, Outcome, run_both
from splitslam.bench.options import DelayOptions
from splitslam.evaluate import Evaluation, as_dict, evaluate, inside
from splitslam.run.options import RunOptions
from splitslam.run.processes import interruptible
from splitslam.run.progress import Progress
from splitslam.run.staging import staging
from splitslam.tum import Trajectory, read_tum


@dataclass(frozen=True, slots=True, eq=False)
class Delayed:
    """One run. odometry: may the edge place scans itself when answers are too late? alone_s: for how long it did.

    answers: T_map_lidar as answered. robot: as the robot had it, at IMU rate; without an IMU at scans. seconds,
    error_m: (N,) of the robot's pose at scans, after alignment, for the picture.
    """

    delay_ms: float
    odometry: bool
    alone_s: float
    answers: Evaluation
    robot: Evaluation
    odom_max_m: float
    seconds: NDArray[np.float64]
    error_m: NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class DelayResult:
    """A recording's runs, the first the one that the others are compared with. own_truth: there was no other."""

    name: str
    scans: int
    own_truth: bool
    at_imu_rate: bool
    runs: list[Delayed]

    def ratio(self, run: Delayed) -> float:
        """Of the robot's ATE, to the first run's."""
        return run.robot.ate_m / self.runs[0].robot.ate_m


def bench_delay(options: DelayOptions, progress: Progress) -> tuple[DelayResult, dict[str, Any]]:
    """Measures, and writes delay.json and delay.png into `options.out`; returns what is in them.

    Raises InputError for bad input; then nothing is written.
    """
    from splitslam.bench.delay_show import draw

    with interruptible(), staging(options.out) as stage:
        result = measure(options, options.run(stage.work / "run"), progress.stage)
        made = result_dict(result)
        (stage.results / "delay.json").write_text(json.dumps(made, indent=1, allow_nan=False) + "\n", encoding="utf-8")
        (stage.results / "delay.png").write_bytes(draw(result))
        stage.publish()
    return result, made


def measure(options: DelayOptions, run: RunOptions, stage: Callable[[str], None]) -> DelayResult:
    """All runs. Without a truth the first run's optimised trajectory is one."""
    truth_file = options.truth_file()
    truth = None if truth_file is None else read_tum(truth_file)
    runs: list[Delayed] = []
    scans, at_imu_rate = 0, False
    for delay_ms in options.delays_ms:
        for odometry in (True, False):
            stage(f"{run.recording.stem}: answers {delay_ms:g} ms late" + ("" if odometry else ", Imu node alone"))
            out = run_both(
                run.recording,
                run.robot,
                network=Network(delay_ms * 1e-3),
                max_scans=run.max_scans,
                disable=run.disable,
                odometry=OdometrySettings(enabled=odometry),
            )
            truth = truth or out.final()
            scans, at_imu_rate = len(out.scans_map.T), bool(out.imu_map.T)
            runs.append(_scored(out, truth, delay_ms, odometry))
            if not out.outages.count:  # then it is the same without
                break
    return DelayResult(run.recording.stem, scans, truth_file is None, at_imu_rate, runs)


def _scored(out: Outcome, truth: Trajectory, delay_ms: float, odometry: bool) -> Delayed:
    robot = (out.imu_map if out.imu_map.T else out.scans_map).trajectory()
    at_scans = out.scans_map.trajectory()
    at_scans = at_scans[inside(at_scans, truth)]
    true = interpolate(truth, at_scans.stamps_ns)
    return Delayed(
        delay_ms=delay_ms,
        odometry=odometry,
        alone_s=out.outages.report().seconds,
        answers=evaluate(out.online(), truth),
        robot=evaluate(robot, truth),
        odom_max_m=out.node.jumps["odom_max_m"],
        seconds=np.asarray((at_scans.stamps_ns - out.start_ns) * 1e-9, np.float64),
        error_m=np.asarray(np.linalg.norm(aligned(at_scans, true) - true.positions_m, axis=1), np.float64),
    )


def result_dict(result: DelayResult) -> dict[str, Any]:
    """delay.json."""
    return {
        "name": result.name,
        "scans": result.scans,
        "truth": "its own optimised trajectory" if result.own_truth else "given",
        "robot_pose_at": "IMU rate" if result.at_imu_rate else "scans",
        "runs": [
            {
                "delay_ms": run.delay_ms,
                "edge_odometry": run.odometry,
                "alone_s": run.alone_s,
                "answers": as_dict(run.answers),
                "robot": as_dict(run.robot),
                "robot_ate_ratio": result.ratio(run),
                "odom_max_m": run.odom_max_m,
            }
            for run in result.runs
        ],
    }
