"""A datum: fixes that agree with each other, and the weight the next of them has in the graph."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from map_service.gnss_consensus import Heading, PlacedFix, drift_m, fits, heading_of, misfit
from map_service.settings import GnssSettings
from splitslam import se3

Array = NDArray[np.float64]
_ENOUGH = 8  # fixes 5 m apart, for a heading
_MEMORY = 16  # fixes over which the receiver's claims are checked
_SIGNIFICANT, _UNBELIEVABLE = 2.0, 8.0  # sigmas


@dataclass(frozen=True, slots=True, eq=False)
class Weight:
    """How strongly a fix pulls.

    sigmas_m: (3,) of its factor. noise_m: (3,) of the fix itself. robust_sigmas: width of the factor's kernel, which
    covers what the odometry may have drifted.
    """

    sigmas_m: Array
    noise_m: Array
    robust_sigmas: float

    def against(self, offset_m: Array) -> Weight:
        """The weight when the map stands off this datum by `offset_m` (3,) already.

        The graph takes the odometry's errors for independent, so a steady drift would outweigh GNSS for kilometres,
        while a GNSS that pulls hard would bend a map of millimetres by decimetres. What tells them apart is the size:
        an offset within two sigmas is GNSS noise, a larger one is drift, and pulls the more the larger it is.
        """
        share = np.abs(offset_m) / self.noise_m
        if share.max() > _UNBELIEVABLE:
            return self
        sigmas = np.maximum(self.sigmas_m / np.maximum(1.0, share / _SIGNIFICANT) ** 4, self.noise_m)
        return Weight(sigmas, self.noise_m, max(self.robust_sigmas, float((2.0 * np.abs(offset_m) / sigmas).max())))


class Datum:
    """One offset between the receiver's world and `map`. It begins with fixes that one heading explains."""

    def __init__(self, heading: Heading, settings: GnssSettings, doubt: float = 1.0) -> None:
        self.settings, self.heading = settings, heading
        self.fixes: deque[PlacedFix] = deque(maxlen=settings.keep)
        self.misfit = (
            doubt**2
        )  # running mean square of how fixes fit their neighbours: over 1, the receiver flatters itself

    def fits(self, fix: PlacedFix, doubt: float) -> bool:
        """Does it continue the fixes here? doubt: widens the gate."""
        return fits(fix, list(self.fixes), self.heading, max(doubt, float(np.sqrt(self.misfit))), self.settings)

    def gap_m(self, fix: PlacedFix) -> float:
        """Way driven since the newest fix here."""
        return fix.path_m - self.fixes[-1].path_m

    def add(self, fix: PlacedFix) -> Weight | None:
        """Takes a fix that fits and says what it weighs; None when it is too near to the one before to tell anything.

        Errors of fixes are alike for `correlation_s`: averaged over a long time, fixes dt apart of a Gauss-Markov
        error weigh as independent ones of sigma^2 (1 + 2 tau / dt). Carrier-phase errors are not that patient.
        """
        s = self.settings
        sigmas = noise = np.sqrt(fix.sigmas_m**2 + s.floor_m**2)
        robust = s.robust_sigmas
        if self.fixes:
            last = self.fixes[-1]
            if np.linalg.norm(fix.antenna_odom - last.antenna_odom) < s.spacing_m:
                return None
            self._check_claims(fix)
            tau_s = s.correlation_s * np.minimum(1.0, sigmas / s.correlated_sigma_m) ** 2
            noise = sigmas * np.sqrt(self.misfit)
            sigmas = noise * np.sqrt(1.0 + 2.0 * tau_s / ((fix.stamp_ns - last.stamp_ns) * 1e-9))
            robust = max(robust, s.gate_sigmas * float(drift_m(fix, [last], s)[0]) / float(sigmas.min()))
        self.fixes.append(fix)
        heading = heading_of(self.fixes) if len(self.fixes) > 1 else self.heading
        if len(self.fixes) >= _ENOUGH or heading.sigma_rad < self.heading.sigma_rad:
            self.heading = heading
        return Weight(sigmas, noise, robust)

    def _check_claims(self, fix: PlacedFix) -> None:
        s = self.settings
        near = [f for f in self.fixes if self.gap_m(fix) <= fix.path_m - f.path_m <= s.trust_m]
        if near:
            seen = np.minimum(misfit(fix, near, self.heading, s), s.gate_sigmas**2).mean()
            self.misfit = max(1.0, self.misfit + (float(seen) - self.misfit) / _MEMORY)

    def T_enu_odom(self) -> Array:
        """Yaw and translation (4, 4), by the mean of the fixes."""
        R = se3.so3_exp(np.array([0.0, 0.0, self.heading.yaw_rad]))
        odom = np.mean([f.antenna_odom for f in self.fixes], axis=0)
        return se3.compose(R, np.mean([f.enu_m for f in self.fixes], axis=0) - R @ odom)

    def dump(self) -> dict:
        """For a restart (JSON)."""
        heading = [self.heading.yaw_rad, self.heading.sigma_rad]
        return {"fixes": [f.dump() for f in self.fixes], "heading": heading, "misfit": self.misfit}

    @classmethod
    def load(cls, data: dict, settings: GnssSettings) -> Datum:
        """The reverse of dump."""
        datum = cls(Heading(*data["heading"]), settings)
        datum.fixes.extend(PlacedFix.load(f) for f in data["fixes"])
        datum.misfit = data["misfit"]
        return datum
