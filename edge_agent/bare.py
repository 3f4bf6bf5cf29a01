"""Frames that carry the motion alone: when the budget is tight and the IMU good, points are better sent together."""

from __future__ import annotations

import numpy as np

from edge_agent.settings import CarriedSettings
from splitslam.features import Knots, Motion


class CarriedMotion:
    """How far the pose is carried by the motion since the last frame with points.

    The sigmas add up and not their squares: what is wrong is mostly the velocity, and that the same way all the time.
    """

    def __init__(self, settings: CarriedSettings) -> None:
        self._settings = settings
        self._frames = 0
        self._rotation_rad = self._translation_m = 0.0

    def may_grow(self, motion: Motion, blind: bool) -> bool:
        """Would the pose still be known well if this frame, too, had no points? blind: there is no IMU."""
        s = self._settings
        if blind or not motion.velocity_known or self._frames >= s.frames:
            return False
        rotation_rad, translation_m = _sigmas(motion)
        return (
            self._rotation_rad + rotation_rad <= s.rotation_rad
            and self._translation_m + translation_m <= s.translation_m
        )

    def went(self, motion: Motion, bare: bool) -> None:
        """The frame goes out."""
        if not bare:
            self._frames, self._rotation_rad, self._translation_m = 0, 0.0, 0.0
            return
        rotation_rad, translation_m = _sigmas(motion)
        self._frames += 1
        self._rotation_rad += rotation_rad
        self._translation_m += translation_m


def ends(knots: Knots) -> Knots:
    """The first and the last knot: without points nothing is to be deskewed with those between."""
    both = [0, -1]
    return Knots(knots.offsets_ns[both], knots.rotation[both], knots.translation_m[both])


def _sigmas(motion: Motion) -> tuple[float, float]:
    sigmas = np.sqrt(np.diagonal(motion.covariance))
    return float(sigmas[:3].max()), float(sigmas[3:].max())
