"""Records that pass between the edge's pipeline, its Imu node and its uplink."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from splitslam import se3
from splitslam.dense_cloud import WholeScan
from splitslam.features import FeatureFrame, Motion
from splitslam.scan import GnssFix


@dataclass(frozen=True, slots=True, eq=False)
class OdometryReply:
    """The map service's answer to frame `seq`, as the Imu node reads it.

    T_map_lidar, T_map_odom: (4, 4). covariance: (6, 6), right tangent, rotation first.
    degenerate_axes: (A, 6) unit directions, same tangent, that the features did not observe.
    rejected: why the frame was not mapped, or "".
    """

    seq: int
    stamp_ns: int
    T_map_lidar: NDArray[np.float64]
    T_map_odom: NDArray[np.float64]
    covariance: NDArray[np.float64]
    state: int
    degenerate_axes: NDArray[np.float64]
    rejected: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class OdomPoses:
    """IMU-rate poses T_odom_lidar out of the Imu node (one row a sample).

    stamps_ns: (M,) int64; positions_m: (M, 3); quats_xyzw: (M, 4); velocities_mps: (M, 3) in `odom`.
    """

    stamps_ns: NDArray[np.int64]
    positions_m: NDArray[np.float64]
    quats_xyzw: NDArray[np.float64]
    velocities_mps: NDArray[np.float64]

    @staticmethod
    def of(stamp_ns: int, T_odom_lidar: NDArray[np.float64]) -> OdomPoses:
        """One pose (4, 4), its velocity not known (NaN)."""
        quat = se3.quat_from_matrix(T_odom_lidar[:3, :3])
        return OdomPoses(np.array([stamp_ns]), T_odom_lidar[None, :3, 3], quat[None], np.full((1, 3), np.nan))


@dataclass(frozen=True, slots=True, eq=False)
class EncodedFrame:
    """A frame as it goes to the uplink.

    payload: splitslam.codec's bytes. stage_cpu_ms, stage_wall_ms: thread CPU and wall time by stage: deskew (projection
    included: the paper's Algorithm 1), motion (Imu node), features, encode, total. corners, surfs: points in it.
    features: the same without a budget, for the edge's own odometry. scan: all of it, of a dense frame where whole
    scans are kept; None also where the motion that was removed from it is not known yet.
    """

    seq: int
    stamp_ns: int
    dense: bool
    payload: bytes
    fixes: tuple[GnssFix, ...]
    stage_cpu_ms: dict[str, float]
    stage_wall_ms: dict[str, float]
    corners: int = 0
    surfs: int = 0
    features: FeatureFrame | None = None
    scan: WholeScan | None = None


class MotionSource(Protocol):
    """What the pipeline needs of the Imu node or of its stand-in for robots without an IMU."""

    def motion_over(self, start_ns: int, end_ns: int) -> Motion:
        """The motion since the scan asked for before, and inside the scan from start to end."""
        ...
