"""The keyframes that a session's map has moved since a version that somebody knows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from sqlalchemy import Connection, select

from map_service import schema
from map_service.event_messages import map_move
from map_service.history import unpack_poses
from map_service.messages import transform_to_wire
from map_service.packing import unpack_pose
from splitslam.wire import pose_pb2 as pb

_PAGE = 500
# m, and in entries of the rotation: finer than the store writes keyframes again
_MOVED = np.where(np.arange(16).reshape(4, 4) % 4 == 3, 5e-4, 5e-5)


@dataclass(frozen=True, slots=True)
class KnownMap:
    """A session, the version that somebody has its keyframes in, and the one they are in now."""

    key: int
    session_id: str
    version: int
    newest: int


def moved_keyframes(connection: Connection, known: KnownMap) -> list[pb.MovedKeyframes]:
    """Where those that moved are now, in messages of at most 500; all of them when the known version is forgotten.

    Raises DataError.
    """
    v, k = schema.map_versions, schema.keyframes
    query = select(v.c.poses).where(v.c.session == known.key, v.c.version == known.version + 1)
    then = connection.execute(query).scalar()
    poses_then = unpack_poses(then) if then is not None else np.zeros((0, 4, 4))
    query = select(v).where(v.c.session == known.key, v.c.version == known.newest)
    row = connection.execute(query).first()
    if row is None:  # so many have begun since that not even this is kept
        return []
    move = map_move(row.version, row.first_seq, row.cause, row.translation_m, row.rotation_rad)
    query = select(k.c.keyframe, k.c.seq, k.c.stamp_ns, k.c.pose_map_lidar).where(k.c.session == known.key)
    poses: list[pb.KeyframePose] = []
    for index, seq, stamp_ns, packed in connection.execute(query.order_by(k.c.keyframe)):
        T = unpack_pose(packed)
        if index >= len(poses_then) or (np.abs(T - poses_then[index]) > _MOVED).any():
            wire = transform_to_wire(T)
            poses.append(pb.KeyframePose(keyframe=index, seq=seq, stamp_ns=stamp_ns, pose_map_lidar=wire))
    firsts = range(0, max(len(poses), 1), _PAGE)
    return [
        pb.MovedKeyframes(
            session_id=known.session_id,
            move=move,
            keyframes=poses[first : first + _PAGE],
            more=first + _PAGE < len(poses),
        )
        for first in firsts
    ]
