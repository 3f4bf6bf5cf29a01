"""All robots at a glance: who needs help?"""

from __future__ import annotations

from deploy.grafana.boards.panel import Board, Panel, Query, Row, lines, number
from deploy.grafana.boards.promql import events, quantile, rate, total

_UPLINK = f"8 * {rate('splitslam_edge_tcp_sent_bytes_total', by='robot')}"
_ROUND_TRIP = quantile(0.99, "splitslam_edge_round_trip_seconds", by="robot")
_STATE = "max by (robot) (splitslam_edge_state)"
_KEPT = total("splitslam_edge_buffer_frames", by="robot")


def _last_hour(name: str) -> str:
    return events(name, by="robot", window="1h")


NOW = Row(
    "Now",
    (
        number("Robots reached", "Edge agents that answer Prometheus.", 'sum(up{job="edge-agent"})'),
        number(
            "Robots silent",
            "Edge agents that do not: switched off, without network, or dead.",
            'sum(up{job="edge-agent"} == bool 0)',
            warn=1,
            fault=True,
        ),
        number(
            "Tracking",
            "Share of the reached robots whose pose is good and anchored in the map.",
            "avg(splitslam_edge_state == bool 2)",
            unit="percentunit",
            warn=0.999,
            bad=0.9,
            low=True,
        ),
        number(
            "Without a pose",
            "Sessions that are lost or look for themselves in the map. Their robots must not use the pose.",
            total("splitslam_map_sessions", 'state=~"lost|localising"'),
            bad=1,
            fault=True,
        ),
        number(
            "On their own",
            "Robots without answers of the map service: by their own odometry, which drifts.",
            total("splitslam_edge_alone"),
            warn=1,
            fault=True,
        ),
        number(
            "Scans mapped",
            "All robots together.",
            rate("splitslam_map_frames_total", 'result="mapped"'),
            unit="cps",
        ),
        number(
            "Answer, p99",
            "Frame received to answer sent, all replicas.",
            quantile(0.99, "splitslam_map_answer_seconds"),
            unit="s",
            warn=0.1,
            bad=0.5,
        ),
        number(
            "Replicas",
            "Map services that answer Prometheus.",
            'sum(up{job="map-service"})',
            warn=2,
            bad=1,
            low=True,
        ),
    ),
    height=4,
)

ROBOTS = Row(
    "Every robot",
    (
        Panel(
            "State",
            "As the robot's own computer has it. Unanchored: the map service does not answer, or catches up.",
            (Query(_STATE, "{{robot}}"),),
            "states",
            width=24,
        ),
        Panel(
            "Robots",
            "One line each; the name leads to the robot's own page.",
            (
                Query(_STATE, "state", unit="state"),
                Query(_ROUND_TRIP, "round trip p99", unit="s", warn=0.15, bad=0.5),
                Query(_UPLINK, "uplink", unit="bps"),
                Query(_KEPT, "frames kept", warn=25, bad=300),
                Query(_last_hour("splitslam_edge_dropped_total"), "lost, 1 h", bad=0.5),
                Query(_last_hour("splitslam_edge_reconnects_total"), "breaks, 1 h", warn=10, bad=60),
                Query(_last_hour("splitslam_edge_outage_seconds_total"), "alone, 1 h", unit="s", warn=5, bad=60),
            ),
            "table",
            key="robot",
            link="splitslam-robot",
            width=24,
        ),
    ),
)

LINKS = Row(
    "Links",
    (
        lines(
            "Uplink",
            "TCP payload that each robot sends, by its kernel's count.",
            Query(_UPLINK, "{{robot}}"),
            unit="bps",
            width=8,
        ),
        lines(
            "Round trip, p99",
            "Frame handed to the uplink until its answer. Beyond 0.5 s a robot goes by its own odometry.",
            Query(_ROUND_TRIP, "{{robot}}"),
            unit="s",
            warn=0.15,
            bad=0.5,
            width=8,
        ),
        lines(
            "Streams that broke",
            "Each costs a moment; many mean bad radio, or replicas that come and go.",
            Query(events("splitslam_edge_reconnects_total", by="robot"), "{{robot}}"),
            fault=True,
            width=8,
        ),
    ),
)

LOSSES = Row(
    "Kept and lost",
    (
        lines(
            "Frames kept",
            "Not yet durable at the map service: a few always are. Falls by itself when the link is back.",
            Query(_KEPT, "{{robot}}"),
            warn=25,
            bad=300,
            width=8,
        ),
        lines(
            "Lost",
            "Scans, messages and frames that are gone for good. The robot's page says why.",
            Query(events("splitslam_edge_dropped_total", by="robot"), "{{robot}}"),
            fault=True,
            width=8,
        ),
        lines(
            "Versions",
            "Programs by version: more than one for longer than a roll-out takes has been forgotten somewhere.",
            Query("count by (job, version) (splitslam_build_info)", "{{job}} {{version}}"),
            kind="stacked",
            width=8,
        ),
    ),
)

FLEET = Board(
    "splitslam-fleet",
    "SplitSLAM: fleet",
    "All robots at a glance: who needs help?",
    (NOW, ROBOTS, LINKS, LOSSES),
)
