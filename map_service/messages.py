"""Between protobuf messages and the records of the pipeline."""

from __future__ import annotations

import math

import numpy as np

from map_service.types import MapAnswer
from splitslam import se3
from splitslam.scan import GnssFix
from splitslam.wire import session_pb2 as pb
from splitslam.wire import types_pb2 as types_pb

_HIGHEST_M = 1e5  # of a fix: one far beyond, as a session's first, would leave nothing of all that come after it


def transform_to_wire(T: np.ndarray) -> types_pb.Transform:
    """(4, 4) -> Transform."""
    qx, qy, qz, qw = (float(v) for v in se3.quat_from_matrix(T[:3, :3]))
    tx, ty, tz = (float(v) for v in T[:3, 3])
    return types_pb.Transform(tx_m=tx, ty_m=ty, tz_m=tz, qx=qx, qy=qy, qz=qz, qw=qw)


def transform_from_wire(m: types_pb.Transform) -> np.ndarray:
    """Transform -> (4, 4)."""
    return se3.from_quat(np.array([m.tx_m, m.ty_m, m.tz_m]), np.array([m.qx, m.qy, m.qz, m.qw]))


def stamped_pose(seq: int, stamp_ns: int, T: np.ndarray) -> types_pb.StampedPose:
    return types_pb.StampedPose(seq=seq, stamp_ns=stamp_ns, pose=transform_to_wire(T))


def odometry(answer: MapAnswer) -> pb.Odometry:
    """The pipeline's answer; applied_seq and durable_seq are the session's to fill."""
    message = pb.Odometry(
        seq=answer.seq,
        stamp_ns=answer.stamp_ns,
        pose_map_lidar=transform_to_wire(answer.T_map_lidar),
        pose_map_odom=transform_to_wire(answer.T_map_odom),
        covariance=answer.covariance.ravel().tolist(),
        state=int(answer.state),  # type: ignore[arg-type]
        degenerate_axes=np.asarray(answer.degenerate_axes, dtype=float).ravel().tolist(),
        keyframe=answer.keyframe,
        map_version=answer.map_version,
    )
    if answer.correction is not None:
        message.correction.cause = int(answer.correction.cause)  # type: ignore[assignment]
        message.correction.translation_m = answer.correction.translation_m
        message.correction.rotation_rad = answer.correction.rotation_rad
    return message


def refusal_word(refused: pb.Refused) -> str:
    """Its reason as a word: `overloaded`, `bad_hello`, ..."""
    return pb.RefusedReason.Name(refused.reason).removeprefix("REFUSED_REASON_").lower()


def fixes_from_wire(messages: list[types_pb.GnssFix]) -> tuple[list[GnssFix], int]:
    """Fixes that can be used, and how many could not."""
    fixes = [_fix(m) for m in messages if _usable(m)]
    return fixes, len(messages) - len(fixes)


def _usable(m: types_pb.GnssFix) -> bool:
    values = [m.latitude_deg, m.longitude_deg, m.altitude_m, *m.covariance_enu_m2]
    return (
        all(math.isfinite(v) for v in values)
        and abs(m.latitude_deg) <= 90
        and abs(m.longitude_deg) <= 180
        and abs(m.altitude_m) <= _HIGHEST_M
        and len(m.covariance_enu_m2) in (0, 9)
    )


def _fix(m: types_pb.GnssFix) -> GnssFix:
    covariance = np.array(m.covariance_enu_m2).reshape(3, 3) if m.covariance_enu_m2 else None
    return GnssFix(m.stamp_ns, m.latitude_deg, m.longitude_deg, m.altitude_m, covariance, m.status)
