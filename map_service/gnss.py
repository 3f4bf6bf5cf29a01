"""GNSS in one session: which fixes become factors of the graph, and how strongly. The factors themselves: graph.py.

Fixes that agree with each other about the robot's way (gnss_consensus.py) form a datum: one offset of the receiver's
world from the map, a T_enu_map of its own in the graph. A fix is used when it agrees with the fixes before it. One
that does not waits: it is dropped when the receiver comes back (a multipath jump), and if it never does, the waiting
fixes become a datum of their own. So a jump, however long, never pulls the map, and the gate never stays shut.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pymap3d
from numpy.typing import NDArray

from map_service.gnss_consensus import PlacedFix, chain, consistent_with_newest, heading_of, span_m
from map_service.gnss_datum import Datum, Weight
from map_service.settings import GnssSettings
from splitslam import se3
from splitslam.scan import GnssFix

Array = NDArray[np.float64]
_SMALLEST_VARIANCE_M2 = 1e-8  # a receiver that says less has not said anything


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """Where the antenna was at the fix's time: (3,) m each, as in PlacedFix; T_map_odom (4, 4)."""

    keyframe: int
    antenna_keyframe: Array
    antenna_odom: Array
    T_map_odom: Array


@dataclass(frozen=True, slots=True, eq=False)
class GnssMeasurement:
    """A fix that is to become a factor; T_enu_map (4, 4): first guess for its datum."""

    fix: PlacedFix
    weight: Weight
    datum: int
    T_enu_map: Array


