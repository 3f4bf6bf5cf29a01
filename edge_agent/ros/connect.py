"""Joins a graph, in the way that the configuration names and this machine has."""

from __future__ import annotations

import importlib.util
import threading
import time

from edge_agent.ros.codec import CLOCK
from edge_agent.ros.graph import SAMPLES, Graph
from edge_agent.ros.settings import GraphSettings, Ros1Settings, Ros2Settings
from splitslam.errors import DataError, InputError


def join(settings: GraphSettings, stop: threading.Event) -> Graph:
    """Raises InputError (one line) when what it goes through is not installed, or no master is there in time.

    stop: ends the wait for a master, with StoppedError.
    """
    if isinstance(settings, Ros1Settings):
        from edge_agent.ros.rospy_graph import RospyGraph

        return RospyGraph(settings, stop)
    assert isinstance(settings, Ros2Settings)
    if settings.via == "rclpy" or (settings.via == "auto" and importlib.util.find_spec("rclpy") is not None):
        from edge_agent.ros.rclpy_graph import RclpyGraph

        return RclpyGraph(settings)
    if importlib.util.find_spec("cyclonedds") is None:
        raise InputError("ros2: neither rclpy nor cyclonedds is there: expected a sourced ROS 2, or splitslam[ros2]")
    from edge_agent.ros.dds.graph import DdsGraph

    return DdsGraph(settings)


class GraphClock:
    """The graph's time: the machine's, or what /clock says when time is simulated."""

    def __init__(self, graph: Graph, simulated: bool) -> None:
        self._codec = graph.codec
        self._simulated_ns = 0 if simulated else None
        if simulated:
            graph.subscribe("/clock", CLOCK, SAMPLES, self._on_clock)

    def _on_clock(self, raw: bytes) -> None:
        try:
            clock = self._codec.decode(raw, CLOCK).clock
        except DataError:
            return  # the next one comes
        self._simulated_ns = clock.sec * 1_000_000_000 + clock.nanosec

    def __call__(self) -> int:
        """Now, ns; 0 before the first /clock."""
        return time.time_ns() if self._simulated_ns is None else self._simulated_ns
