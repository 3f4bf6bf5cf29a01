"""What the deskew core may cost and err: the bars of the tests.

Not in tests/tolerances.py: simulations run in environments where another package is called `tests`.
"""

from __future__ import annotations

# Against float64 at 100 m and 217 deg/s with 250 segments (seen: 0.114 mm, half of it the format's steps of 0.06 mm).
DESKEW_CORE_M = 0.5e-3
# 28,800 points and 250 segments, first beat in to last beat out (seen: 30,592, of which 30,554 are beats).
DESKEW_CORE_CLOCKS = 31_000
# A pipeline's length and the output FIFO (seen: 38).
DESKEW_CORE_LATENCY = 45
