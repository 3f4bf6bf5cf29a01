"""The LiDAR's layout as its scans show it, against the robot file: rings, columns, point times, ranges, beam table."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from splitslam.check.findings import Finding, note
from splitslam.robot import Lidar
from splitslam.scan import Scan

Array = NDArray[np.float64]

_ENOUGH_POINTS = 20
_FAR_M = 3.0  # nearer, a laser's own offset in the head bends its elevation
_BEAM_TOLERANCE_DEG = 0.6
_MANY = 0.5


@dataclass(slots=True)
class LayoutProbe:
    """Collects what a few scans look like; `add` each, then `layout`."""

    lidar: Lidar
    _ranges: list[tuple[float, float]] = field(default_factory=list)
    _spans: list[int] = field(default_factory=list)
    _starts: list[int] = field(default_factory=list)
    _steps: list[float] = field(default_factory=list)
    _back: int = 0
    _pairs: int = 0
    _elevations: list[Array] = field(default_factory=list)

    def add(self, scan: Scan) -> None:
        """Takes one scan."""
        points = scan.points_lidar.astype(np.float64)
        range_m = np.linalg.norm(points, axis=1)
        self._ranges.append((float(range_m.min()), float(range_m.max())))
        self._spans.append(scan.end_ns - scan.stamp_ns)
        self._starts.append(scan.stamp_ns)
        order = np.argsort(scan.ring, kind="stable")
        same = scan.ring[order][1:] == scan.ring[order][:-1]
        later = np.diff(scan.t_offset_ns[order].astype(np.int64))[same]
        self._back += int(np.count_nonzero(later < 0))
        self._pairs += len(later)
        azimuth = np.arctan2(points[order, 1], points[order, 0])
        step = np.abs((np.diff(azimuth) + np.pi) % (2 * np.pi) - np.pi)[same & (range_m[order][1:] > _FAR_M)]
        if len(step):
            self._steps.append(float(np.median(step)))
        self._elevations.append(_elevations(points, scan.ring, self.lidar.rings))

    def layout(self, nan_share: float = 0.0) -> Layout:
        """What the scans had in common."""
        seen = np.array(self._elevations).reshape(-1, self.lidar.rings)
        enough = np.isfinite(seen).any(axis=0)
        medians = np.full(self.lidar.rings, np.nan)
        medians[enough] = np.nanmedian(seen[:, enough], axis=0)
        return Layout(
            scans=len(self._ranges),
            rings_seen=int(enough.sum()),
            columns=2 * np.pi / float(np.median(self._steps)) if self._steps else None,
            min_range_m=min((low for low, _ in self._ranges), default=0.0),
            max_range_m=max((high for _, high in self._ranges), default=0.0),
            span_s=float(np.median(self._spans)) * 1e-9 if self._spans else 0.0,
            back_share=self._back / max(self._pairs, 1),
            nan_share=nan_share,
            elevations_rad=medians,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """scans: looked at. rings_seen: rings with points. columns: 360 degrees over the usual azimuth step, None without.

    min_range_m, max_range_m: of points inside the range gate. span_s: first to last firing of a scan. back_share: share
    of neighbours in a ring whose time goes back. nan_share: of all points read. elevations_rad: (rings,), NaN where a
    ring has no far points.
    """

    scans: int
    rings_seen: int
    columns: float | None
    min_range_m: float
    max_range_m: float
    span_s: float
    back_share: float
    nan_share: float
    elevations_rad: Array


def _elevations(points_lidar: Array, ring: NDArray[np.uint8], rings: int) -> Array:
    flat_m = np.hypot(points_lidar[:, 0], points_lidar[:, 1])
    far = flat_m > _FAR_M
    angle, of = np.arctan2(points_lidar[far, 2], flat_m[far]), ring[far]
    out = np.full(rings, np.nan)
    for r in range(rings):
        own = angle[of == r]
        if len(own) >= _ENOUGH_POINTS:
            out[r] = np.median(own)
    return out


def findings(
    layout: Layout,
    lidar: Lidar,
    period_s: float,
    known_rad: NDArray[np.floating] | None,
    left_out: Counter[str],
    read: int,
) -> list[Finding]:
    """known_rad: (rings,) table in use, None when it is estimated. left_out: points by reason; read: points kept."""
    return [
        *_shape(layout, lidar),
        *_times(layout, lidar, period_s),
        *_beams(layout, known_rad),
        *_points(lidar, left_out, read),
    ]


def _shape(layout: Layout, lidar: Lidar) -> list[Finding]:
    out = []
    if layout.rings_seen <= lidar.rings // 2:
        out.append(
            Finding("lidar.rings", f"{lidar.rings}, but only {layout.rings_seen} have points", str(layout.rings_seen))
        )
    elif layout.rings_seen < lidar.rings:
        out.append(note("lidar.rings", f"{lidar.rings - layout.rings_seen} of {lidar.rings} have no points"))
    if layout.columns is not None and not 0.75 < layout.columns / lidar.columns < 1.25:
        found = round(layout.columns)
        out.append(
            Finding("lidar.columns", f"{lidar.columns}, but points of a ring come {found} a turn", f"about {found}")
        )
    return out


def _times(layout: Layout, lidar: Lidar, period_s: float) -> list[Finding]:
    out = []
    if period_s and not 0.5 < layout.span_s / period_s < 1.2:
        text = f"span {layout.span_s * 1e3:.1f} ms of each scan, scans come each {period_s * 1e3:.1f} ms"
        out.append(Finding("lidar point times", text, "about the same"))
    if layout.back_share > 0.01:
        text = f"go back {layout.back_share:.1%} of the time within a ring"
        out.append(
            Finding(
                "lidar point times", text, "rising times in the sensor's order (was the cloud sorted or made dense?)"
            )
        )
    return out


def _beams(layout: Layout, known_rad: NDArray[np.floating] | None) -> list[Finding]:
    if known_rad is None:
        return []
    off_deg = np.degrees(np.abs(layout.elevations_rad - known_rad))
    wrong = np.flatnonzero(off_deg > _BEAM_TOLERANCE_DEG)  # NaN is not
    if not len(wrong):
        return []
    worst = int(wrong[np.argmax(off_deg[wrong])])
    flipped = np.nanmax(np.abs(layout.elevations_rad[::-1] - known_rad)) < np.radians(_BEAM_TOLERANCE_DEG)
    hint = "; ring 0 is the highest here, the table begins with the lowest" if flipped else ""
    return [
        Finding(
            "lidar.beam_elevations_deg",
            f"{len(wrong)} of {len(off_deg)} rings lie elsewhere, ring {worst} by {off_deg[worst]:z.1f} deg{hint}",
            f"ring {worst} at {np.degrees(layout.elevations_rad[worst]):z.1f} deg",
        )
    ]


def _points(lidar: Lidar, left_out: Counter[str], read: int) -> list[Finding]:
    out = []
    total = max(read + sum(left_out.values()), 1)
    measured = max(read + left_out["gated"] + left_out["unknown_ring"] + left_out["cropped"], 1)
    if left_out["unknown_ring"]:
        text = f"{left_out['unknown_ring'] / measured:.1%} of the points have a ring number that does not exist"
        out.append(Finding("lidar.rings", text, f"0 to {lidar.rings - 1}"))
    if left_out["gated"] > _MANY * measured:
        text = f"{left_out['gated'] / measured:.0%} of the points are nearer or farther"
        expected = f"{lidar.min_range_m:g} to {lidar.max_range_m:g} m (are the points in metres?)"
        out.append(Finding("lidar.min_range_m, lidar.max_range_m", text, expected))
    if left_out["nan"] > 0.9 * total:
        out.append(Finding("lidar points", f"{left_out['nan'] / total:.0%} are NaN", "most of them numbers"))
    return out
