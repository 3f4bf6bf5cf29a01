"""report.json: what the edge and the service counted, under the names of docs/report.md."""

from __future__ import annotations

from typing import Any

from splitslam.tum import Trajectory
from splitslam.wire import session_pb2 as pb

_FROM_EDGE = (
    "scans",
    "jumps",
    "wheels",
    "outages",
    "deskew",
    "edge_ms",
    "edge_wall_ms",
    "uplink",
    "downlink",
    "round_trip_ms",
    "wall_s",
    "recording_s",
    "dropped_by_reason",
    "check",
    "session_id",
    "run_id",
)


def assemble(
    edge: dict[str, Any], session: pb.SessionInfo, statistics: dict[str, Any], trajectory: Trajectory
) -> dict[str, Any]:
    """report.json without the evaluation.

    edge: the agent's edge.json. session, statistics: as the service tells. trajectory: the final T_map_lidar.
    """
    mapped = max(1, edge["scans"]["mapped"])
    cpu_ms = {**edge["cpu_ms_per_scan"], "map": statistics["cpu_ms"] / mapped}
    return {
        "scans": edge["scans"],
        "lost_scans": edge.get("lost_scans"),  # an agent of before does not count them
        "path_m": trajectory.path_m,
        "keyframes": session.keyframes,
        "loops": session.loops,
        "loop_keyframes": statistics.get("loop_keyframes", []),
        "gnss_factors": session.gnss_factors,
        "gnss_rejected": statistics["gnss_rejected"],
        "gravity_factors": statistics.get("gravity_factors"),  # a service of 0.1.0 does not count them
        "map_ms": statistics["map_ms"],
        "map_wall_ms": statistics["map_wall_ms"],
        "cpu_ms_per_scan": {name: cpu_ms[name] for name in ("edge", "map", "reader")},
        "store_bytes": session.store_bytes,
        **{name: edge[name] for name in _FROM_EDGE},
        "dense": edge.get("dense"),  # an agent of before knows none
    }
