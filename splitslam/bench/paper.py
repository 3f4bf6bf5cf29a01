"""The paper's own figures: section V-C, Tables III and IV; section V-D, Tables V and VI; section V-E."""

from __future__ import annotations

from splitslam.bench.break_even import Cut, break_even_mbps

SCAN_HZ = 10.0
# Table III, Walking, Mbit/s: points, IMU.
TABLE_3 = {"case1": (38.39, 1.38), "case2": (40.49, 0.0), "case3": (5.90, 0.0)}
# Table IV: Case 3, Mbit/s, and its share of Case 1.
TABLE_4 = {"Walking": (5.90, 0.15), "Campus": (7.64, 0.23), "Park": (7.23, 0.18)}
# Table V, deskew, ms on its board: mean, standard deviation, maximum; with FPGA.
TABLE_5 = {
    "Walking": (30.03, 10.15, 81.23, 7.07),
    "Campus": (24.43, 8.14, 70.86, 7.07),
    "Park": (30.48, 10.58, 93.58, 7.07),
}
# Table VI, Image and Feature node, ms on its board: mean without and with FPGA, maximum without and with.
TABLE_6 = {
    "Walking": (54.72, 31.76, 147.51, 80.27),
    "Campus": (45.00, 27.64, 109.73, 67.76),
    "Park": (55.69, 32.28, 138.91, 83.80),
}
EDGE_MS, EDGE_FPGA_MS = TABLE_6["Walking"][:2]
# How much longer the board's Cortex-A53 takes than this processor, an assumption, printed as one: Table VI has 54.72 ms
# for the Image and Feature node in software; LIO-SAM's same two nodes took 6.7 ms on a core of the machine of
# docs/benchmarks.md.
A53_FACTOR = 8.0
# Not in the paper; the one value with which its formula gives both its break-evens (docs/paper.md, errata).
CASE_1_MS = 4.80
# Section V-E, without and with FPGA.
BREAK_EVEN_MBPS = {"case3": 67.85, "case3_fpga": 125.63}


def cut(case: str, time_ms: float) -> Cut:
    """A case of Table III at the LiDAR's 10 Hz."""
    return Cut(1e3 * sum(TABLE_3[case]) / SCAN_HZ, time_ms)


CUTS = {
    "case1": cut("case1", CASE_1_MS),
    "case3": cut("case3", EDGE_MS),
    "case3_fpga": cut("case3", EDGE_FPGA_MS),
}


def check() -> dict[str, float]:
    """Break-evens from the paper's inputs by the formula that measurements go through, Mbit/s."""
    return {name: break_even_mbps(CUTS["case1"], CUTS[name]) for name in BREAK_EVEN_MBPS}
