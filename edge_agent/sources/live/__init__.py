"""Sensors without ROS: their packets from the network and serial devices, as a Source."""

from __future__ import annotations

from edge_agent.metrics import EdgeMetrics
from edge_agent.sources.live.settings import LiveConfig
from edge_agent.sources.source import Source
from splitslam.errors import InputError
from splitslam.robot import Robot

__all__ = ["LiveConfig", "open_live"]


def open_live(config: LiveConfig, robot: Robot, metrics: EdgeMetrics) -> Source:
    """Opens every port. Raises InputError for one that is taken, or a robot file that does not fit."""
    raise InputError("source.live: not there yet")
