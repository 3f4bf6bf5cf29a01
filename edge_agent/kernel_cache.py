"""The compiled kernels on disk: filled at installation, and counted at each start.

numba keeps them beside the source or in $NUMBA_CACHE_DIR, for one kind of CPU: on another one they are compiled anew.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from numba.core import event

from splitslam.robot import Robot, load_robot

_COMPILE = "numba:compile"


@dataclass(slots=True)
class KernelReport:
    """What a warm-up cost. compiled: functions that were not in the cache. seconds: wall time."""

    compiled: int = 0
    seconds: float = 0.0

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


@contextmanager
def counted() -> Iterator[KernelReport]:
    """Counts what is compiled inside the block; the report is complete after it."""
    report, began_s = KernelReport(), time.monotonic()
    with event.install_recorder(_COMPILE) as recorder:
        yield report
    report.compiled = sum(entry.is_start for _, entry in recorder.buffer)
    report.seconds = round(time.monotonic() - began_s, 3)


def fill(robot_file: Path | None) -> KernelReport:
    """Runs every kernel of the edge once. robot_file: None: any robot with an IMU; raises InputError for a bad one."""
    from edge_agent.imu.settings import ImuSettings
    from edge_agent.odometry.settings import OdometrySettings
    from edge_agent.settings import PipelineSettings
    from edge_agent.sources.beams import known_elevations_rad
    from edge_agent.warm_up import warm_up

    robot = Robot.model_validate(_ANY_ROBOT) if robot_file is None else load_robot(robot_file)
    beams = known_elevations_rad(robot.lidar)
    if beams is None:  # estimated from scans, which are not here: any will do
        beams = known_elevations_rad(Robot.model_validate(_ANY_ROBOT).lidar)
    assert beams is not None
    with counted() as report:
        warm_up(robot, PipelineSettings(), ImuSettings(), beams, OdometrySettings())
    return report


_ANY_ROBOT = {
    "robot": {"id": "warm-up"},
    "lidar": {"model": "vlp16"},
    "wheels": {},
    "T_lidar_imu": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]],
}
