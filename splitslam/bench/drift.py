"""How far a pose that nothing corrects goes astray over a part of a drive."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splitslam import se3
from splitslam.alignment import interpolate
from splitslam.errors import InputError
from splitslam.evaluate import inside
from splitslam.tum import Trajectory


@dataclass(frozen=True, slots=True)
class Drift:
    """The error of the motion over the part: of the estimate's end, seen from its beginning. way_m: by the truth."""

    way_m: float
    translation_m: float
    rotation_rad: float

    @property
    def share(self) -> float:
        """Of the way."""
        return self.translation_m / self.way_m


def drift(estimate: Trajectory, truth: Trajectory, begin_ns: int, end_ns: int) -> Drift:
    """From the first pose at or after `begin_ns` to the last before `end_ns`. InputError when the truth has no two."""
    part = estimate[(estimate.stamps_ns >= begin_ns) & (estimate.stamps_ns < end_ns)]
    part = part[inside(part, truth)]
    if len(part) < 2:
        raise InputError(f"expected poses between {begin_ns} and {end_ns} ns that the truth covers, found {len(part)}")
    true = interpolate(truth, part.stamps_ns)
    gone, was = (
        se3.inv(se3.from_quat(t.positions_m[0], t.quats_xyzw[0])) @ se3.from_quat(t.positions_m[-1], t.quats_xyzw[-1])
        for t in (part, true)
    )
    error = se3.inv(was) @ gone
    way_m = float(np.linalg.norm(np.diff(true.positions_m, axis=0), axis=1).sum())
    return Drift(way_m, float(np.linalg.norm(error[:3, 3])), se3.angle(error))
