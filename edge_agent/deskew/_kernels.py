"""Deskew kernel of the `cpu` back end: paper, Algorithm 2, lines 8-10, with the matrices tabulated."""

from __future__ import annotations

from numba import njit

FASTMATH = {"contract", "nsz"}


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def deskew_points(points, t_offset_ns, breaks_ns, base, slope, out):
    """out (N, 3) float32 = T_start_lidar(t) @ points (N, 3) float32; table as in splitslam.motion_table.

    Times rise along a ring and along a scan, so the segment is found by walking from the last one.
    """
    last = len(base) - 1
    s = 0
    for i in range(len(points)):
        t = min(max(t_offset_ns[i], breaks_ns[0]), breaks_ns[last + 1])
        while t < breaks_ns[s]:
            s -= 1
        while s < last and t >= breaks_ns[s + 1]:
            s += 1
        dt = points.dtype.type(t - breaks_ns[s])
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        b, m = base[s], slope[s]
        for r in range(3):
            k = 4 * r
            out[i, r] = (
                (b[k] + m[k] * dt) * x
                + (b[k + 1] + m[k + 1] * dt) * y
                + (b[k + 2] + m[k + 2] * dt) * z
                + (b[k + 3] + m[k + 3] * dt)
            )
