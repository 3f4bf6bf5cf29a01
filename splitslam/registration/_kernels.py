"""Kernels of the local map: one open-addressing hash table for the voxels of all levels, and a row for each voxel.

Layout:
  slots   (C, 2) int64: key and row. Key: level << 60 | ix << 40 | iy << 20 | iz, biased by 2^19; -1: free.
  moments (R, 10) float64: n, sum of (x y z), sum of (xx xy xz yy yz zz), relative to the voxel's centre.
  geometry (R, 16) float64, two cache lines. What a point is held against: mean (3), axis (3: plane normal or line
  direction), square of how far along itself a fit reaches, kind. What a match is worth: l_min, l_mid, l_max, longest
  axis (3), n, index of the keyframe that saw the voxel first; of a free row: the next one.
  pool    (2,) int64: how many rows were ever used, and the first of those that are free again; -1: none.
Kind: 0 none, 1 plane, 2 line, -1 moments have changed since the fit. C is a power of two from 8 on, R half of it.
Rows are taken one after the other, so memory is touched as voxels come, and neighbours lie side by side. So do the
slots of the eight voxels that share a voxel of twice the size: a point looks at several of them.
Rules (7,) float64: size of the finest voxels (m), levels, kind of the fits, and their limits: n_min, largest sigma of
the thin directions (m), smallest sigma of the wide ones as a share of the voxel's size, largest ratio thin/wide sigma.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

FASTMATH = {"contract", "arcp", "nsz"}
BIAS = 1 << 19
MASK = (1 << 20) - 1
_LAST_BITS = (1 << 40) | (1 << 20) | 1  # of the three indices in a key
MOMENTS, GEOMETRY = 10, 16
REACH, KIND, L_MIN, L_MID, L_MAX, LONGEST, COUNT, KEYFRAME = 6, 7, 8, 9, 10, 11, 14, 15
NEXT = KEYFRAME  # of a free row
EVER_USED, FREE = 0, 1  # of `pool`
PLANE = 1.0
LINE = 2.0
STALE = -1.0


@njit(cache=True, nogil=True, inline="always")
def pack(level, ix, iy, iz):
    """Key of a voxel; indices wrap at +-2^19 voxels (262 km at 0.5 m)."""
    return (level << 60) | (((ix + BIAS) & MASK) << 40) | (((iy + BIAS) & MASK) << 20) | ((iz + BIAS) & MASK)


@njit(cache=True, nogil=True, inline="always")
def home_of(slots, key):
    """Where `key` is looked for first: its place among eight, which begin where a hash (multiply, fold) says."""
    h = np.uint64(key & ~_LAST_BITS) * np.uint64(0x9E3779B97F4A7C15)
    h = (h ^ (h >> np.uint64(32))) * np.uint64(0xD6E8FEB86659FD93)
    among = ((key >> 38) & 4) | ((key >> 19) & 2) | (key & 1)
    return ((h >> np.uint64(29)) & np.uint64(len(slots) - 8)) | np.uint64(among)


@njit(cache=True, nogil=True, inline="always")
def slot_of(slots, key):
    """First slot that holds `key` or is free (linear probing)."""
    mask = np.uint64(len(slots) - 1)
    i = home_of(slots, key)
    while slots[i, 0] != -1 and slots[i, 0] != key:
        i = (i + np.uint64(1)) & mask
    return np.int64(i)


@njit(cache=True, nogil=True)
def _take_row(geometry, pool):
    """A row for a new voxel: those that are free are zero but for where the next one is."""
    row = pool[FREE]
    if row >= 0:
        pool[FREE] = np.int64(geometry[row, NEXT])
    else:
        row = pool[EVER_USED]
        pool[EVER_USED] += 1
    return row


@njit(cache=True, nogil=True, fastmath=FASTMATH, inline="always")
def _count(m, sign, dx, dy, dz):
    """Adds a point, relative to the voxel's centre, to the moments m; sign -1.0 takes it out."""
    sx, sy, sz = sign * dx, sign * dy, sign * dz
    m[0] += sign
    m[1] += sx
    m[2] += sy
    m[3] += sz
    m[4] += sx * dx
    m[5] += sx * dy
    m[6] += sx * dz
    m[7] += sy * dy
    m[8] += sy * dz
    m[9] += sz * dz


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def insert(slots, moments, geometry, pool, rules, points, keyframe):
    """Adds points (N, 3) to every level; returns how many voxels are new. The caller has room for N * levels more."""
    new = 0
    for k in range(len(points)):
        x, y, z = points[k, 0], points[k, 1], points[k, 2]
        size = rules[0]
        for level in range(np.int64(rules[1])):
            ix, iy, iz = math.floor(x / size), math.floor(y / size), math.floor(z / size)
            key = pack(level, np.int64(ix), np.int64(iy), np.int64(iz))
            i = slot_of(slots, key)
            if slots[i, 0] == -1:
                slots[i, 0], slots[i, 1] = key, _take_row(geometry, pool)
                geometry[slots[i, 1], KEYFRAME] = keyframe
                new += 1
            row = slots[i, 1]
            _count(moments[row], 1.0, x - (ix + 0.5) * size, y - (iy + 0.5) * size, z - (iz + 0.5) * size)
            geometry[row, KIND] = STALE
            size *= 2.0
    return new


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def take_out(slots, moments, geometry, rules, points, gone):
    """Takes points (N, 3) that are in out again; gone (N * levels) out: keys that have none left; returns how many."""
    count = 0
    for k in range(len(points)):
        x, y, z = points[k, 0], points[k, 1], points[k, 2]
        size = rules[0]
        for level in range(np.int64(rules[1])):
            ix, iy, iz = math.floor(x / size), math.floor(y / size), math.floor(z / size)
            key = pack(level, np.int64(ix), np.int64(iy), np.int64(iz))
            row = slots[slot_of(slots, key), 1]
            _count(moments[row], -1.0, x - (ix + 0.5) * size, y - (iy + 0.5) * size, z - (iz + 0.5) * size)
            geometry[row, KIND] = STALE
            if moments[row, 0] == 0.0:
                gone[count] = key
                count += 1
            size *= 2.0
    return count


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def _isolated(A, n):
    """The eigenvalue of a symmetric (3, 3) that lies furthest from the others, and its eigenvector n (3,).

    Smith, "Eigenvalues of a symmetric 3 x 3 matrix", 1961. It is at least sqrt(3) p away from the next, so that the
    largest of the products of two rows of A - e, all of them along n, is never small.
    """
    q = (A[0, 0] + A[1, 1] + A[2, 2]) / 3.0
    x, y, z = A[0, 0] - q, A[1, 1] - q, A[2, 2] - q
    f, g, h = A[0, 1], A[0, 2], A[1, 2]
    p = math.sqrt((x * x + y * y + z * z + 2.0 * (f * f + g * g + h * h)) / 6.0)
    n[0], n[1], n[2] = 1.0, 0.0, 0.0
    if p <= 1e-15 * abs(q) or p == 0.0:  # a sphere
        return q
    r = (x * (y * z - h * h) - f * (f * z - g * h) + g * (f * h - g * y)) / (2.0 * p * p * p)
    phi = math.acos(min(max(r, -1.0), 1.0)) / 3.0
    e = 2.0 * p * math.cos(phi if r >= 0.0 else phi + 2.0 * math.pi / 3.0)
    x, y, z = x - e, y - e, z - e
    best = 0.0
    for pair in range(3):
        if pair == 0:
            a, b, c = f * h - g * y, g * f - x * h, x * y - f * f
        elif pair == 1:
            a, b, c = f * z - g * h, g * g - x * z, x * h - f * g
        else:
            a, b, c = y * z - h * h, h * g - f * z, f * h - y * g
        square = a * a + b * b + c * c
        if square > best:
            best = square
            n[0], n[1], n[2] = a, b, c
    length = math.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
    n[0], n[1], n[2] = n[0] / length, n[1] / length, n[2] / length
    return q + e


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def eigen_symmetric(A, V):
    """Eigen-decomposition of a symmetric (3, 3); A becomes diagonal, columns of V the eigenvectors.

    One of them by formula, the other two by a rotation in the plane across it.
    """
    n = V[:, 0]
    e = _isolated(A, n)
    if abs(n[0]) < 0.6:
        length = math.sqrt(n[1] * n[1] + n[2] * n[2])
        ux, uy, uz = 0.0, -n[2] / length, n[1] / length
    else:
        length = math.sqrt(n[0] * n[0] + n[1] * n[1])
        ux, uy, uz = -n[1] / length, n[0] / length, 0.0
    wx, wy, wz = n[1] * uz - n[2] * uy, n[2] * ux - n[0] * uz, n[0] * uy - n[1] * ux
    x = A[0, 0] * wx + A[0, 1] * wy + A[0, 2] * wz
    y = A[0, 1] * wx + A[1, 1] * wy + A[1, 2] * wz
    z = A[0, 2] * wx + A[1, 2] * wy + A[2, 2] * wz
    across, of_w = ux * x + uy * y + uz * z, wx * x + wy * y + wz * z
    x = A[0, 0] * ux + A[0, 1] * uy + A[0, 2] * uz
    y = A[0, 1] * ux + A[1, 1] * uy + A[1, 2] * uz
    z = A[0, 2] * ux + A[1, 2] * uy + A[2, 2] * uz
    of_u = ux * x + uy * y + uz * z
    t = 0.0
    if across != 0.0:
        theta = (of_w - of_u) / (2.0 * across)
        t = math.copysign(1.0, theta) / (abs(theta) + math.sqrt(theta * theta + 1.0))
    c = 1.0 / math.sqrt(t * t + 1.0)
    s = t * c
    V[0, 1], V[1, 1], V[2, 1] = c * ux - s * wx, c * uy - s * wy, c * uz - s * wz
    V[0, 2], V[1, 2], V[2, 2] = s * ux + c * wx, s * uy + c * wy, s * uz + c * wz
    for r in range(3):
        for k in range(3):
            A[r, k] = 0.0
    A[0, 0], A[1, 1], A[2, 2] = e, of_u - t * across, of_w + t * across


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def fit(key, m, g, rules, A, V):
    """Fits the plane or line of one voxel: from its moments m to its geometry g; A, V (3, 3) are scratch.

    Plane: one thin direction, two wide; line: two thin, one wide.
    """
    n = m[0]
    g[KIND] = 0.0
    if n < rules[3]:
        return
    size = rules[0] * (1 << (key >> 60))
    mx, my, mz = m[1] / n, m[2] / n, m[3] / n
    A[0, 0] = m[4] / n - mx * mx
    A[0, 1] = A[1, 0] = m[5] / n - mx * my
    A[0, 2] = A[2, 0] = m[6] / n - mx * mz
    A[1, 1] = m[7] / n - my * my
    A[1, 2] = A[2, 1] = m[8] / n - my * mz
    A[2, 2] = m[9] / n - mz * mz
    eigen_symmetric(A, V)
    lo, hi = 0, 0
    for a in range(1, 3):
        if A[a, a] < A[lo, lo]:
            lo = a
        if A[a, a] >= A[hi, hi]:
            hi = a
    if lo == hi:
        return
    mid = 3 - lo - hi
    l_min, l_mid, l_max = max(A[lo, lo], 0.0), max(A[mid, mid], 0.0), max(A[hi, hi], 0.0)
    thin, wide, axis = (l_min, l_mid, lo) if rules[2] == PLANE else (l_mid, l_max, hi)
    if thin > rules[4] * rules[4] or thin > rules[6] * rules[6] * wide:
        return
    if wide < (rules[5] * size) ** 2:
        return
    g[0] = mx + ((((key >> 40) & MASK) - BIAS) + 0.5) * size
    g[1] = my + ((((key >> 20) & MASK) - BIAS) + 0.5) * size
    g[2] = mz + (((key & MASK) - BIAS) + 0.5) * size
    g[3], g[4], g[5] = V[0, axis], V[1, axis], V[2, axis]
    g[REACH] = 9.0 * (l_mid + l_max if rules[2] == PLANE else l_max) + 0.01
    g[KIND], g[COUNT] = rules[2], n
    g[L_MIN], g[L_MID], g[L_MAX] = l_min, l_mid, l_max
    g[LONGEST], g[LONGEST + 1], g[LONGEST + 2] = V[0, hi], V[1, hi], V[2, hi]


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def fit_all(slots, moments, geometry, rules):
    """Fits every voxel whose moments have changed since."""
    A, V = np.empty((3, 3)), np.empty((3, 3))
    for i in range(len(slots)):
        key, row = slots[i, 0], slots[i, 1]
        if key != -1 and geometry[row, KIND] == STALE:
            fit(key, moments[row], geometry[row], rules, A, V)


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def match(slots, moments, geometry, rules, points_lidar, T, gate_m, fits):
    """Finds for each point (N, 3), moved by T (4, 4), the finest voxel with a fit: its own, else the nearest face's.

    fits (N, 16) out: that voxel's geometry, kind 0 without a match. A match is refused when the point is further than
    gate_m from the plane or line, or further than 3 sigma along it (the fit says nothing there). Fits are made here,
    when they are first asked for.
    """
    A, V = np.empty((3, 3)), np.empty((3, 3))
    levels = np.int64(rules[1])
    for k in range(len(points_lidar)):
        px, py, pz = points_lidar[k, 0], points_lidar[k, 1], points_lidar[k, 2]
        x = T[0, 0] * px + T[0, 1] * py + T[0, 2] * pz + T[0, 3]
        y = T[1, 0] * px + T[1, 1] * py + T[1, 2] * pz + T[1, 3]
        z = T[2, 0] * px + T[2, 1] * py + T[2, 2] * pz + T[2, 3]
        found = np.int64(-1)
        size = rules[0]
        for level in range(levels):
            fx, fy, fz = x / size, y / size, z / size
            ix, iy, iz = np.int64(math.floor(fx)), np.int64(math.floor(fy)), np.int64(math.floor(fz))
            best = gate_m
            for side in range(4):
                jx, jy, jz = ix, iy, iz
                if side == 1:
                    jx += 1 if fx - ix > 0.5 else -1
                elif side == 2:
                    jy += 1 if fy - iy > 0.5 else -1
                elif side == 3:
                    jz += 1 if fz - iz > 0.5 else -1
                i = slot_of(slots, pack(level, jx, jy, jz))
                key, row = slots[i, 0], slots[i, 1]
                if key == -1:
                    continue
                g = geometry[row]
                if g[KIND] == STALE:
                    fit(key, moments[row], g, rules, A, V)
                if g[KIND] == 0.0:
                    continue
                dx, dy, dz = x - g[0], y - g[1], z - g[2]
                along = dx * g[3] + dy * g[4] + dz * g[5]
                square = dx * dx + dy * dy + dz * dz
                if g[KIND] == PLANE:
                    distance = abs(along)
                    if square - along * along > g[REACH]:
                        continue
                else:
                    distance = math.sqrt(max(square - along * along, 0.0))
                    if along * along > g[REACH]:
                        continue
                if distance < best:
                    best = distance
                    found = row
                if side == 0 and found >= 0:
                    break
            if found >= 0:
                break
            size *= 2.0
        fits[k, KIND] = 0.0
        if found >= 0:
            for c in range(GEOMETRY):
                fits[k, c] = geometry[found, c]


