"""Between the edge's own records and the messages of the session protocol."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from edge_agent.types import EncodedFrame, OdometryReply
from splitslam import se3
from splitslam.enums import value_name
from splitslam.scan import GnssFix
from splitslam.wire import session_pb2 as pb
from splitslam.wire import types_pb2 as types

WIRE_VERSION = 1
EDGE_ONLY = "wheels"  # a part to disable that the service has not, and that one of 0.1.0 refuses


@dataclass(frozen=True, slots=True)
class Answer:
    """One answer for the Imu node and what the outputs need besides.

    keyframe: a keyframe was made. correction_m, correction_cause: of a stated jump of T_map_odom; None, "" without.
    round_trip_s: from the frame's hand-over to the uplink to its answer.
    """

    reply: OdometryReply
    keyframe: bool
    correction_m: float | None
    round_trip_s: float
    correction_cause: str = ""


def state_name(state: int) -> str:
    """`tracking`, `lost`, ...; the number itself when a later service has another one."""
    return value_name(types.TrackingState, state, "TRACKING_STATE_")


def transform(T: NDArray[np.float64]) -> types.Transform:
    """(4, 4) -> message."""
    x, y, z, w = se3.quat_from_matrix(T[:3, :3])
    return types.Transform(tx_m=T[0, 3], ty_m=T[1, 3], tz_m=T[2, 3], qx=x, qy=y, qz=z, qw=w)


def matrix(message: types.Transform) -> NDArray[np.float64]:
    """Message -> (4, 4). Raises ValueError for what is no rigid transform."""
    t, q = (message.tx_m, message.ty_m, message.tz_m), (message.qx, message.qy, message.qz, message.qw)
    if not (all(map(math.isfinite, t)) and 0.9 < math.hypot(*q) < 1.1):  # also false for NaN
        raise ValueError("not a rigid transform")
    return se3.from_quat(t, q)


def frame_message(frame: EncodedFrame, codec_version: int) -> pb.Frame:
    """An encoded scan as it goes on the wire. Its trace id is left out: both sides make it from run and seq."""
    return pb.Frame(
        seq=frame.seq,
        stamp_ns=frame.stamp_ns,
        dense=frame.dense,
        codec_version=codec_version,
        payload=frame.payload,
        fixes=[_fix_message(fix) for fix in frame.fixes],
    )


def _fix_message(fix: GnssFix) -> types.GnssFix:
    return types.GnssFix(
        stamp_ns=fix.stamp_ns,
        latitude_deg=fix.latitude_deg,
        longitude_deg=fix.longitude_deg,
        altitude_m=fix.altitude_m,
        covariance_enu_m2=[] if fix.covariance_enu_m2 is None else fix.covariance_enu_m2.reshape(-1).tolist(),
        status=fix.status,
    )


def _said(message: pb.Odometry) -> tuple[NDArray[np.float64], ...]:
    """T_map_lidar, T_map_odom, covariance, degenerate axes; ValueError for what makes no sense."""
    covariance, axes = list(message.covariance), list(message.degenerate_axes)
    if not all(map(math.isfinite, covariance)) or not all(map(math.isfinite, axes)):
        raise ValueError("covariance or axes not finite")
    unknown = message.duplicate and not covariance
    return (
        matrix(message.pose_map_lidar),
        matrix(message.pose_map_odom),
        np.eye(6) if unknown else np.array(covariance).reshape(6, 6),
        np.array(axes).reshape(-1, 6),
    )


def _nothing() -> tuple[NDArray[np.float64], ...]:
    """The same of an answer that was rejected."""
    return np.eye(4), np.eye(4), np.eye(6), np.zeros((0, 6))


def answer(message: pb.Odometry, round_trip_s: float) -> Answer:
    """The server's answer. One that makes no sense counts as rejected, so that the Imu node never sees it.

    The repeated answer to a frame that only the store remembers has no covariance: it is known to 1 rad and 1 m then.
    """
    rejected = message.rejected
    try:
        T_map_lidar, T_map_odom, covariance, axes = _nothing() if rejected else _said(message)
    except ValueError:
        rejected = "corrupt_answer"
        T_map_lidar, T_map_odom, covariance, axes = _nothing()
    reply = OdometryReply(
        seq=message.seq,
        stamp_ns=message.stamp_ns,
        T_map_lidar=T_map_lidar,
        T_map_odom=T_map_odom,
        covariance=covariance,
        state=message.state,
        degenerate_axes=axes,
        rejected=rejected,
    )
    if message.correction.cause == types.CORRECTION_CAUSE_UNSPECIFIED:
        return Answer(reply, message.keyframe, None, round_trip_s)
    known = types.CorrectionCause.DESCRIPTOR.values_by_number.get(message.correction.cause)
    cause = "other" if known is None else known.name.removeprefix("CORRECTION_CAUSE_").lower()
    return Answer(reply, message.keyframe, message.correction.translation_m, round_trip_s, cause)
