"""The agent's own topics. They are there as soon as the graph is joined: who listens has found them before a pose."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Mapping

from edge_agent.ros import messages
from edge_agent.ros.codec import DIAGNOSTICS, TF
from edge_agent.ros.connect import GraphClock
from edge_agent.ros.graph import RELIABLE, TRANSFORMS, Graph, in_namespace
from edge_agent.ros.settings import GraphSettings, RosSettings
from splitslam.logs import fields

_log = logging.getLogger(__name__)


class Outlets:
    """tf: name of the topic of transforms, in full. send_tf, send_odometry: publish an encoded message."""

    def __init__(self, graph: Graph, node: GraphSettings, settings: RosSettings, robot_id: str) -> None:
        self.graph, self._codec = graph, graph.codec
        self._who = node.node, robot_id
        self._now_ns = GraphClock(graph, node.use_sim_time)
        self.tf, odometry = (in_namespace(name, node.namespace) for name in (settings.tf, settings.odometry))
        self.send_tf = graph.advertise(self.tf, TF, TRANSFORMS)
        self.send_odometry = graph.advertise(odometry, messages.ODOMETRY, RELIABLE)
        self._send_diagnostics = graph.advertise("/diagnostics", DIAGNOSTICS, RELIABLE)

    def say(self, text: str, level: int, values: Mapping[str, object]) -> None:
        """One message of diagnostics, stamped now."""
        message = messages.diagnostics(self._codec, self._now_ns(), self._who, level, text, values)
        self._send_diagnostics(self._codec.encode(message))

    def waiting(self, missing: str) -> None:
        """That the agent has not begun, for want of this; the wait goes on where nobody can be told."""
        try:
            self.say(f"waiting for {missing}", messages.WARN, {})
        except Exception as error:
            note_not_sent(error, self.graph.lost)


def note_not_sent(error: Exception, dropped: Counter[str]) -> None:
    """A middleware that fails (each has errors of its own) costs a message, which is counted; the first is logged."""
    if not dropped["ros_not_sent"]:
        _log.warning("message not sent to ROS", extra=fields(problem=" ".join(f"{error}".split())))
    dropped["ros_not_sent"] += 1
