"""The map service: is there room, are answers in time, is everything stored?"""

from __future__ import annotations

from deploy.grafana.boards.panel import Board, Query, Row, Variable, lines, number
from deploy.grafana.boards.promql import events, highest, mean, quantile, quantiles, rate, total

_HERE = 'instance=~"$replica"'
_WORKER = "{{instance}} {{worker}}"
_BLIND = rate("splitslam_map_registrations_total", f'{_HERE},result="degenerate"')
_ALL = rate("splitslam_map_registrations_total", _HERE)


def _events(name: str, label: str, legend: str = "", where: str = "") -> Query:
    return Query(events(name, f"{_HERE},{where}" if where else _HERE, label), legend or f"{{{{{label}}}}}")


NOW = Row(
    "Now",
    (
        number("Robots", "Streams that are open.", total("splitslam_map_streams", _HERE)),
        number(
            "Room taken",
            "Robots served, of those that may be.",
            f"{total('splitslam_map_streams', _HERE)} / {total('splitslam_map_session_limit', _HERE)}",
            unit="percentunit",
            warn=0.7,
            bad=0.9,
        ),
        number("Scans mapped", "A second.", rate("splitslam_map_frames_total", f'{_HERE},result="mapped"'), unit="cps"),
        number(
            "Answer, p99",
            "Frame received to answer sent.",
            quantile(0.99, "splitslam_map_answer_seconds", _HERE),
            unit="s",
            warn=0.1,
            bad=0.5,
        ),
        number(
            "Oldest frame",
            "How long it has waited for its answer.",
            highest("splitslam_map_oldest_frame_seconds", _HERE),
            unit="s",
            warn=0.2,
            bad=1.0,
        ),
        number(
            "Not yet durable",
            "Frames applied that the store does not have yet.",
            total("splitslam_map_undurable_frames", _HERE),
            warn=100,
            bad=1000,
        ),
        number(
            "Replicas",
            "Alive, as the store has it; 0: the store is not shared.",
            highest("splitslam_map_replicas", _HERE),
        ),
        number("Workers ready", "Warm, all replicas together.", total("splitslam_map_workers_ready", _HERE)),
    ),
    height=4,
)

ANSWERS = Row(
    "Answers",
    (
        lines(
            "Frame received to answer",
            "All replicas that are chosen.",
            *quantiles("splitslam_map_answer_seconds", _HERE),
            unit="s",
            warn=0.1,
            bad=0.5,
        ),
        lines(
            "CPU time a frame",
            "Mean thread CPU time; graph: loops, GNSS and rebuilds of the local map included.",
            Query(mean("splitslam_map_stage_seconds", _HERE, "stage"), "{{stage}}"),
            unit="s",
            kind="stacked",
        ),
        lines(
            "Frames waiting",
            "By worker. One far above the others: one robot's long job.",
            Query(total("splitslam_map_queue_frames", _HERE, "instance, worker"), _WORKER),
            warn=25,
            bad=100,
        ),
        lines(
            "CPU of the workers",
            "Near one core a worker there is no room for more robots.",
            Query(rate("splitslam_map_worker_cpu_seconds_total", _HERE, "instance, worker"), _WORKER),
            unit="percentunit",
            warn=0.7,
            bad=0.9,
        ),
    ),
)

ROBOTS = Row(
    "Robots",
    (
        lines(
            "Sessions by state",
            "In memory. detached: their robot has gone without Bye.",
            Query(total("splitslam_map_sessions", _HERE, "state"), "{{state}}"),
            kind="stacked",
        ),
        lines(
            "Without a pose",
            "Sessions that are lost or look for themselves in the map.",
            Query(total("splitslam_map_sessions", f'{_HERE},state=~"lost|localising"', "state"), "{{state}}"),
            bad=1,
            fault=True,
        ),
        lines(
            "Frames not mapped",
            "rejected: by reason beside. missing: lost by the robot. gap, failed: the stream was ended.",
            _events("splitslam_map_frames_total", "result", where='result!~"mapped|duplicate"'),
            fault=True,
        ),
        lines(
            "Frames rejected",
            "corrupt: link or memory. codec_version: an agent newer than the service. time: the robot's clock.",
            _events("splitslam_map_rejected_total", "reason"),
            fault=True,
        ),
    ),
)

