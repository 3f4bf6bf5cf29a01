"""Unix time to GPS time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_GPS_EPOCH_S = 315_964_800  # 1980-01-06 in Unix time
_ADJUSTED_S = 1_000_000_000
# Leap seconds since the GPS epoch, from Unix time on (IERS Bulletin C); the last one announced was that of 2017.
_LEAPS = (
    (0, 0), (362_793_600, 1), (394_329_600, 2), (425_865_600, 3), (489_024_000, 4), (567_993_600, 5), (631_152_000, 6),
    (662_688_000, 7), (709_948_800, 8), (741_484_800, 9), (773_020_800, 10), (820_454_400, 11), (867_715_200, 12),
    (915_148_800, 13), (1_136_073_600, 14), (1_230_768_000, 15), (1_341_100_800, 16), (1_435_708_800, 17),
    (1_483_228_800, 18),
)  # fmt: skip
_FROM_NS = np.array([unix_s for unix_s, _ in _LEAPS], np.int64) * 1_000_000_000
_SECONDS = np.array([seconds for _, seconds in _LEAPS], np.int64)


def adjusted_gps_s(stamps_ns: NDArray[np.int64]) -> NDArray[np.float64]:
    """(N,) Unix time, ns -> (N,) GPS seconds less 10^9, as LAS 1.4 has it ("Adjusted Standard GPS Time")."""
    leaps = _SECONDS[np.maximum(np.searchsorted(_FROM_NS, stamps_ns, side="right") - 1, 0)]
    whole_s, rest_ns = np.divmod(stamps_ns, 1_000_000_000)
    return (whole_s + leaps - _GPS_EPOCH_S - _ADJUSTED_S).astype(np.float64) + rest_ns * 1e-9
