"""What GNSS fixes say about the robot's way, held against what the odometry says: arithmetic, no state.

The odometry is exact over metres and drifts over kilometres; GNSS is the other way round. So a fix is never judged by
where it is, but by how far the robot has moved since other fixes: |d_enu - R d_odom| against the noise of both fixes
and what the odometry may have drifted in between. That is pairwise consistency as in Mangelsen et al., "Pairwise
Consistent Measurement Set Maximization for Robust Multi-Robot Map Merging", 2018, section IV, for positions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from map_service.settings import GnssSettings

Array = NDArray[np.float64]
_NEAREST = 3


@dataclass(frozen=True, slots=True, eq=False)
class PlacedFix:
    """A fix and where the odometry had the antenna at its time.

    antenna_keyframe, antenna_odom: (3,) m, in the frame of keyframe `keyframe` and in the server's odometry frame.
    enu_m, sigmas_m: (3,). path_m: way driven up to here. doubt_m2: variance of position that the odometry itself has
    declared up to here (corridors, blind scans).
    """

    stamp_ns: int
    keyframe: int
    antenna_keyframe: Array
    antenna_odom: Array
    enu_m: Array
    sigmas_m: Array
    path_m: float
    doubt_m2: float

    def dump(self) -> dict:
        """For a restart (JSON)."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        return {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in values.items()}

    @classmethod
    def load(cls, data: dict[str, Any]) -> PlacedFix:
        """The reverse of dump."""
        values: dict[str, Any] = {name: np.array(v) if isinstance(v, list) else v for name, v in data.items()}
        return cls(**values)


@dataclass(frozen=True, slots=True)
class Heading:
    """yaw_rad: from `odom` to east; sigma_rad: how well it is known."""

    yaw_rad: float
    sigma_rad: float


def rotated(yaw_rad: float, vectors: Array) -> Array:
    """Vectors (..., 3), turned about z."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    return vectors @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def drift_m(fix: PlacedFix, others: Sequence[PlacedFix], s: GnssSettings) -> Array:
    """(n,): standard deviation of what the odometry may have drifted between `fix` and each of the others."""
    path_m = np.array([o.path_m for o in others])
    doubt_m2 = np.array([o.doubt_m2 for o in others])
    return np.sqrt((s.drift_share * (fix.path_m - path_m)) ** 2 + np.abs(fix.doubt_m2 - doubt_m2))


def misfit(fix: PlacedFix, others: Sequence[PlacedFix], heading: Heading, s: GnssSettings) -> Array:
    """(n, 3): by how much GNSS and odometry differ about the way from each of the others to `fix`, squared sigmas."""
    moved = fix.antenna_odom - np.array([o.antenna_odom for o in others])
    off = fix.enu_m - np.array([o.enu_m for o in others]) - rotated(heading.yaw_rad, moved)
    variance = fix.sigmas_m**2 + np.array([o.sigmas_m for o in others]) ** 2 + 2 * s.floor_m**2
    variance += drift_m(fix, others, s)[:, None] ** 2
    sideways = heading.sigma_rad**2 * np.sum(moved[:, :2] ** 2, axis=1)
    variance[:, :2] += sideways[:, None]
    return off**2 / variance


def agree(
    fix: PlacedFix, others: Sequence[PlacedFix], heading: Heading, doubt: float, s: GnssSettings
) -> NDArray[np.bool_]:
    """(n,): does `fix` fit each of the others on every axis, within the gate, widened `doubt` times?"""
    return np.all(misfit(fix, others, heading, s) <= (s.gate_sigmas * doubt) ** 2, axis=1)


def fits(fix: PlacedFix, others: Sequence[PlacedFix], heading: Heading, doubt: float, s: GnssSettings) -> bool:
    """Does `fix` agree with most of the others (in order, the nearest last), and with most of the nearest ones?

    The nearest notice a jump and a fast ramp, over few metres of exact odometry; all of them a slow ramp that hides in
    the noise from each fix to the next.
    """
    kept = agree(fix, others, heading, doubt, s)
    return bool(min(kept.mean(), kept[-_NEAREST:].mean()) >= s.majority)


def heading_of(fixes: Sequence[PlacedFix]) -> Heading:
    """Least squares over at least two fixes: the yaw of Umeyama, 1991, eq. 40, in the plane."""
    odom = np.array([f.antenna_odom[:2] for f in fixes])
    enu = np.array([f.enu_m[:2] for f in fixes])
    a, b = odom - odom.mean(axis=0), enu - enu.mean(axis=0)
    yaw = float(np.arctan2(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), np.sum(a * b)))
    # errors of neighbouring fixes are alike: the ends of the way count, not the number of fixes on it
    sigma_m = float(max(f.sigmas_m[:2].max() for f in fixes))
    return Heading(yaw, float(np.sqrt(2.0)) * sigma_m / max(span_m(fixes), 1e-3))


def span_m(fixes: Sequence[PlacedFix]) -> float:
    """Extent in the plane of where the fixes were taken, by the odometry."""
    return float(np.linalg.norm(np.ptp(np.array([f.antenna_odom[:2] for f in fixes]), axis=0)))


def consistent_with_newest(fixes: Sequence[PlacedFix], doubt: float, s: GnssSettings) -> list[PlacedFix]:
    """The largest set around the newest fix that one heading explains; every other fix in turn gives the heading."""
    newest, best = fixes[-1], list(fixes[-1:])
    for other in fixes[:-1]:
        if span_m([other, newest]) < 0.5 * s.start_distance_m:
            continue
        kept = agree(newest, fixes, heading_of([other, newest]), doubt, s)
        if kept.sum() > len(best):
            best = [f for f, keep in zip(fixes, kept, strict=True) if keep]
    return chain(best, heading_of(best), doubt, s) if len(best) > 1 else best


def chain(fixes: Sequence[PlacedFix], heading: Heading, doubt: float, s: GnssSettings) -> list[PlacedFix]:
    """Back from the newest fix, those that fit the ones already taken.

    What fits the newest alone will not do: a jump as long as the way can look like a turn, and the end of a slow ramp
    like drift.
    """
    taken = [fixes[-1]]
    for fix in reversed(fixes[:-1]):
        if fits(fix, taken, heading, doubt, s):
            taken.append(fix)
    return taken[::-1]
