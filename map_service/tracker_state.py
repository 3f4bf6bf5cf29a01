"""Where the tracking of a session stands."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(slots=True, eq=False)
class TrackerState:
    """All that must survive a restart, besides the keyframes."""

    T_local_lidar: Array
    T_local_keyframe: Array
    stamp_ns: int
    frames: int
    twist: Array  # of the newest motion, rad/s and m/s, frame `lidar`
    base_twist: Array  # zero, but while the first two scans are put together
    bad_frames: int
    seq: int
    hole_s: float = 0.0  # time bridged by the last twist instead of measured motion
    twist_spread: Array = field(default_factory=lambda: np.zeros(6))  # mean square change from motion to motion
    carried_sigma: Array = field(default_factory=lambda: np.zeros(6))  # of the motion since the last frame with points
