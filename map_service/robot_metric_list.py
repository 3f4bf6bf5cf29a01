"""Gauges by robot, with `metrics.per_robot: true` only: their label is what robots are called."""

from __future__ import annotations

from splitslam.metrics.definition import Label, Metric, gauge

_ROBOT = Label("robot", bound="robots with a session here, at most `metrics.robots`")

STATE = gauge(
    "splitslam_map_robot_state",
    "Tracking state of a robot's session, the numbers of TrackingState; 0: it has no stream",
    "5, 6: the robot cannot use its pose.",
    _ROBOT,
)
ANSWER_AGE = gauge(
    "splitslam_map_robot_answer_age_seconds",
    "Since its last frame was answered",
    "The robot stands still without scans, or its link is gone.",
    _ROBOT,
)
QUEUE = gauge(
    "splitslam_map_robot_queue_frames",
    "Its frames that wait here for an answer",
    "At the window: the worker is behind.",
    _ROBOT,
)
BACKLOG = gauge(
    "splitslam_map_robot_backlog_frames",
    "Frames that wait on the robot, as it says itself",
    "It catches up after an outage, or its uplink's budget is too small.",
    _ROBOT,
)
SCANS = gauge(
    "splitslam_map_robot_scans", "Scans mapped in its session", "Stands: see `robot_answer_age_seconds`.", _ROBOT
)
SESSION_AGE = gauge(
    "splitslam_map_robot_session_age_seconds",
    "Since its session came into memory here",
    "Small again and again: it moves.",
    _ROBOT,
)
UNDURABLE = gauge(
    "splitslam_map_robot_undurable_frames", "Its frames that are applied and not durable yet", "The store.", _ROBOT
)
POSITION_SIGMA = gauge(
    "splitslam_map_robot_position_sigma_metres",
    "Standard deviation of T_map_lidar's position along its worst axis",
    "Grows with new ground; falls at a loop or a fix.",
    _ROBOT,
)
ROTATION_SIGMA = gauge("splitslam_map_robot_rotation_sigma_radians", "The same of its rotation", "As above.", _ROBOT)
NOT_SHOWN = gauge(
    "splitslam_map_robots_not_shown",
    "Robots beyond `metrics.robots`, which have no series",
    "Above 0: raise the limit, if Prometheus can bear it.",
)

ROBOT_METRICS = tuple(value for value in tuple(globals().values()) if isinstance(value, Metric))
