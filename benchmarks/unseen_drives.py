"""Drives and sensors that differ in kind from those that the defaults were made with (`unseen.py`)."""

from __future__ import annotations

from dataclasses import dataclass, replace

from splitslam.sim import DRIVES
from splitslam.sim.grid_lidar import Grid
from splitslam.sim.places import house, plain
from splitslam.sim.spec import (
    Climb,
    DriveSpec,
    HeadTurn,
    ImuSpec,
    LidarSpec,
    PathSpec,
    Perturbations,
    SpeedChange,
    WorldSpec,
)


@dataclass(frozen=True, slots=True)
class Unseen:
    """A drive of the table. grid: the LiDAR instead of a VLP-16; imu: is it used?"""

    name: str
    what: str
    spec: DriveSpec
    grid: Grid | None = None
    imu: bool = True


_HOUSE = DriveSpec(
    name="house",
    duration_s=44.0,
    world=WorldSpec("house"),
    path=PathSpec(
        waypoints_m=house.through_the_house(), closed=False, speed_mps=0.85, height_m=1.3, leans=0.0,
        head_turns=tuple(
            HeadTurn(at_s, yaw_deg, 1.6)  # on top of the turns through doors
            for at_s, yaw_deg in ((4.5, 40.0), (10.0, -40.0), (16.0, 40.0), (22.0, -40.0), (28.0, 40.0), (35.0, -40.0))
        ),
    ),
    gnss=None,
)  # fmt: skip
_PLAIN = DriveSpec(
    name="plain",
    duration_s=42.0,
    world=WorldSpec("plain"),
    path=PathSpec(
        waypoints_m=plain.along_the_road(), closed=False, speed_mps=20.0, stand_s=2.0, accel_s=8.0, height_m=1.9,
        gait=0.0, dive_deg_per_mps2=0.35, speed_changes=(SpeedChange(32.0, 9.0, 4.0),),
    ),
    gnss=None,
)  # fmt: skip
_CLIMB = DriveSpec(
    name="climb",
    duration_s=40.0,
    world=WorldSpec("street"),
    path=PathSpec(
        waypoints_m=((10.0, -1.7), (24.0, -1.7), (38.0, 6.0), (48.0, 22.0), (60.0, 36.0), (78.0, 46.0), (96.0, 48.0)),
        closed=False, speed_mps=4.0, stand_s=19.0, accel_s=3.0, height_m=0.6, gait=0.2, leans=0.0,
        dive_deg_per_mps2=-3.0, climbs=(Climb(3.0, 30.0, 15.0), Climb(33.0, -12.0, 6.0)),
    ),
    gnss=None,
)  # fmt: skip
_WALK = replace(DRIVES["campus"], duration_s=30.0, gnss=None)
_CHEAP = ImuSpec(  # of the class of an MPU-6050 or BMI160
    rate_hz=100.0, gyro_noise_radps_rthz=2e-4, accel_noise_mps2_rthz=3e-3, gyro_walk_radps2_rthz=1e-4,
    accel_walk_mps3_rthz=1e-3, gyro_bias_radps=0.03, accel_bias_mps2=0.4,
)  # fmt: skip


def _walk(name: str, what: str, spec: DriveSpec = _WALK, grid: Grid | None = None, *, imu: bool = True) -> Unseen:
    return Unseen(name, what, replace(spec, name=name), grid, imu)


def _with(imu: ImuSpec) -> DriveSpec:
    return replace(_WALK, imu=imu)


_UPSIDE_DOWN = ImuSpec(mounting_rpy_deg=(180.0, 0.0, 180.0))
_X_UP = ImuSpec(mounting_rpy_deg=(0.0, -90.0, 0.0), lever_m=(0.4, 0.1, -0.6))
_LATE = Perturbations(imu_time_offset_s=0.005)
UNSEEN = {
    case.name: case
    for case in (
        Unseen("house", "by hand through narrow rooms and up a staircase, turns of up to 200 deg/s", _HOUSE),
        Unseen("house_128", "the same, 128 rings of 1024", replace(_HOUSE, name="house_128"), Grid(128, 1024)),
        Unseen("plain", "a car at 20 m/s in open country", _PLAIN),
        Unseen("plain_128", "the same, 128 rings of 1024", replace(_PLAIN, name="plain_128"), Grid(128, 1024)),
        Unseen("climb", "a drone: 30 m straight up in a street, over the roofs, 12 m down", _CLIMB),
        Unseen("climb_32", "the same, 32 rings", replace(_CLIMB, name="climb_32"), Grid(32, 1800)),
        _walk("walk", "30 s of campus, VLP-16 at 10 Hz: what the next ones differ from"),
        _walk("walk_20hz", "VLP-16 at 20 Hz", replace(_WALK, lidar=LidarSpec(rate_hz=20.0))),
        _walk("walk_32", "32 rings of 1800", grid=Grid(32, 1800)),
        _walk("walk_128", "128 rings of 1024", grid=Grid(128, 1024)),
        _walk("walk_front", "solid state: 120 x 25 degrees ahead, 64 rows", grid=Grid(64, 600, (-12.5, 12.5), 120.0)),
        _walk("walk_narrow", "solid state: 60 x 25 degrees ahead, 64 rows", grid=Grid(64, 600, (-12.5, 12.5), 60.0)),
        _walk("walk_upside_down", "IMU upside down, x back", _with(_UPSIDE_DOWN)),
        _walk("walk_x_up", "IMU with x up, 0.7 m off", _with(_X_UP)),
        _walk("walk_100hz", "IMU of 100 Hz", _with(ImuSpec(rate_hz=100.0))),
        _walk("walk_400hz", "IMU of 400 Hz", _with(ImuSpec(rate_hz=400.0))),
        _walk("walk_cheap", "IMU of 100 Hz with the noise and biases of a cheap one", _with(_CHEAP)),
        _walk("walk_late", "IMU stamps 5 ms late", replace(_WALK, perturbations=_LATE)),
        _walk("walk_no_imu", "no IMU", imu=False),
    )
}
