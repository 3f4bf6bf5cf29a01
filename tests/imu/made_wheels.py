"""The made drive of made.py with wheels under it: scale error, noise, slips, and a link that may break."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from edge_agent.imu.node import ImuNode
from edge_agent.imu.settings import ImuSettings
from edge_agent.types import OdometryReply
from splitslam import se3
from splitslam.robot import robot_from_yaml, robot_to_yaml
from splitslam.scan import ImuSamples, WheelSamples
from tests.imu import made

RATE_HZ = 50.0
SEED = 9  # with it the IMU alone drifts about as much as in the mean of ten, with some it hardly does by chance
T_IMU_WHEEL = se3.compose(np.eye(3), np.array([0.0, 0.1, -0.6]))


@dataclass(frozen=True)
class Wheels:
    """What the wheels say of the drive: a speed that is off by `scale`, noisy, and wrong by `slip_mps` at times."""

    scale: float = 0.0
    noise_mps: float = 0.02
    slip_mps: Callable[[float], float] = lambda t: 0.0

    def sample(self, drive: made.Drive, stamp_ns: int, rng: np.random.Generator) -> WheelSamples:
        t, h = (stamp_ns - made.START_NS) * 1e-9, 1e-4
        a, b, c = (drive.T_odom_imu(t + d) @ T_IMU_WHEEL for d in (-h, 0.0, h))
        velocity = b[:3, :3].T @ (c[:3, 3] - a[:3, 3]) / (2 * h)
        rate = se3.so3_log(a[:3, :3].T @ c[:3, :3]) / (2 * h)
        read = velocity[0] * (1 - self.scale) + self.slip_mps(t) + rng.normal(0, self.noise_mps)
        return WheelSamples(np.array([stamp_ns]), np.array([[read, 0.0]]), rate[2:])


@dataclass(frozen=True)
class Service:
    """The map service of a drive: until when it answers, and from when on it sees nothing along its way."""

    until_s: float = np.inf
    blind_s: float = np.inf
    noise_m: float = 0.0


@dataclass(frozen=True)
class PoorImu:
    """Noise of the accelerometer, a sample, and a bias along x that grows with the temperature."""

    noise_mps2: float = 0.02
    ramp_mps3: float = 0.0
    ramp_from_s: float = 12.0


@dataclass
class Played:
    """By scan: drift of `T_odom_lidar` (3,), m, axes of `imu` (x is forward); error of the predicted motion, m, and
    what the node thinks of it, m, one axis."""

    node: ImuNode
    drift_m: dict[float, np.ndarray] = field(default_factory=dict)
    motion_m: dict[float, float] = field(default_factory=dict)
    sigma_m: dict[float, float] = field(default_factory=dict)


def make_node(wheels: bool, **description: object) -> ImuNode:
    robot = made.robot()
    if wheels:
        T = robot.T_lidar_imu @ T_IMU_WHEEL
        rows = [[float(v) for v in row] for row in T]
        extra = ", ".join(f"{key}: {value}" for key, value in description.items())
        text = f"wheels: {{topic: /wheel/odom, T_body_wheel: {rows}{', ' if extra else ''}{extra}}}\n"
        robot = robot_from_yaml(robot_to_yaml(robot).replace("wheels: null\n", text))
    return ImuNode(robot, ImuSettings())


def play(
    node: ImuNode,
    drive: made.Drive,
    seconds: float,
    wheels: Wheels | None,
    service: Service = Service(),
    imu: PoorImu = PoorImu(),
    since_s: float = 4.0,
) -> Played:
    """IMU 200 Hz, wheels 50 Hz, scans 10 Hz, answers two scans late; drift is counted from `since_s` on.

    A blind service carries its pose on by the edge's own prediction, as the registration does.
    """
    rng, wheel_rng = np.random.default_rng(SEED), np.random.default_rng(SEED + 1)  # the same with wheels and without
    robot, played = node.robot, Played(node)
    stamps = made.START_NS + np.arange(int(seconds * 200)) * 5_000_000
    values = [np.concatenate(drive.imu(max((s - made.START_NS) * 1e-9, 1e-3))) for s in stamps]  # no step at the start
    noisy = np.array(values) + rng.normal(0, 1.0, (len(stamps), 6)) * np.repeat([2e-3, imu.noise_mps2], 3)
    noisy[:, 3] += imu.ramp_mps3 * np.maximum((stamps - made.START_NS) * 1e-9 - imu.ramp_from_s, 0.0)
    T_imu_lidar = se3.inv(robot.T_lidar_imu)
    T_first = drive.T_odom_imu(0.0) @ T_imu_lidar
    T_map_odom, T_map_lidar = np.eye(4), np.eye(4)
    replies: list[OdometryReply] = []
    done, reference = 0, np.eye(4)
    for k in range(int(seconds * 10) - 2):
        start, t = made.START_NS + k * made.SCAN_NS, 0.1 * k
        upto = int(np.searchsorted(stamps, start + made.SCAN_NS)) + 1
        if wheels is not None:
            for stamp in range(start, start + made.SCAN_NS, int(1e9 / RATE_HZ)):
                node.add_wheels(wheels.sample(drive, stamp + 3_000_000, wheel_rng))
        node.add_imu(ImuSamples(stamps[done:upto], noisy[done:upto, :3], noisy[done:upto, 3:]))
        done = upto
        if k >= 2 and t < service.until_s:
            node.on_odometry(replies[k - 2])
        motion = node.motion_over(start, start + made.SCAN_NS)
        if k == 0:
            T_map_odom = se3.compose(se3.level_rotation(-motion.gravity_lidar), np.zeros(3)) @ se3.inv(T_first)
        T_true = drive.T_odom_imu(t) @ T_imu_lidar
        seen, unobserved = T_map_odom @ T_true, np.zeros((0, 6))
        if t >= service.blind_s:
            way = T_map_odom[:3, :3] @ (drive.T_odom_imu(t + 1e-3)[:3, 3] - drive.T_odom_imu(t - 1e-3)[:3, 3])
            way /= np.linalg.norm(way)
            seen = _blind(T_map_lidar @ motion.T_prev_lidar, seen, way)
            unobserved = np.concatenate([np.zeros(3), seen[:3, :3].T @ way])[None]
        T_map_lidar = seen.copy()
        seen[:3, 3] += rng.normal(0, service.noise_m, 3)
        state = 3 if len(unobserved) else 2
        replies.append(OdometryReply(k + 1, start, seen, np.eye(4), np.eye(6) * 1e-4, state, unobserved))
        T_odom = node.T_odom_lidar_at(start)
        if t <= since_s:
            reference = T_odom @ se3.inv(T_true)
        else:
            played.drift_m[t] = T_imu_lidar[:3, :3] @ (se3.inv(T_true) @ se3.inv(reference) @ T_odom)[:3, 3]
            step = se3.inv(drive.T_odom_imu(t - 0.1) @ T_imu_lidar) @ T_true
            played.motion_m[t] = float(np.linalg.norm((se3.inv(step) @ motion.T_prev_lidar)[:3, 3]))
            played.sigma_m[t] = float(np.sqrt(motion.covariance[3, 3]))
    return played


def _blind(predicted: np.ndarray, true: np.ndarray, way: np.ndarray) -> np.ndarray:
    """The true pose, but along the unit vector `way` (3,) it is where the prediction says."""
    T = true.copy()
    T[:3, 3] += way * float(way @ (predicted[:3, 3] - true[:3, 3]))
    return T
