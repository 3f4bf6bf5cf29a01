"""From the wire's messages to what is shown."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from splitslam import se3
from splitslam.enums import value_name
from splitslam.view.records import Array, Correction, Features, Points, ScanShown
from splitslam.wire import session_pb2 as pb
from splitslam.wire import types_pb2 as types
from splitslam.wire import view_pb2


def scan_shown(message: view_pb2.ScanSeen, answer_ms: float) -> ScanShown:
    """Raises ValueError for arrays that do not fit each other."""
    answer = message.answer
    return ScanShown(
        stamp_ns=answer.stamp_ns,
        T_map_lidar=transform(answer.pose_map_lidar),
        state=state_word(answer.state),
        keyframe=message.keyframe,
        covariance=np.array(answer.covariance).reshape(6, 6) if answer.covariance else None,
        features=features(message),
        correction=_correction(answer) if answer.HasField("correction") else None,
        frame_bytes=message.frame_bytes,
        answer_ms=answer_ms or float("nan"),
        registration_ms=message.registration_ms,
    )


def features(message: view_pb2.ScanSeen) -> Features:
    """Raises ValueError."""
    found = Features(
        points(message.corners_lidar),
        points(message.surfs_lidar),
        points(message.corner_matches_lidar),
        points(message.surf_matches_lidar),
    )
    pairs = (found.corners_lidar, found.corner_matches_lidar), (found.surfs_lidar, found.surf_matches_lidar)
    for of, matches in pairs:
        if len(of) != len(matches):
            raise ValueError(f"{len(matches)} matches of {len(of)} features")
    return found


def keyframe_poses(message: view_pb2.MapSeen) -> dict[int, Array]:
    """T_map_lidar (4, 4) by keyframe. Raises ValueError."""
    rows = np.frombuffer(message.poses_map_lidar, "<f4").reshape(-1, 3, 4)
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3] = rows
    return dict(zip(message.keyframes, poses, strict=True))


def points(data: bytes) -> Points:
    """(N, 3) float32. Raises ValueError for a number of bytes that is none of points."""
    return np.frombuffer(data, "<f4").reshape(-1, 3)


def points_and_intensity(data: bytes) -> NDArray[np.float32]:
    """(N, 4) float32. Raises ValueError."""
    return np.frombuffer(data, "<f4").reshape(-1, 4)


def transform(message: types.Transform) -> Array:
    """(4, 4). Raises ValueError for numbers that are no pose."""
    quat = np.array([message.qx, message.qy, message.qz, message.qw])
    if not abs(np.linalg.norm(quat) - 1.0) < 1e-3 or not np.isfinite([message.tx_m, message.ty_m, message.tz_m]).all():
        raise ValueError("no pose")
    return se3.from_quat(np.array([message.tx_m, message.ty_m, message.tz_m]), quat)


def state_word(state: int) -> str:
    return value_name(types.TrackingState, state, "TRACKING_STATE_")


def _correction(answer: pb.Odometry) -> Correction:
    cause = value_name(types.CorrectionCause, answer.correction.cause, "CORRECTION_CAUSE_")
    return Correction(cause, answer.correction.translation_m, answer.correction.rotation_rad)