class GnssGate:
    """Decides which fixes become factors. At any time, offered = used + rejected (for all reasons) + waiting."""

    def __init__(self, settings: GnssSettings) -> None:
        self.settings = settings
        self.origin: tuple[float, float, float] | None = None  # of `enu`: latitude, longitude, altitude
        self.rejected: dict[str, int] = {}
        self.data: list[Datum] = []
        self.waiting: list[PlacedFix] = []
        self._stamp_ns = -1
        self._path_m, self._path_at = 0.0, np.zeros(3)
        self._drift_m2 = 0.0

    def moved(self, covariance: Array) -> None:
        """What the odometry says about its step to a new keyframe: (6, 6), translation last."""
        self._drift_m2 += float(np.linalg.eigvalsh(covariance[3:, 3:])[-1])

    def offer(self, fix: GnssFix, place: Place) -> list[GnssMeasurement]:
        """Takes a fix; returns what becomes a factor now: nothing, or it, or it and fixes that have waited."""
        placed = self._placed(fix, place)
        if placed is None:
            return []
        doubt = self._doubt(placed)
        for index in reversed(range(len(self.data))):
            if not self.data[index].fits(placed, doubt):
                continue
            if self.data[index].gap_m(placed) <= self.settings.trust_m:
                return self._use(index, [placed], place)
            return self._confirm(placed, index, doubt, place)
        return self._found(placed, doubt, place)

    def reject(self, reason: str, count: int = 1) -> None:
        """Counts fixes that are not used."""
        if count:
            self.rejected[reason] = self.rejected.get(reason, 0) + count

    # --- one fix ----------------------------------------------------------------------------------------------

    def _placed(self, fix: GnssFix, place: Place) -> PlacedFix | None:
        sigmas_m = self._sigmas_m(fix)
        if sigmas_m is None:
            return None
        if fix.stamp_ns <= self._stamp_ns:
            return self.reject("duplicate" if fix.stamp_ns == self._stamp_ns else "out_of_order")
        self._stamp_ns = fix.stamp_ns
        if self.origin is None:
            self.origin = (fix.latitude_deg, fix.longitude_deg, fix.altitude_m)
            self._path_at = place.antenna_odom
        enu = np.array(pymap3d.geodetic2enu(fix.latitude_deg, fix.longitude_deg, fix.altitude_m, *self.origin), float)
        step_m = float(np.linalg.norm(place.antenna_odom - self._path_at))
        path_m = self._path_m + step_m
        if step_m > self.settings.path_step_m:  # shorter ones are the noise of a robot that stands
            self._path_m, self._path_at = path_m, place.antenna_odom
        where = place.keyframe, place.antenna_keyframe, place.antenna_odom
        return PlacedFix(fix.stamp_ns, *where, enu, sigmas_m, path_m, self._drift_m2)

    def _sigmas_m(self, fix: GnssFix) -> Array | None:
        s = self.settings
        unknown = np.array([s.unknown_sigma_m, s.unknown_sigma_m, 2 * s.unknown_sigma_m])
        values = (fix.latitude_deg, fix.longitude_deg, fix.altitude_m)
        if fix.status < 0 or not np.isfinite(values).all() or abs(fix.latitude_deg) > 90:
            return self.reject("no_fix")
        if fix.covariance_enu_m2 is None:
            return unknown
        variances = np.diag(fix.covariance_enu_m2)
        if not np.isfinite(variances).all() or (variances < 0).any() or variances[:2].max() > s.max_sigma_m**2:
            return self.reject("covariance")
        return unknown if variances.min() < _SMALLEST_VARIANCE_M2 else np.sqrt(variances)

    def _doubt(self, fix: PlacedFix) -> float:
        """1, and twice as much with each `widen_s` that no fix has fitted: of the odometry, and of what sigmas say."""
        if not self.waiting:
            return 1.0
        stuck_s = (fix.stamp_ns - self.waiting[0].stamp_ns) * 1e-9
        return 2.0 ** min(stuck_s // self.settings.widen_s, 3)

    # --- fixes that wait --------------------------------------------------------------------------------------

    def _confirm(self, fix: PlacedFix, index: int, doubt: float, place: Place) -> list[GnssMeasurement]:
        """It fits a datum last seen far back, where drift has opened the gate wide: some seconds must say the same."""
        s, datum = self.settings, self.data[index]
        if not self._wait(fix):
            return []
        group = chain([f for f in self.waiting if datum.fits(f, doubt)], datum.heading, doubt, s)
        if len(group) < s.start_fixes or _lasted_s(group) < s.confirm_s:
            return []
        return self._use(index, group, place)

    def _found(self, fix: PlacedFix, doubt: float, place: Place) -> list[GnssMeasurement]:
        """It fits no datum: perhaps the fixes that wait make a new one. LIO-SAM starts at 5 m covered, too."""
        s = self.settings
        if not self._wait(fix) or len(self.data) >= s.max_data:
            return []
        group = consistent_with_newest(self.waiting, doubt, s)
        if len(group) < s.start_fixes:
            return []
        since = sum(f.stamp_ns >= group[0].stamp_ns for f in self.waiting)
        far_m = max(s.start_distance_m, s.start_sigmas * max(float(f.sigmas_m[:2].max()) for f in group))
        if len(group) < s.majority * since or span_m(group) < far_m:
            return []
        if self.data and _lasted_s(group) < s.renew_s:
            return []
        self.data.append(Datum(heading_of(group), s, doubt))
        return self._use(len(self.data) - 1, group, place)

    def _wait(self, fix: PlacedFix) -> bool:
        """Joins those that wait, unless one of them is near."""
        if self.waiting and fix.path_m - self.waiting[-1].path_m < self.settings.start_spacing_m:
            self.reject("spacing")
            return False
        self.waiting.append(fix)
        if len(self.waiting) > self.settings.max_waiting:  # every second one will do
            self.reject("gated", len(self.waiting[1:-1:2]))
            self.waiting = [*self.waiting[:-1:2], fix]
        return True

    def _use(self, index: int, fixes: list[PlacedFix], place: Place) -> list[GnssMeasurement]:
        """Fixes of one datum; whatever else waits was wrong."""
        self.reject("gated", sum(f not in fixes for f in self.waiting))
        self.waiting = []
        datum = self.data[index]
        weights = [datum.add(fix) for fix in fixes]
        self.reject("spacing", weights.count(None))
        if not any(weights):
            return []
        T_enu_map = datum.T_enu_odom() @ se3.inv(place.T_map_odom)
        return [
            GnssMeasurement(fix, weight, index, T_enu_map)
            for fix, weight in zip(fixes, weights, strict=True)
            if weight is not None
        ]

    # --- restart ----------------------------------------------------------------------------------------------

    def dump(self) -> dict:
        """All that must survive a restart (JSON)."""
        return {
            "origin": self.origin,
            "rejected": self.rejected,
            "data": [datum.dump() for datum in self.data],
            "waiting": [fix.dump() for fix in self.waiting],
            "stamp_ns": self._stamp_ns,
            "path_m": self._path_m,
            "path_at": self._path_at.tolist(),
            "doubt_m2": self._drift_m2,
        }

    def load(self, data: dict) -> None:
        """The reverse of dump. Of a state of 0.1.0 only the origin goes on: its fixes are in the graph."""
        origin = data["datum"] if "datum" in data else data["origin"]
        self.origin = None if origin is None else tuple(origin)
        self.rejected = dict(data["rejected"])
        if "datum" in data:
            return
        self.data = [Datum.load(d, self.settings) for d in data["data"]]
        self.waiting = [PlacedFix.load(f) for f in data["waiting"]]
        self._stamp_ns = int(data["stamp_ns"])
        self._path_m, self._path_at = float(data["path_m"]), np.array(data["path_at"])
        self._drift_m2 = float(data["doubt_m2"])


def _lasted_s(fixes: list[PlacedFix]) -> float:
    return (fixes[-1].stamp_ns - fixes[0].stamp_ns) * 1e-9
