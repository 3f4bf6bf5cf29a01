"""A motion that nobody measured: between an agent and its successor, or while a robot's sensors were silent."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from splitslam import se3
from splitslam.features import Motion

_STEADY_S = 0.3  # so long a turn is taken to go on as it is; beyond, nothing is known of it
_RATE_RADPS, _SPEED_MPS = 1.5, 10.0  # what a robot may do unseen, 1 sigma
_LARGEST_RAD, _LONGEST_S = 3.0, 600.0


def unseen(motion: Motion, gap_s: float) -> Motion:
    """`motion` after a time in which nobody measured: turned as the scan shows, the way left to the map service.

    The service adds its own last velocity where the edge says that it knows none, and holds it to what accelerations
    allow (map_service/scan_alignment.py).
    """
    knots = motion.knots
    scan_s = float(knots.offsets_ns[-1] - knots.offsets_ns[0]) * 1e-9
    rate_radps = (knots.rotation[-1] - knots.rotation[0]) / scan_s
    turn = np.concatenate([rate_radps * min(gap_s, _STEADY_S), np.zeros(3)])
    sigma_rad, sigma_m = min(_RATE_RADPS * gap_s, _LARGEST_RAD), _SPEED_MPS * min(gap_s, _LONGEST_S)
    covariance = np.diag(np.repeat([sigma_rad**2, sigma_m**2], 3))
    return replace(motion, T_prev_lidar=se3.exp(turn), covariance=covariance, velocity_known=False)
