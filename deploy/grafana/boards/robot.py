"""One robot from its sensors to its link: what is wrong with it?"""

from __future__ import annotations

from deploy.grafana.boards.panel import Board, Panel, Query, Row, Variable, lines, number
from deploy.grafana.boards.promql import events, mean, quantile, quantiles, rate

_THIS = 'robot="$robot"'


def _now(name: str, by: str = "") -> str:
    return f"max{f' by ({by}) ' if by else ''}({name}{{{_THIS}}})"


def _events(name: str, label: str) -> Query:
    return Query(events(name, _THIS, label), f"{{{{{label}}}}}")


NOW = Row(
    "Now",
    (
        Panel(
            "State",
            "As the robot's own computer has it. Unanchored: the map service does not answer, or catches up.",
            (Query(_now("splitslam_edge_state"), "state"),),
            "states",
            width=12,
        ),
        number(
            "Round trip, p99",
            "Frame handed to the uplink until its answer.",
            quantile(0.99, "splitslam_edge_round_trip_seconds", _THIS),
            unit="s",
            warn=0.15,
            bad=0.5,
        ),
        number(
            "Uplink",
            "TCP payload sent, by the kernel's count.",
            f"8 * {rate('splitslam_edge_tcp_sent_bytes_total', _THIS)}",
            unit="bps",
        ),
        number(
            "Spool",
            "Share of its room that is taken; at three quarters the least missed frames go.",
            f"{_now('splitslam_edge_spool_bytes')} / {_now('splitslam_edge_spool_limit_bytes')}",
            unit="percentunit",
            warn=0.5,
            bad=0.75,
        ),
        number(
            "Setup",
            "What the robot file and the first seconds do not agree on; the agent's log says what.",
            _now("splitslam_edge_check_problems"),
            warn=1,
            fault=True,
        ),
    ),
    height=4,
)

SENSORS = Row(
    "Sensors",
    (
        lines(
            "Silence",
            "Since the last message of each sensor. More than a few periods: cable, driver, power.",
            Query(_now("splitslam_edge_sensor_silent_seconds", "stream"), "{{stream}}"),
            unit="s",
            warn=0.5,
            bad=2.0,
        ),
        lines(
            "IMU gaps",
            "Times without samples that interpolation cannot bridge, scans that went without, node begun anew.",
            Query(events("splitslam_edge_imu_gaps_total", _THIS), "gaps"),
            Query(events("splitslam_edge_uncovered_scans_total", _THIS), "scans without"),
            Query(events("splitslam_edge_imu_resets_total", _THIS), "begun anew"),
            fault=True,
        ),
        lines(
            "Clock steps",
            "Of each sensor's clock, or restarts of its driver. They do not reach the run.",
            _events("splitslam_edge_clock_steps_total", "stream"),
            fault=True,
        ),
        lines(
            "Deskew without its logic",
            "Scans done on the CPU for want of an answer of the programmable logic; points that cannot be moved.",
            _events("splitslam_edge_deskew_troubles_total", "cause"),
            fault=True,
        ),
    ),
)

SCANS = Row(
    "Scans",
    (
        lines(
            "Scans",
            "How far they come: read, sent and mapped should be one line.",
            Query(rate("splitslam_edge_scans_total", _THIS, "result"), "{{result}}"),
            unit="cps",
        ),
        lines(
            "CPU time a scan",
            "Mean thread CPU time of each stage.",
            Query(mean("splitslam_edge_stage_seconds", f'{_THIS},stage!="total"', "stage"), "{{stage}}"),
            unit="s",
            kind="stacked",
        ),
        lines(
            "Age of a scan when sent",
            "Since it came from its driver. After an outage: as long as that was, until all is sent.",
            *quantiles("splitslam_edge_scan_age_seconds", _THIS),
            unit="s",
            warn=0.3,
            bad=1.0,
        ),
        lines(
            "Waiting to be processed",
            "Sensor messages read. Grows: the computer is too slow, or busy with something else.",
            Query(_now("splitslam_edge_queue_events"), "messages"),
        ),
    ),
)

LINK = Row(
    "Link",
    (
        lines(
            "Uplink by kind",
            "Serialized messages, and the budget where there is one.",
            Query(f"8 * {rate('splitslam_edge_uplink_bytes_total', _THIS, 'kind')}", "{{kind}}"),
            Query(f"8 * {_now('splitslam_edge_uplink_limit_bytes_per_second')}", "budget"),
            unit="bps",
        ),
        lines(
            "Features withheld",
            "For want of room in the uplink's budget, a second.",
            Query(rate("splitslam_edge_withheld_points_total", _THIS), "points"),
            unit="cps",
            fault=True,
        ),
        lines(
            "Round trip",
            "Frame handed to the uplink until its answer.",
            *quantiles("splitslam_edge_round_trip_seconds", _THIS),
            unit="s",
            warn=0.15,
            bad=0.5,
        ),
        lines(
            "Streams that broke",
            "By who or what ended them: the agent's own watch, the service, the network.",
            _events("splitslam_edge_reconnects_total", "cause"),
            fault=True,
        ),
    ),
)

ALONE = Row(
    "Without the map service",
    (
        lines(
            "By its own odometry",
            "Share of the time.",
            Query(rate("splitslam_edge_outage_seconds_total", _THIS), "share of the time"),
            Query(_now("splitslam_edge_alone"), "now"),
            unit="percentunit",
            fault=True,
        ),
        lines(
            "Scans placed by it",
            "failed: nothing to hold on to; the IMU carries the pose, and drift grows fast.",
            Query(rate("splitslam_edge_odometry_scans_total", _THIS, "result"), "{{result}}"),
            unit="cps",
            fault=True,
        ),
        lines(
            "Frames kept",
            "Not yet durable at the map service: a few always are; on disk, those that survive the agent's end.",
            Query(_now("splitslam_edge_buffer_frames"), "kept"),
            Query(_now("splitslam_edge_spool_frames"), "on disk"),
            warn=25,
            bad=300,
        ),
        lines(
            "Disk of the spool",
            "What it did not do, what was damaged on it, what the service refused for good.",
            _events("splitslam_edge_spool_errors_total", "kind"),
            fault=True,
        ),
    ),
)

LOSSES = Row(
    "Lost",
    (
        lines(
            "Lost, by reason",
            "Scans, messages of other sensors (imu_, wheel_, gnss_), frames (buffer_full, spool_damaged, rejected_).",
            _events("splitslam_edge_dropped_total", "reason"),
            kind="stacked",
            fault=True,
            width=12,
        ),
        lines(
            "Corrections of the map",
            "Jumps of T_map_odom by cause. relocalise: the robot was lost. outage: drift of its own odometry.",
            _events("splitslam_edge_corrections_total", "cause"),
            width=12,
        ),
    ),
)

ROBOT = Board(
    "splitslam-robot",
    "SplitSLAM: one robot",
    "One robot from its sensors to its link: what is wrong with it?",
    (NOW, SENSORS, SCANS, LINK, ALONE, LOSSES),
    (Variable("robot", "robot", "splitslam_edge_state", "robot", multi=False),),
)
