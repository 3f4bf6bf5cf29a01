"""What a person wants to know of one robot or one replica, taken from its pages."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

from splitslam.top.endpoint import Endpoint
from splitslam.top.page import Page, Span

STATES = ("starting", "initialising", "tracking", "degenerate", "unanchored", "localising", "lost")
EDGE, MAP = "splitslam_edge_", "splitslam_map_"


@dataclass(frozen=True, slots=True)
class Silent:
    """An endpoint that says nothing, and why."""

    name: str
    problem: str


@dataclass(frozen=True, slots=True)
class RobotRow:
    """One edge agent. Rates and quantiles are over the last seconds; what is not known is NaN.

    alone: by its own odometry. waiting: frames not yet durable at the service. uplinks_kbps: of every step, oldest
    first.
    """

    name: str
    state: str
    alone: bool
    scans_per_s: float
    round_trip_p50_s: float
    round_trip_p99_s: float
    cpu_s: float
    uplink_kbps: float
    uplinks_kbps: tuple[float, ...]
    waiting: float
    spool_bytes: float
    dropped: float
    reconnects: float


@dataclass(frozen=True, slots=True)
class ReplicaRow:
    """One map service. states: sessions by state."""

    name: str
    streams: float
    states: dict[str, int]
    frames_per_s: float
    answer_p50_s: float
    answer_p99_s: float
    queue: float
    commit_p99_s: float
    rejected: float
    refused: float
    restarts: float
    database_bytes: float


Row = Silent | RobotRow | ReplicaRow


def row_of(endpoint: Endpoint) -> Row:
    """The endpoint as it is now."""
    span = endpoint.span
    if endpoint.problem is not None or span is None:
        return Silent(endpoint.address, endpoint.problem or "not asked yet")
    return _robot(endpoint, span) if span.now.has(EDGE) else _replica(endpoint.address, span)


def state_of(page: Page) -> str:
    """Of a robot, by name."""
    state = page.value(f"{EDGE}state")
    return STATES[int(state)] if 0 <= state < len(STATES) else "?"


def _robot(endpoint: Endpoint, span: Span) -> RobotRow:
    page, pages = span.now, list(endpoint.pages)
    steps = itertools.starmap(Span, itertools.pairwise(pages))
    return RobotRow(
        name=endpoint.address,
        state=state_of(page),
        alone=page.value(f"{EDGE}alone") == 1.0,
        scans_per_s=span.rate(f"{EDGE}stage_seconds_count", stage="total"),
        round_trip_p50_s=span.quantile(f"{EDGE}round_trip_seconds", 0.5),
        round_trip_p99_s=span.quantile(f"{EDGE}round_trip_seconds", 0.99),
        cpu_s=span.mean(f"{EDGE}stage_seconds", stage="total"),
        uplink_kbps=_kbps(span),
        uplinks_kbps=tuple(_kbps(step) for step in steps),
        waiting=page.value(f"{EDGE}buffer_frames"),
        spool_bytes=page.value(f"{EDGE}spool_bytes"),
        dropped=_total(page, f"{EDGE}dropped_total"),
        reconnects=_total(page, f"{EDGE}reconnects_total"),
    )


def _replica(name: str, span: Span) -> ReplicaRow:
    page = span.now
    return ReplicaRow(
        name=name,
        streams=page.value(f"{MAP}streams"),
        states={state: int(n) for state, n in page.by(f"{MAP}sessions", "state").items() if n > 0},
        frames_per_s=span.rate(f"{MAP}frames_total", result="mapped"),
        answer_p50_s=span.quantile(f"{MAP}answer_seconds", 0.5),
        answer_p99_s=span.quantile(f"{MAP}answer_seconds", 0.99),
        queue=_total(page, f"{MAP}queue_frames"),
        commit_p99_s=span.quantile(f"{MAP}commit_seconds", 0.99),
        rejected=_total(page, f"{MAP}rejected_total"),
        refused=_total(page, f"{MAP}refused_total"),
        restarts=_total(page, f"{MAP}worker_restarts_total"),
        database_bytes=page.value(f"{MAP}database_bytes"),
    )


def _kbps(span: Span) -> float:
    return span.rate(f"{EDGE}uplink_bytes_total") * 8e-3


def _total(page: Page, name: str) -> float:
    """A counter that nothing has counted yet has no samples."""
    value = page.value(name)
    return 0.0 if math.isnan(value) else value
