"""Twins of the deskew's kernels, one element at a time."""

from __future__ import annotations

import numpy as np

from splitslam import se3
from splitslam.features import Knots


def pose_at(knots: Knots, t_ns: float) -> np.ndarray:
    """(3, 4): rotation by slerp, translation linear, the end knots held."""
    t = min(max(t_ns, int(knots.offsets_ns[0])), int(knots.offsets_ns[-1]))
    k = min(int(np.searchsorted(knots.offsets_ns, t, side="right")) - 1, len(knots.offsets_ns) - 2)
    a, b = (se3.compose(se3.so3_exp(knots.rotation[j]), knots.translation_m[j]) for j in (k, k + 1))
    return se3.interpolate(a, b, (t - knots.offsets_ns[k]) / (knots.offsets_ns[k + 1] - knots.offsets_ns[k]))[:3]


def table(knots: Knots, breaks_ns: np.ndarray, shift: int, scale: np.ndarray) -> np.ndarray:
    """(S, 28), before the words are rounded: ticks, bases, slopes."""
    ticks = [(int(b) + (1 << shift >> 1)) >> shift for b in breaks_ns]
    bases = [pose_at(knots, tick << shift).reshape(-1) * scale for tick in ticks]
    rows = []
    for s, (tick, base) in enumerate(zip(ticks, bases, strict=True)):
        slope = np.zeros(12)
        if s + 1 < len(ticks) and ticks[s + 1] > tick:
            slope = (bases[s + 1] - base) * 2.0**20 / (ticks[s + 1] - tick)
        rows.append(np.concatenate([[tick, 0, 0, 0], base, slope]))
    return np.array(rows)