@njit(cache=True, nogil=True)
def forget(slots, moments, geometry, pool, gone):
    """Frees the voxels with the keys `gone` (M,), all in the table; those behind them close up.

    Knuth, "The art of computer programming", volume 3, section 6.4, algorithm R: no search may end at the gap.
    """
    mask = np.int64(len(slots) - 1)
    for k in range(len(gone)):
        i = slot_of(slots, gone[k])
        row = slots[i, 1]
        moments[row], geometry[row] = 0.0, 0.0
        geometry[row, NEXT], pool[FREE] = pool[FREE], row
        j = i
        while True:
            j = (j + 1) & mask
            if slots[j, 0] == -1:
                break
            home = np.int64(home_of(slots, slots[j, 0]))
            if ((j - home) & mask) >= ((j - i) & mask):  # its search passes the gap
                slots[i, 0], slots[i, 1] = slots[j, 0], slots[j, 1]
                i = j
        slots[i, 0] = -1


@njit(cache=True, nogil=True)
def rehash(slots, before):
    """Puts what is in the table `before` into the empty table `slots`."""
    for k in range(len(before)):
        if before[k, 0] != -1:
            i = slot_of(slots, before[k, 0])
            slots[i, 0], slots[i, 1] = before[k, 0], before[k, 1]
