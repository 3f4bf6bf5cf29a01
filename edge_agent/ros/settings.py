"""What the configuration says of ROS: the graph that the agent is a node of, and what it publishes there."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from splitslam.config import Model

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*(/[A-Za-z][A-Za-z0-9_]*)*")


def _name(name: str) -> str:
    if not _NAME.fullmatch(name):
        raise ValueError("expected a ROS name: letters, digits and _, not starting with a digit")
    return name


def _namespace(namespace: str) -> str:
    bare = namespace.strip("/")
    return _name(bare) if bare else ""


def _topic(topic: str) -> str:
    _name(topic.removeprefix("/"))
    return topic


def _frame(frame: str) -> str:
    bare = frame.lstrip("/")  # ROS 1 had a slash there once; tf2 refuses it
    if not bare or any(c.isspace() for c in bare):
        raise ValueError("expected a frame's name, such as base_link")
    return bare


Name = Annotated[str, AfterValidator(_name)]
Namespace = Annotated[str, AfterValidator(_namespace)]
Topic = Annotated[str, AfterValidator(_topic)]
Frame = Annotated[str, AfterValidator(_frame)]


class GraphSettings(Model):
    """A node in a ROS graph.

    namespace: usual topic names are looked for in it, relative ones are in it; "" is the root.
    use_sim_time: what the agent sends of itself is stamped by /clock. Sensors bring their own stamps either way.
    wait_s: how long the LiDAR (ROS 1: the master as well) may take to be there; null: for ever.
    end_after_s: the run ends when nothing has come for so long, as when a bag has been played; null: never.
    queue_bytes: of messages that wait to be decoded, while the agent starts; the oldest go first, and are counted.
    """

    node: Name = "splitslam"
    namespace: Namespace = ""
    use_sim_time: bool = False
    wait_s: Positive | None = None
    end_after_s: Positive | None = None
    queue_bytes: Annotated[int, Field(ge=2**20)] = 256 * 2**20


class Ros1Settings(GraphSettings):
    """master: null: $ROS_MASTER_URI. python_path: where rospy is, when the agent's own environment has none; null:
    Debian's place for Python packages."""

    master: str | None = None
    python_path: Path | None = None


class Ros2Settings(GraphSettings):
    """via: auto: rclpy where a ROS 2 is sourced, else CycloneDDS alone. domain_id: null: $ROS_DOMAIN_ID, else 0."""

    via: Literal["auto", "rclpy", "cyclonedds"] = "auto"
    domain_id: Annotated[int, Field(ge=0, le=232)] | None = None


class RosSettings(Model):
    """What the agent publishes, as REP-105 has it.

    publish: false: nothing. ros1, ros2: the graph, when the source is not in one; otherwise it is the source's.
    publish_odom_tf: true: `map -> odom` and `odom -> base_link`; false: another node owns `odom -> base_link`, and only
    `map -> odom` goes out, computed through it.
    odometry: topic of nav_msgs/Odometry. tf: topic of transforms, its `_static` sibling follows.
    rate_hz: of transforms and odometry; 0: every IMU sample. queue: samples that may wait to be sent.
    """

    publish: bool = True
    ros1: Ros1Settings | None = None
    ros2: Ros2Settings | None = None
    map_frame: Frame = "map"
    odom_frame: Frame = "odom"
    base_frame: Frame = "base_link"
    publish_odom_tf: bool = True
    odometry: Topic = "splitslam/odometry"
    tf: Topic = "/tf"
    rate_hz: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 50.0
    queue: Annotated[int, Field(ge=1)] = 100
    diagnostics_hz: Positive = 1.0

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.ros1 is not None and self.ros2 is not None:
            raise ValueError("expected at most one of ros1 and ros2")
        frames = (self.map_frame, self.odom_frame, self.base_frame)
        if len(set(frames)) < len(frames):
            raise ValueError(f"map_frame, odom_frame and base_frame: expected three names, found {', '.join(frames)}")
        return self
