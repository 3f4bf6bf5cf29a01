"""edge.json: the edge's part of report.json under the same keys, and series by scan for the plots."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from edge_agent.assembly import RunParts
from edge_agent.clouds.dense import NEVER
from edge_agent.tally import stage_summaries
from edge_agent.tcp_meter import TcpBytes


def run_report(parts: RunParts, stopped: bool) -> dict[str, Any]:
    """stopped: before the end of its input, or without the service's word that all is mapped."""
    tally, metrics, imu, after = parts.tally, parts.metrics, parts.imu, parts.after
    source, uplink, clouds, node = parts.source, parts.uplink, parts.clouds, parts.pipeline.image_node
    recording_s = (source.end_ns - source.start_ns) * 1e-9
    read, welcome = parts.standing.scans_read, uplink.welcome
    dense = clouds.tcp_bytes() if clouds else TcpBytes()
    going_on = {"continued": {"after_scan": after.seq, "replayed": tally.replayed}} if after.seq else {}
    return {
        "session_id": welcome.session_id if welcome else "",
        "run_id": parts.store.run.value,
        **going_on,
        "stopped": stopped,
        "scans": {"read": read, "sent": tally.sent, "mapped": tally.mapped, "dropped": read - tally.mapped},
        "lost_scans": tally.lost,
        "passed_scans": parts.reader.passed_scans,  # before the agent listened
        "recording_s": recording_s,
        **tally.times(),
        **stage_summaries(metrics),
        **tally.link(uplink.tcp_bytes(), recording_s, source.counts, parts.pipeline.rate, dense),
        "dense": clouds.report() if clouds else NEVER,
        "jumps": {**imu.jumps, "map_count": tally.corrections, "map_max_m": tally.correction_max_m},
        "wheels": imu.wheels_report,
        "outages": {**asdict(parts.outages.report()), "odometry_ms": metrics.odometry.summary_ms()},
        "imu_resets": imu.resets,
        "deskew": {"back_end": node.name, "troubles": dict(node.counts)},
        "dropped_by_reason": parts.standing.dropped(),
        "clock_steps": dict(parts.sequencer.times.steps),
        "check": [finding.as_dict() for finding in parts.check.finish()],
        **tally.by_scan(),
    }
