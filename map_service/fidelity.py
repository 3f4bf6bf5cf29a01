"""How exactly stored scans are told."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
MICRO = 1e-6  # that steps and bounds are whole numbers of
_SHARE = 20.0  # of a bound: the step of poses that are told within it
_WITHIN_S = 2e-3


@dataclass(frozen=True, slots=True)
class Fidelity:
    """How exactly a block tells its scans.

    rotation_rad, position_m: steps of poses. within_rad, within_m: poses that are no further from where the kept ones
    lead are left out, in time within_s; 0: none are. sigma, shape: covariances differ by no more, sigmas as a share of
    themselves, entries of their normalised factor as they are.
    """

    rotation_rad: float
    position_m: float
    within_rad: float
    within_m: float
    within_s: float
    sigma: float
    shape: float

    @property
    def told(self) -> NDArray[np.int64]:
        """(4,): what a reader has to know of it, in MICRO: both steps, sigma, shape."""
        return np.rint(np.array([self.rotation_rad, self.position_m, self.sigma, self.shape]) / MICRO).astype(np.int64)

    @property
    def read_as(self) -> Array:
        """(4,): what `told` says, as a reader has it."""
        return np.asarray(self.told * MICRO, np.float64)

    @property
    def thins(self) -> bool:
        return self.within_m > 0.0


# Answers scatter by 0.6 mm and 0.08 mrad, and nobody knows a sigma to a tenth.
FULL = Fidelity(1e-5, 1e-4, 0.0, 0.0, 0.0, 0.1, 0.1)


def thinned(within_m: float, within_rad: float) -> Fidelity:
    """Of old scans. Rounding, that of FULL before included, is part of the bounds."""
    rotation_rad, position_m = within_rad / _SHARE, within_m / _SHARE
    lost_rad = math.sqrt(0.75) * (rotation_rad + FULL.rotation_rad)
    lost_m = math.sqrt(0.75) * (position_m + FULL.position_m)
    return Fidelity(rotation_rad, position_m, within_rad - lost_rad, within_m - lost_m, _WITHIN_S, 0.2, 0.2)
