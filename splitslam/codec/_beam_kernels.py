"""Kernels between features in one order and whole steps in their beams: times, coordinates, lines.

Rows of `points` are those of _point_kernels.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from splitslam.codec._point_kernels import ACROSS, ALONG, COLUMN, LARGEST, LATE, TIME_UNIT_NS, UP

FASTMATH = {"contract", "nsz"}

TIME_TOLERANCE_NS = 50_000
FASTEST = 4.0  # columns pass no faster than so many turns in a frame


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def neighbour_rates(counts, points, t_offset_ns, rates):
    """rates (N,) float64: ns a column between close neighbours in a ring; returns how many there are."""
    m, i = 0, 0
    for r in range(len(counts)):
        for n in range(counts[r]):
            if n > 0:
                gap = np.int64(points[COLUMN, i]) - np.int64(points[COLUMN, i - 1])
                if 0 < gap <= 64:
                    rates[m] = (np.int64(t_offset_ns[i]) - np.int64(t_offset_ns[i - 1])) / gap
                    m += 1
            i += 1
    return m


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def mean_rate(counts, points, t_offset_ns, about):
    """ns a column over whole rings, leaving out the place where a scan begins and ends; `about` is a first guess."""
    time, columns, i = 0.0, 0, 0
    for r in range(len(counts)):
        for n in range(counts[r]):
            if n > 0:
                gap = np.int64(points[COLUMN, i]) - np.int64(points[COLUMN, i - 1])
                dt = float(np.int64(t_offset_ns[i]) - np.int64(t_offset_ns[i - 1]))
                if abs(dt - about * gap) < 32.0 * abs(about):
                    time += dt
                    columns += gap
            i += 1
    return time / columns if columns > 0 else about


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def column_rate(counts, points, t_offset_ns, turn_ns):
    """ns a column, 1/256. turn_ns: what it is if the frame is one turn, forwards or backwards.

    A few points, all of them beside the place where a scan begins and ends, would say something absurd: it is then the
    turn, in the direction in which more neighbours are.
    """
    rates = np.empty(len(t_offset_ns))
    count = neighbour_rates(counts, points, t_offset_ns, rates)
    if count == 0:
        return 0
    rate = mean_rate(counts, points, t_offset_ns, np.median(rates[:count]))
    if abs(rate) > FASTEST * turn_ns:
        rate = np.sign(np.sum(np.sign(rates[:count]))) * turn_ns
    return np.int64(min(max(round(rate * 256.0), -(1 << 31) + 1), (1 << 31) - 1))


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def follow_times(counts, rate, t_offset_ns, points, decoding):
    """Row LATE of points from t_offset_ns (N,) int32, or the other way round; times follow the columns of a ring.

    rate: ns a column, 1/256. While encoding t_offset_ns becomes what the decoder will have. False: beyond int32.
    """
    i, first_ns, first_column = 0, np.int64(0), np.int64(0)
    for r in range(len(counts)):
        t, c = first_ns, first_column
        for n in range(counts[r]):
            step = np.int64(points[COLUMN, i]) - c
            c += step
            t += (rate * step) >> 8
            if not decoding:
                error = np.int64(t_offset_ns[i]) - t
                late = (error + TIME_UNIT_NS // 2) // TIME_UNIT_NS if abs(error) > TIME_TOLERANCE_NS else 0
                points[LATE, i] = late
            t += TIME_UNIT_NS * np.int64(points[LATE, i])
            if abs(t) > 2147483647:
                return False
            t_offset_ns[i] = t
            if n == 0:
                first_ns, first_column = t, c
            i += 1
    return True


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def matrix_at(t, s, breaks_ns, base, slope, M):
    """M (12,) float64: the motion table's matrix at t; returns the segment, found by walking from segment s."""
    last = len(base) - 1
    t = min(max(t, breaks_ns[0]), breaks_ns[last + 1])
    while t < breaks_ns[s]:
        s -= 1
    while s < last and t >= breaks_ns[s + 1]:
        s += 1
    dt = float(t - breaks_ns[s])
    for e in range(12):
        M[e] = base[s, e] + slope[s, e] * dt
    return s


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def to_steps(points_lidar, counts, t_offset_ns, table, directions, points, fractions):
    """Rows ALONG, ACROSS, UP of points from points_lidar (N, 3) float32, deskewed; False: not finite or too far.

    table: (breaks_ns, base, slope). directions: (columns, 2) cos and sin of azimuth, (rings, 2) cos and sin of
    elevation, step_m. fractions (N,) float64: the azimuth within the column, rad, before rounding.
    """
    breaks_ns, base, slope = table
    azimuths, elevations, step_m = directions
    M = np.empty(12)
    segment, i = 0, 0
    for row in range(len(counts)):
        ce, se = elevations[row, 0], elevations[row, 1]
        for _ in range(counts[row]):
            c = points[COLUMN, i]
            segment = matrix_at(np.int64(t_offset_ns[i]), segment, breaks_ns, base, slope, M)
            dx, dy, dz = points_lidar[i, 0] - M[3], points_lidar[i, 1] - M[7], points_lidar[i, 2] - M[11]
            x = M[0] * dx + M[4] * dy + M[8] * dz
            y = M[1] * dx + M[5] * dy + M[9] * dz
            z = M[2] * dx + M[6] * dy + M[10] * dz
            ca, sa = azimuths[c, 0], azimuths[c, 1]
            level = ca * x + sa * y
            u, v, w = ce * level + se * z, ca * y - sa * x, ce * z - se * level
            if not max(abs(u), max(abs(v), abs(w))) < LARGEST * step_m:
                return False
            points[ALONG, i] = math.floor(u / step_m + 0.5)
            points[ACROSS, i] = math.floor(v / step_m + 0.5)
            points[UP, i] = math.floor(w / step_m + 0.5)
            fractions[i] = v / u if u > 0.5 else 9.0
            i += 1
    return True


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def from_steps(points, counts, t_offset_ns, table, directions, points_lidar):
    """The inverse of to_steps: points_lidar (N, 3) float32, deskewed to the reference time."""
    breaks_ns, base, slope = table
    azimuths, elevations, step_m = directions
    M = np.empty(12)
    segment, i = 0, 0
    for row in range(len(counts)):
        ce, se = elevations[row, 0], elevations[row, 1]
        for _ in range(counts[row]):
            c = points[COLUMN, i]
            u, v, w = points[ALONG, i] * step_m, points[ACROSS, i] * step_m, points[UP, i] * step_m
            ca, sa = azimuths[c, 0], azimuths[c, 1]
            level = ce * u - se * w
            x, y, z = ca * level - sa * v, sa * level + ca * v, se * u + ce * w
            segment = matrix_at(np.int64(t_offset_ns[i]), segment, breaks_ns, base, slope, M)
            for k in range(3):
                points_lidar[i, k] = M[4 * k] * x + M[4 * k + 1] * y + M[4 * k + 2] * z + M[4 * k + 3]
            i += 1


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def fit_lines(counts, points, lines):
    """lines (rings, 2) int64: offset (steps / 4) and slope (2^-14) of UP against ALONG in each ring.

    Least squares, drawn to the line of the ring before: a point's worth for the offset, and for the slope.
    """
    i, offset, slope = 0, 0.0, 0.0
    for r in range(len(counts)):
        n, su, suu, sw, suw = 1.0, 0.0, 250_000.0, 0.0, 0.0
        for _ in range(counts[r]):
            u = float(points[ALONG, i])
            w = points[UP, i] - offset - slope * u
            n += 1.0
            su += u
            suu += u * u
            sw += w
            suw += u * w
            i += 1
        determinant = n * suu - su * su
        offset += (suu * sw - su * suw) / determinant
        slope += (n * suw - su * sw) / determinant
        lines[r, 0] = math.floor(min(max(offset, -1e6), 1e6) * 4.0 + 0.5)
        lines[r, 1] = math.floor(min(max(slope, -8.0), 8.0) * 16384.0 + 0.5)
        offset, slope = lines[r, 0] / 4.0, lines[r, 1] / 16384.0
