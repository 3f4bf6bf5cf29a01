"""The compiled kernels on disk: filled at installation, and counted at each start.

numba keeps them beside the source or in $NUMBA_CACHE_DIR, for one kind of CPU: on another one they are compiled anew.
"""

from __future__ import annotations

from pathlib import Path

from splitslam.compile_count import KernelReport, counted
from splitslam.robot import Robot, load_robot


def fill(robot_file: Path | None) -> KernelReport:
    """Runs every kernel of the edge once. robot_file: None: any robot with an IMU; raises InputError for a bad one."""
    from edge_agent.imu.settings import ImuSettings
    from edge_agent.odometry.settings import OdometrySettings
    from edge_agent.settings import PipelineSettings
    from edge_agent.sources.beams import known_elevations_rad
    from edge_agent.warm_up import warm_up

    robot = Robot.model_validate(_ANY_ROBOT) if robot_file is None else load_robot(robot_file, placed_elsewhere=True)
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
