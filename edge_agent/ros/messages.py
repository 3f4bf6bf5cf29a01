"""What the agent publishes, as ROS messages: transforms, odometry, diagnostics. REP-103 units, REP-105 frames."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge_agent.ros.codec import DIAGNOSTICS, TF, Codec
from splitslam import se3

Array = NDArray[np.float64]
ODOMETRY = "nav_msgs/msg/Odometry"
OK, WARN, ERROR = 0, 1, 2
_ROS_ORDER = (3, 4, 5, 0, 1, 2)  # ours: rotation first; ROS: translation first


def transforms(codec: Codec, stamp_ns: int, edges: list[tuple[str, str, Array]]) -> Any:
    """tf2_msgs/TFMessage. edges: parent, child, T_parent_child (4, 4)."""
    stamped = []
    for parent, child, T in edges:
        vector = codec.make("geometry_msgs/msg/Vector3", *T[:3, 3].tolist())
        placed = codec.make("geometry_msgs/msg/Transform", vector, _quaternion(codec, T))
        header = codec.header(stamp_ns, parent)
        stamped.append(codec.make("geometry_msgs/msg/TransformStamped", header, child, placed))
    return codec.make(TF, stamped)


def odometry(
    codec: Codec, stamp_ns: int, frames: tuple[str, str], T: Array, pose_covariance: Array, twist: Array, doubt: Array
) -> Any:
    """nav_msgs/Odometry. frames: parent and child; T: (4, 4), T_parent_child.

    pose_covariance: (6, 6), right tangent, rotation first; it goes out about the parent's axes, translation first.
    twist: (6,), rotation first, rad/s and m/s, of the child in its own frame; doubt: its (6, 6) covariance.
    """
    R = T[:3, :3]
    turn = np.zeros((6, 6))
    turn[:3, :3] = turn[3:, 3:] = R
    point = codec.make("geometry_msgs/msg/Point", *T[:3, 3].tolist())
    pose = codec.make("geometry_msgs/msg/Pose", point, _quaternion(codec, T))
    covariance = _flat(turn @ pose_covariance @ turn.T)
    angular = codec.make("geometry_msgs/msg/Vector3", *twist[:3].tolist())
    linear = codec.make("geometry_msgs/msg/Vector3", *twist[3:].tolist())
    speeds = codec.make("geometry_msgs/msg/Twist", linear, angular)
    return codec.make(
        ODOMETRY,
        codec.header(stamp_ns, frames[0]),
        frames[1],
        codec.make("geometry_msgs/msg/PoseWithCovariance", pose, covariance),
        codec.make("geometry_msgs/msg/TwistWithCovariance", speeds, _flat(doubt)),
    )


def diagnostics(codec: Codec, stamp_ns: int, who: tuple[str, str], level: int, text: str, values: Mapping) -> Any:
    """diagnostic_msgs/DiagnosticArray of one status. who: node and hardware id."""
    pairs = [codec.make("diagnostic_msgs/msg/KeyValue", str(key), str(value)) for key, value in values.items()]
    node, hardware = who
    status = codec.make("diagnostic_msgs/msg/DiagnosticStatus", level, f"{node}: tracking", text, hardware, pairs)
    return codec.make(DIAGNOSTICS, codec.header(stamp_ns, ""), [status])


def _quaternion(codec: Codec, T: Array) -> Any:
    return codec.make("geometry_msgs/msg/Quaternion", *se3.quat_from_matrix(T[:3, :3]).tolist())


def _flat(covariance: Array) -> Array:
    """(6, 6), rotation first -> (36,), translation first, row by row."""
    return covariance[np.ix_(_ROS_ORDER, _ROS_ORDER)].reshape(36)
