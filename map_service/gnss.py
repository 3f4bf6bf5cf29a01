"""GNSS in one session: datum, first guess of T_enu_map, spacing, gate. The factors themselves live in graph.py."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pymap3d
from numpy.typing import NDArray

from map_service.settings import GnssSettings
from splitslam import se3
from splitslam.scan import GnssFix

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class GnssMeasurement:
    """A fix that passed: enu_m (3,), sigmas_m (3,) as the graph is to weigh it."""

    enu_m: Array
    sigmas_m: Array
    T_enu_map: Array


class GnssGate:
    """Decides which fixes become factors; counts the others by reason."""

    def __init__(self, settings: GnssSettings) -> None:
        self.settings = settings
        self.datum: tuple[float, float, float] | None = None
        self.rejected: dict[str, int] = {}
        self.pairs: list[tuple[Array, Array]] = []  # (antenna in map, antenna in enu) until T_enu_map is known
        self.T_enu_map: Array | None = None
        self.last_used_map: Array | None = None

    def offer(self, fix: GnssFix, antenna_map: Array, T_enu_map: Array | None) -> GnssMeasurement | None:
        """A fix and where the antenna (3,) is in `map` by the trajectory; T_enu_map: the graph's estimate, if any."""
        s = self.settings
        sigmas = self._sigmas(fix)
        if sigmas is None:
            return None
        if self.datum is None:
            self.datum = (fix.latitude_deg, fix.longitude_deg, fix.altitude_m)
        enu = np.array(pymap3d.geodetic2enu(fix.latitude_deg, fix.longitude_deg, fix.altitude_m, *self.datum), float)
        known = self.T_enu_map if T_enu_map is None else T_enu_map
        if known is None:
            known = self._guess(antenna_map, enu, float(sigmas[0]))
            if known is None:
                return None
        distance = np.inf if self.last_used_map is None else float(np.linalg.norm(antenna_map - self.last_used_map))
        if distance < s.spacing_m:
            return None
        innovation = known[:3, :3] @ antenna_map + known[:3, 3] - enu
        # what the trajectory may have drifted since the last accepted fix opens the gate, so it cannot stay shut
        drift = s.drift_share * min(distance, 1e4)
        if (np.abs(innovation) > s.gate_sigmas * np.sqrt(sigmas**2 + s.floor_m**2 + drift**2)).any():
            return self.reject("gated")
        self.last_used_map = antenna_map.copy()
        return GnssMeasurement(enu, s.correlation * np.maximum(sigmas, s.floor_m), known)

    def _sigmas(self, fix: GnssFix) -> Array | None:
        s = self.settings
        values = (fix.latitude_deg, fix.longitude_deg, fix.altitude_m)
        if fix.status < 0 or not np.isfinite(values).all() or abs(fix.latitude_deg) > 90:
            return self.reject("no_fix")
        if fix.covariance_enu_m2 is None:
            return np.array([s.unknown_sigma_m, s.unknown_sigma_m, 2 * s.unknown_sigma_m])
        sigmas = np.sqrt(np.maximum(np.diag(fix.covariance_enu_m2), 1e-6))
        if not np.isfinite(sigmas).all() or sigmas[:2].max() > s.max_sigma_m:
            return self.reject("covariance")
        return sigmas

    def reject(self, reason: str) -> None:
        """Counts a fix that is not used."""
        self.rejected[reason] = self.rejected.get(reason, 0) + 1

    def _guess(self, antenna_map: Array, enu: Array, sigma_m: float) -> Array | None:
        """Yaw and translation from pairs 1 m apart, once they span enough for a yaw (LIO-SAM: 5 m covered)."""
        s = self.settings
        if self.pairs and np.linalg.norm(antenna_map - self.pairs[-1][0]) < 1.0:
            return None
        self.pairs.append((antenna_map, enu))
        a = np.array([p[0] for p in self.pairs])
        b = np.array([p[1] for p in self.pairs])
        if np.linalg.norm(np.ptp(a[:, :2], axis=0)) < max(s.start_distance_m, s.start_sigmas * sigma_m):
            return None
        ca, cb = a - a.mean(axis=0), b - b.mean(axis=0)
        yaw = np.arctan2(
            np.sum(ca[:, 0] * cb[:, 1] - ca[:, 1] * cb[:, 0]), np.sum(ca[:, 0] * cb[:, 0] + ca[:, 1] * cb[:, 1])
        )
        R = se3.so3_exp(np.array([0.0, 0.0, yaw]))
        self.T_enu_map = se3.compose(R, b.mean(axis=0) - R @ a.mean(axis=0))
        return self.T_enu_map

    def dump(self) -> dict:
        """All that must survive a restart (JSON)."""
        return {
            "datum": self.datum,
            "rejected": self.rejected,
            "pairs": [[a.tolist(), b.tolist()] for a, b in self.pairs],
            "T_enu_map": None if self.T_enu_map is None else self.T_enu_map.tolist(),
            "last_used_map": None if self.last_used_map is None else self.last_used_map.tolist(),
        }

    def load(self, data: dict) -> None:
        """The reverse of dump."""
        self.datum = None if data["datum"] is None else tuple(data["datum"])
        self.rejected = dict(data["rejected"])
        self.pairs = [(np.array(a), np.array(b)) for a, b in data["pairs"]]
        self.T_enu_map = None if data["T_enu_map"] is None else np.array(data["T_enu_map"])
        self.last_used_map = None if data["last_used_map"] is None else np.array(data["last_used_map"])