MAPPING = Row(
    "Mapping",
    (
        lines(
            "Scans that see too little",
            "Share of scans with a direction that nothing observes: tunnels, halls, fog, a covered sensor.",
            Query(f"{_BLIND} / {_ALL}", "degenerate"),
            unit="percentunit",
            warn=0.2,
            bad=0.5,
            fault=True,
        ),
        lines(
            "Steps of the solver",
            "For one registration: more of them, worse predictions.",
            *quantiles("splitslam_map_registration_iterations", _HERE)[::2],
            width=3,
        ),
        lines(
            "Inliers",
            "Median share of features that fit the map. Falls: a changed site, or a wrong pose.",
            Query(quantile(0.5, "splitslam_map_registration_inlier_ratio", _HERE), "p50"),
            unit="percentunit",
            width=3,
        ),
        lines(
            "Loop closures",
            "Durable ones: accepted, or why not.",
            _events("splitslam_map_loops_total", "result"),
            width=4,
        ),
        lines(
            "GNSS fixes",
            "Durable ones: accepted, or why not. spacing: more than are needed.",
            Query(rate("splitslam_map_gnss_total", _HERE, "result"), "{{result}}"),
            unit="cps",
            width=4,
        ),
        lines(
            "Corrections",
            "Jumps of T_map_odom, by cause. relocalise: robots that were lost.",
            _events("splitslam_map_corrections_total", "cause"),
            width=4,
        ),
    ),
)

STORE = Row(
    "Store",
    (
        lines(
            "Commits",
            "How long each takes, tries included.",
            *quantiles("splitslam_map_commit_seconds", _HERE),
            unit="s",
            warn=0.2,
            bad=1.0,
        ),
        lines(
            "Commits that failed",
            "retried: the store did not take them yet. fenced: another owner has the session.",
            _events("splitslam_map_commits_total", "result", where='result!="ok"'),
            fault=True,
        ),
        lines(
            "Written",
            "Bytes that commits add, without the database's own overhead.",
            Query(rate("splitslam_map_commit_bytes_sum", _HERE, "instance"), "{{instance}}"),
            unit="Bps",
        ),
        lines(
            "Database",
            "As it lies on disk, and what the sites with a quota have stored.",
            Query(highest("splitslam_map_database_bytes", _HERE), "database"),
            Query(highest("splitslam_map_store_bytes", _HERE, "site"), "site {{site}}"),
            unit="bytes",
        ),
    ),
)

REPLICAS = Row(
    "Replicas",
    (
        lines(
            "Robots by replica",
            "Even, a few seconds after a replica has come or gone.",
            Query(total("splitslam_map_streams", _HERE, "instance"), "{{instance}}"),
            kind="stacked",
            width=4,
        ),
        lines(
            "Refused",
            "overloaded: capacity. store: the database. others: the robot's configuration.",
            _events("splitslam_map_refused_total", "reason"),
            fault=True,
            width=5,
        ),
        lines(
            "Callers turned away",
            "Who may not, by reason: strangers, robots of another name. streams, opens: one robot that floods.",
            _events("splitslam_map_auth_refused_total", "reason"),
            fault=True,
            width=5,
        ),
        lines(
            "Moved and fenced",
            "Robots sent to another replica, and sessions given up because another owns them.",
            _events("splitslam_map_drained_total", "reason", "sent on: {{reason}}"),
            Query(events("splitslam_map_fenced_total", _HERE), "fenced"),
            fault=True,
            width=5,
        ),
        lines(
            "Workers that died",
            "And were started again; their robots reconnect by themselves.",
            _events("splitslam_map_worker_restarts_total", "instance"),
            fault=True,
            width=5,
        ),
    ),
)

SERVICE = Board(
    "splitslam-service",
    "SplitSLAM: map service",
    "The map service: is there room, are answers in time, is everything stored?",
    (NOW, ANSWERS, ROBOTS, MAPPING, STORE, REPLICAS),
    (Variable("replica", "replica", "splitslam_map_streams", "instance"),),
)
