"""Section V-E of the paper: total time of a scan over a link, and up to which bandwidth an edge pays."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Cut:
    """What one way of dividing the work costs a scan.

    kbit: sent to the server. time_ms: on the edge, and on the server for what another cut does on the edge.
    """

    kbit: float
    time_ms: float


def total_ms(cut: Cut, bandwidths_mbps: NDArray[np.float64]) -> NDArray[np.float64]:
    """Figure 12: (B,) time of a scan at each bandwidth (B,); a Mbit/s is a kbit a millisecond."""
    return cut.time_ms + cut.kbit / bandwidths_mbps


def break_even_mbps(case1: Cut, other: Cut) -> float:
    """B* = (D1 - D3) / (T3 - T1): below it `other` is done before `case1`.

    inf where `other` sends less and takes no longer: it wins at every bandwidth; 0 where it does not send less.
    """
    if other.kbit >= case1.kbit:
        return 0.0
    if other.time_ms <= case1.time_ms:
        return math.inf
    return (case1.kbit - other.kbit) / (other.time_ms - case1.time_ms)


def in_words(bandwidth_mbps: float) -> float | str:
    """A break-even for JSON, which knows no infinity: a number, `always` or `never`."""
    return "always" if math.isinf(bandwidth_mbps) else bandwidth_mbps or "never"
