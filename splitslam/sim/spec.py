"""What a made drive is: frozen descriptions with defaults; the same spec and seed give the same bytes."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class WorldSpec:
    """A place. kind: a key of `splitslam.sim.world.WORLDS`; seed: where its trees, cars and benches stand."""

    kind: str = "campus"
    seed: int = 1


@dataclass(frozen=True)
class HeadTurn:
    """The sensor looks `yaw_deg` aside (left is positive) and back again within `over_s`, from `at_s` on."""

    at_s: float
    yaw_deg: float
    over_s: float


@dataclass(frozen=True)
class SpeedChange:
    """From `at_s` on the speed goes smoothly to `to_mps` within `over_s`; changes follow each other in time."""

    at_s: float
    to_mps: float
    over_s: float


@dataclass(frozen=True)
class Climb:
    """From `at_s` on the sensor rises smoothly by `by_m` (sinks, if negative) within `over_s`, beside what the ground
    does."""

    at_s: float
    by_m: float
    over_s: float


@dataclass(frozen=True)
class PathSpec:
    """How the sensor moves: along a smooth curve through the waypoints, over the world's ground.

    stand_s: standing still at first. accel_s: from rest to `speed_mps`; both 0: the drive starts in motion.
    speed_changes: what happens after that. gait: strength of the walker's bob, sway and nod; 0 is a vehicle, 1 a
    person. dive_deg_per_mps2: how far a vehicle's nose dips when it brakes. leans: the share of the ground's slope that
    the sensor takes on; 0 is carried level. climbs: of what flies.
    """

    waypoints_m: tuple[tuple[float, float], ...]
    closed: bool = True
    speed_mps: float = 1.3
    stand_s: float = 2.5
    accel_s: float = 1.5
    height_m: float = 1.15
    speed_changes: tuple[SpeedChange, ...] = ()
    gait: float = 1.0
    dive_deg_per_mps2: float = 0.0
    head_turns: tuple[HeadTurn, ...] = ()
    leans: float = 1.0
    climbs: tuple[Climb, ...] = ()

    def __post_init__(self) -> None:
        if self.stand_s > 0.0 and self.accel_s <= 0.0:
            raise ValueError("accel_s must be positive when the drive starts from rest (stand_s > 0)")


@dataclass(frozen=True)
class LidarSpec:
    """A VLP-16. detection: the smallest reflectivity * cos(incidence) / range^2 that still makes a return."""

    rate_hz: float = 10.0
    min_range_m: float = 0.5
    max_range_m: float = 100.0
    range_noise_m: float = 0.01
    detection: float = 1e-3


@dataclass(frozen=True)
class ImuSpec:
    """Defaults are those of a 3DM-GX5-25. The IMU sits turned and off-centre, so that wrong extrinsics show."""

    rate_hz: float = 500.0
    gyro_noise_radps_rthz: float = 1.2e-4
    accel_noise_mps2_rthz: float = 2.5e-4
    gyro_walk_radps2_rthz: float = 2.0e-5
    accel_walk_mps3_rthz: float = 2.0e-4
    gyro_bias_radps: float = 2e-3  # standard deviation of the bias at switch-on, each axis
    accel_bias_mps2: float = 2e-2
    mounting_rpy_deg: tuple[float, float, float] = (1.0, -0.6, 90.0)
    lever_m: tuple[float, float, float] = (0.07, -0.03, -0.09)


@dataclass(frozen=True)
class GnssSpec:
    """An antenna on the sensor. The correlated part is first-order Gauss-Markov; vertical is twice horizontal."""

    rate_hz: float = 5.0
    correlated_noise_m: float = 0.5
    correlation_s: float = 30.0
    white_noise_m: float = 0.1
    lever_m: tuple[float, float, float] = (0.0, 0.0, 0.25)
    datum_deg_m: tuple[float, float, float] = (35.5552, 139.6555, 30.0)  # latitude, longitude, altitude
    enu_yaw_deg: float = 27.0  # the world's x axis, counter-clockwise from east


@dataclass(frozen=True)
class WheelSpec:
    """Wheel odometry of frame `body`, which lies on the ground below the sensor: forward speed and yaw rate."""

    rate_hz: float = 50.0
    scale_error: float = 0.01  # standard deviation, forward speed and yaw rate each
    speed_noise_mps: float = 0.02
    yaw_rate_noise_radps: float = 0.01


@dataclass(frozen=True)
class Perturbations:
    """What the robot file does not tell. Every one is a switch of its own: 0 is off."""

    walking_people: int = 0
    laser_bias_m: float = 0.0  # standard deviation over the 16 lasers of a constant range error
    incidence_bias_m: float = 0.0  # range error at grazing incidence, growing with tan(incidence) up to 80 deg
    mixed_pixels_mrad: float = 0.0  # the beam's width: at an edge a part of it goes past
    glass: float = 0.0  # how clean panes are: 1 lets beams through or mirrors them and makes no echo of its own
    blocked_deg: float = 0.0  # width of a sector behind the sensor that gives no returns
    scans_lost: float = 0.0  # share of scans that are not in the recording
    imu_rate_hz: float = 0.0  # the IMU's rate instead of its own; the robot file knows it
    imu_random_mounting: int = 0  # 1: any orientation; the robot file knows it
    imu_time_offset_s: float = 0.0  # stamps say later than it was
    imu_time_jitter_s: float = 0.0  # standard deviation; stamps stay in order
    imu_scale: float = 0.0  # relative, standard deviation, each axis
    imu_misalignment_deg: float = 0.0  # standard deviation, each axis pair
    imu_vibration_mps2: float = 0.0  # amplitude of a 37 Hz shake while moving (a tenth of it, in rad/s, turns)
    imu_dropout_s: float = 0.0  # so long no sample comes
    imu_dropout_at_s: float = 20.0
    extrinsic_error_deg: float = 0.0  # T_lidar_imu of the robot file is off by this angle
    gnss_jump_m: float = 0.0
    gnss_jump_at_s: float = 20.0
    gnss_jump_over_s: float = 6.0
    wheel_slip: float = 0.0  # for 1.5 s in every 10 s the wheels spin (then: drag) by this share of the speed
    kidnap_m: float = 0.0  # the sensor is at once so far back on its way, unseen by the IMU, blind for one scan
    kidnap_at_s: tuple[float, ...] = (20.05, 35.05)


@dataclass(frozen=True)
class DriveSpec:
    """One drive: a place, a way through it, sensors and their faults. `seed` draws noise, not the world."""

    name: str
    duration_s: float
    path: PathSpec
    seed: int = 1
    world: WorldSpec = field(default_factory=WorldSpec)
    lidar: LidarSpec = field(default_factory=LidarSpec)
    imu: ImuSpec = field(default_factory=ImuSpec)
    gnss: GnssSpec | None = field(default_factory=GnssSpec)
    wheels: WheelSpec | None = None
    perturbations: Perturbations = field(default_factory=Perturbations)
    start_ns: int = 1_700_000_000_000_000_000
    gravity_mps2: float = 9.80665
    what: str = ""  # for those who choose one


DEMO = DriveSpec(
    name="demo",
    duration_s=45.0,
    path=PathSpec(
        # Once round the pavilion of the campus (about 46 m) and the first metres again, for the loop closure.
        waypoints_m=(
            *((-2.5, -5.6), (3.0, -5.4), (7.3, -3.6), (8.0, 0.5), (6.8, 4.4)),
            *((2.5, 5.6), (-3.0, 5.3), (-7.2, 4.2), (-8.2, 0.0), (-6.9, -4.2)),
        ),
        head_turns=(HeadTurn(9.0, 50.0, 2.0), HeadTurn(18.0, -60.0, 2.2), HeadTurn(29.0, 55.0, 1.9)),
    ),
    perturbations=Perturbations(walking_people=4),
)
