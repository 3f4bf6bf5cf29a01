"""One stream of stamps: rate, gaps, order."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitslam.check.findings import Finding, Severity, note

_RATE_TOLERANCE = 0.15
_MANY = 0.001  # share of messages out of order that is no accident
_LOST_SHARE = 0.01
_GAP_PERIODS = 1.5
_GAP_FLOOR_S = 0.012  # a fast IMU's driver bundles samples


@dataclass(frozen=True, slots=True)
class StreamStatistics:
    """count: messages. rate_hz: by the median step. gaps: steps longer than 1.5 periods; lost_s: time in them beyond a
    period. backwards, duplicates: stamps before or equal to one before. jitter_s: middle half of the steps, spread."""

    count: int
    rate_hz: float
    gaps: int
    longest_gap_s: float
    lost_s: float
    backwards: int
    duplicates: int
    jitter_s: float
    span_s: float

    @property
    def period_s(self) -> float:
        return 1.0 / self.rate_hz if self.rate_hz else 0.0


def statistics(stamps_ns: NDArray[np.int64]) -> StreamStatistics:
    """Stamps in the order of arrival, (N,) int64."""
    if len(stamps_ns) < 3:
        return StreamStatistics(len(stamps_ns), 0.0, 0, 0.0, 0.0, 0, 0, 0.0, 0.0)
    step_ns = np.diff(stamps_ns)
    newest_ns = np.maximum.accumulate(stamps_ns)[:-1]
    backwards = int(np.count_nonzero(stamps_ns[1:] < newest_ns))
    duplicates = int(np.count_nonzero(stamps_ns[1:] == newest_ns))
    sorted_s = np.diff(np.unique(stamps_ns)) * 1e-9
    period_s = float(np.median(sorted_s)) if len(sorted_s) else 0.0
    low, high = np.percentile(step_ns, [25, 75]) * 1e-9
    long = sorted_s[sorted_s > max(_GAP_PERIODS * period_s, period_s + _GAP_FLOOR_S)]
    return StreamStatistics(
        count=len(stamps_ns),
        rate_hz=1.0 / period_s if period_s else 0.0,
        gaps=len(long),
        longest_gap_s=float(long.max(initial=0.0)),
        lost_s=float(np.sum(long - period_s)),
        backwards=backwards,
        duplicates=duplicates,
        jitter_s=float(high - low),
        span_s=float(np.ptp(stamps_ns)) * 1e-9,
    )


def findings(name: str, s: StreamStatistics, stated_hz: float | None) -> list[Finding]:
    """Lines about one stream; name: its section of the robot file. stated_hz: what the robot file says."""
    out: list[Finding] = []
    if stated_hz and s.rate_hz and abs(s.rate_hz / stated_hz - 1.0) > _RATE_TOLERANCE:
        out.append(
            Finding(f"{name}.rate_hz", f"{stated_hz:g}, but messages come at {s.rate_hz:.1f} Hz", f"{s.rate_hz:.3g}")
        )
    if s.gaps:
        lost = s.lost_s > _LOST_SHARE * s.span_s or s.longest_gap_s > 1.0
        text = f"{s.gaps} gaps, the longest {s.longest_gap_s:.2f} s, {s.lost_s:.2f} s lost of {s.span_s:.1f} s"
        severity = Severity.PROBLEM if lost else Severity.NOTE
        out.append(Finding(f"{name} stamps", text, f"a message each {s.period_s * 1e3:.3g} ms", severity))
    for count, text in ((s.backwards, "go back in time"), (s.duplicates, "are equal to the one before")):
        if count:
            many = count > max(1, _MANY * s.count)
            severity = Severity.PROBLEM if many else Severity.NOTE
            out.append(
                Finding(f"{name} stamps", f"{count} of {s.count} {text}", "rising stamps (these are dropped)", severity)
            )
    return out


def same_clock(lidar_ns: NDArray[np.int64], imu_ns: NDArray[np.int64]) -> Finding | None:
    """LiDAR and IMU must cover the same time."""
    covered = np.mean((lidar_ns >= imu_ns.min()) & (lidar_ns <= imu_ns.max())) if len(imu_ns) else 0.0
    if covered > 0.5:
        return note("imu stamps", f"cover {covered:.0%} of the scans") if covered < 0.95 else None
    apart_s = float(np.median(lidar_ns) - np.median(imu_ns)) * 1e-9 if len(imu_ns) else 0.0
    return Finding(
        "imu stamps",
        f"cover {covered:.0%} of the scans: LiDAR and IMU stamps are {abs(apart_s):.3g} s apart",
        "one clock for both (PTP, or stamps by the same host)",
    )
