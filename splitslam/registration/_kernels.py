"""Kernels of the local map and the registration.

The voxel map is one open-addressing hash table for all levels. Row layout:
  keys    (C,) int64: level << 60 | ix << 40 | iy << 20 | iz, biased by 2^19; -1: free.
  moments (C, 11) float64: n, sum of (x y z), sum of (xx xy xz yy yz zz), relative to the voxel's centre; index of the
  keyframe that saw the voxel first.
  geometry (C, 13) float64: mean (3), axis (3: plane normal or line direction), l_min, l_mid, l_max, kind, longest
  axis (3).
Kind: 0 none, 1 plane, 2 line. C is a power of two.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

FASTMATH = {"contract", "arcp", "nsz"}
BIAS = 1 << 19
MASK = (1 << 20) - 1
PLANE = 1.0
LINE = 2.0


@njit(cache=True, nogil=True, inline="always")
def pack(level, ix, iy, iz):
    """Key of a voxel; indices wrap at +-2^19 voxels (262 km at 0.5 m)."""
    return (level << 60) | (((ix + BIAS) & MASK) << 40) | (((iy + BIAS) & MASK) << 20) | ((iz + BIAS) & MASK)


@njit(cache=True, nogil=True, inline="always")
def home_of(keys, key):
    """Where `key` is looked for first (Fibonacci hashing)."""
    h = np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)
    return (h >> np.uint64(32)) & np.uint64(len(keys) - 1)


@njit(cache=True, nogil=True, inline="always")
def slot_of(keys, key):
    """First slot that holds `key` or is free (linear probing)."""
    mask = np.uint64(len(keys) - 1)
    i = home_of(keys, key)
    while keys[i] != -1 and keys[i] != key:
        i = (i + np.uint64(1)) & mask
    return np.int64(i)


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def insert(keys, moments, points, keyframe, voxel_m, levels, sign, touched):
    """Adds points (N, 3) to every level; fills `touched` (N * levels) with their slots; returns how many are new.

    sign: 1.0; -1.0 takes points out that are in. A slot may be listed more than once; the caller guarantees room for
    N * levels new voxels.
    """
    count, new = 0, 0
    for k in range(len(points)):
        x, y, z = points[k, 0], points[k, 1], points[k, 2]
        size = voxel_m
        for level in range(levels):
            ix, iy, iz = math.floor(x / size), math.floor(y / size), math.floor(z / size)
            key = pack(level, np.int64(ix), np.int64(iy), np.int64(iz))
            i = slot_of(keys, key)
            if keys[i] == -1:
                keys[i] = key
                moments[i, 10] = keyframe
                new += 1
            dx, dy, dz = x - (ix + 0.5) * size, y - (iy + 0.5) * size, z - (iz + 0.5) * size
            m = moments[i]
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
            touched[count] = i
            count += 1
            size *= 2.0
    return new


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def eigen_symmetric(A, V):
    """Jacobi eigen-decomposition of a symmetric (3, 3); A becomes diagonal, columns of V the eigenvectors."""
    for r in range(3):
        for c in range(3):
            V[r, c] = 1.0 if r == c else 0.0
    for _ in range(12):
        off = A[0, 1] * A[0, 1] + A[0, 2] * A[0, 2] + A[1, 2] * A[1, 2]
        if off <= 1e-22 * (A[0, 0] * A[0, 0] + A[1, 1] * A[1, 1] + A[2, 2] * A[2, 2]) + 1e-40:
            break
        for p in range(2):
            for q in range(p + 1, 3):
                if A[p, q] == 0.0:
                    continue
                theta = (A[q, q] - A[p, p]) / (2.0 * A[p, q])
                t = 1.0 / (abs(theta) + math.sqrt(theta * theta + 1.0))
                if theta < 0.0:
                    t = -t
                c = 1.0 / math.sqrt(t * t + 1.0)
                s = t * c
                for k in range(3):
                    a, b = A[k, p], A[k, q]
                    A[k, p], A[k, q] = c * a - s * b, s * a + c * b
                for k in range(3):
                    a, b = A[p, k], A[q, k]
                    A[p, k], A[q, k] = c * a - s * b, s * a + c * b
                for k in range(3):
                    a, b = V[k, p], V[k, q]
                    V[k, p], V[k, q] = c * a - s * b, s * a + c * b


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def fit(keys, moments, geometry, touched, voxel_m, kind, limits):
    """Refits plane or line of every slot in `touched`.

    limits: (4,) n_min, largest sigma of the thin directions (m), smallest sigma of the wide ones as a share of
    the voxel's size, largest ratio thin/wide sigma. Plane: one thin, two wide; line: two thin, one wide.
    """
    A = np.empty((3, 3))
    V = np.empty((3, 3))
    for j in range(len(touched)):
        i = touched[j]
        m = moments[i]
        g = geometry[i]
        n = m[0]
        g[9] = 0.0
        if n < limits[0]:
            continue
        key = keys[i]
        size = voxel_m * (1 << (key >> 60))
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
            continue
        mid = 3 - lo - hi
        l_min, l_mid, l_max = max(A[lo, lo], 0.0), max(A[mid, mid], 0.0), max(A[hi, hi], 0.0)
        thin, wide, axis = (l_min, l_mid, lo) if kind == PLANE else (l_mid, l_max, hi)
        if thin > limits[1] * limits[1] or thin > limits[3] * limits[3] * wide:
            continue
        if wide < (limits[2] * size) ** 2:
            continue
        g[0] = mx + ((((key >> 40) & MASK) - BIAS) + 0.5) * size
        g[1] = my + ((((key >> 20) & MASK) - BIAS) + 0.5) * size
        g[2] = mz + (((key & MASK) - BIAS) + 0.5) * size
        g[3], g[4], g[5] = V[0, axis], V[1, axis], V[2, axis]
        g[6], g[7], g[8] = l_min, l_mid, l_max
        g[9] = kind
        g[10], g[11], g[12] = V[0, hi], V[1, hi], V[2, hi]


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def match(keys, geometry, points, voxel_m, levels, gate_m, slots):
    """Finds for each point (N, 3), frame of the map, the finest voxel with a fit: its own, else the nearest face's.

    slots: (N,) int64 out, -1 without a match. A match is refused when the point is further than gate_m from the
    plane or line, or further than 3 sigma + gate along it (the fit says nothing there).
    """
    found = 0
    for k in range(len(points)):
        x, y, z = points[k, 0], points[k, 1], points[k, 2]
        slots[k] = -1
        size = voxel_m
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
                i = slot_of(keys, pack(level, jx, jy, jz))
                if keys[i] == -1 or geometry[i, 9] == 0.0:
                    continue
                g = geometry[i]
                dx, dy, dz = x - g[0], y - g[1], z - g[2]
                along = dx * g[3] + dy * g[4] + dz * g[5]
                square = dx * dx + dy * dy + dz * dz
                if g[9] == PLANE:
                    distance = abs(along)
                    if square - along * along > 9.0 * (g[7] + g[8]) + 0.01:
                        continue
                else:
                    distance = math.sqrt(max(square - along * along, 0.0))
                    if along * along > 9.0 * g[8] + 0.01:
                        continue
                if distance < best:
                    best = distance
                    slots[k] = i
                if side == 0 and slots[k] >= 0:
                    break
            if slots[k] >= 0:
                found += 1
                break
            size *= 2.0
    return found


@njit(cache=True, nogil=True, fastmath=FASTMATH, inline="always")
def offset_from_fit(g, n, T, px, py, pz, noise):
    """(dx, dy, dz, along, square, variance) of T p against a fit g of n points.

    d: from the fit's mean. along: its part along the normal or line. square: the residual's, off the plane or line.
    variance: of the residual: the fit's own thickness and the sensor's noise[0]^2, and with them the fit's
    uncertainty at that place (least squares of n points: 1 / n + distance^2 / (n spread)).
    """
    dx = T[0, 0] * px + T[0, 1] * py + T[0, 2] * pz + T[0, 3] - g[0]
    dy = T[1, 0] * px + T[1, 1] * py + T[1, 2] * pz + T[1, 3] - g[1]
    dz = T[2, 0] * px + T[2, 1] * py + T[2, 2] * pz + T[2, 3] - g[2]
    along = dx * g[3] + dy * g[4] + dz * g[5]
    across2 = max(dx * dx + dy * dy + dz * dz - along * along, 0.0)
    if g[9] == PLANE:
        square, aside2, thin, spread = along * along, across2, g[6], g[7]
    else:
        square, aside2, thin, spread = across2, along * along, g[7], g[8]
    variance = (thin + noise[0] * noise[0]) * (1.0 + (1.0 + aside2 / (spread + 1e-4)) / n)
    return dx, dy, dz, along, square, variance


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def jacobian(T, nx, ny, nz, px, py, pz, J):
    """J (6,): of n . (T p), T right-perturbed, rotation first: [p x a, a] with a = R^T n."""
    ax = T[0, 0] * nx + T[1, 0] * ny + T[2, 0] * nz
    ay = T[0, 1] * nx + T[1, 1] * ny + T[2, 1] * nz
    az = T[0, 2] * nx + T[1, 2] * ny + T[2, 2] * nz
    J[0] = py * az - pz * ay
    J[1] = pz * ax - px * az
    J[2] = px * ay - py * ax
    J[3], J[4], J[5] = ax, ay, az


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def linearise(geometry, moments, points_lidar, T, slots, noise, H, b):
    """Adds the weighted normal equations of equation 3 to H (6, 6), b (6,); returns (cost, inliers, sum r^2).

    Right perturbation T exp(xi), xi = rotation first: d(R p + t) = -R [p]x w + R v. The weight is the inverse
    variance of the residual (`offset_from_fit`) times Cauchy's robust weight with scale noise[1].
    """
    cost = 0.0
    inliers = 0
    squares = 0.0
    J = np.empty(6)
    for k in range(len(points_lidar)):
        i = slots[k]
        if i < 0:
            continue
        g = geometry[i]
        px, py, pz = points_lidar[k, 0], points_lidar[k, 1], points_lidar[k, 2]
        dx, dy, dz, along, square, variance = offset_from_fit(g, moments[i, 0], T, px, py, pz, noise)
        whitened = square / variance
        cauchy = 1.0 + whitened / (noise[1] * noise[1])
        cost += noise[1] * noise[1] * math.log(cauchy)
        weight = 1.0 / (cauchy * variance)
        if g[9] == PLANE:
            rows = 1
            nx, ny, nz = g[3], g[4], g[5]
            residual = along
        else:
            ex, ey, ez = dx - along * g[3], dy - along * g[4], dz - along * g[5]
            residual = math.sqrt(ex * ex + ey * ey + ez * ez)
            # the second direction across the line carries no residual, but information
            rows = 2
            if residual > 1e-9:
                nx, ny, nz = ex / residual, ey / residual, ez / residual
            elif abs(g[5]) < 0.9:
                length = math.sqrt(g[3] * g[3] + g[4] * g[4])
                nx, ny, nz = -g[4] / length, g[3] / length, 0.0
            else:
                length = math.sqrt(g[4] * g[4] + g[5] * g[5])
                nx, ny, nz = 0.0, -g[5] / length, g[4] / length
        if whitened < 9.0:
            inliers += 1
            squares += whitened
        for row in range(rows):
            if row == 1:
                nx, ny, nz = g[4] * nz - g[5] * ny, g[5] * nx - g[3] * nz, g[3] * ny - g[4] * nx
                residual = 0.0
            jacobian(T, nx, ny, nz, px, py, pz, J)
            for r in range(6):
                s = weight * J[r]
                b[r] -= s * residual
                for c in range(r, 6):
                    H[r, c] += s * J[c]
    return cost, inliers, squares


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def spurious(geometry, moments, points_lidar, T, slots, noise, H):
    """Adds to H (6, 6) the information that `linearise` reports, in the mean, because fitted axes are noisy.

    A plane's normal wavers about its in-plane axes j with variance l_min / (n l_j), a line's direction about both
    others with l_mid / (n l_max): a smooth tunnel's walls seem to say where along it the sensor is. Variances of
    principal axes to first order: Jolliffe, "Principal Component Analysis", 2002, section 3.6. Upper triangle only.
    """
    J = np.empty(6)
    for k in range(len(points_lidar)):
        i = slots[k]
        if i < 0:
            continue
        g = geometry[i]
        px, py, pz = points_lidar[k, 0], points_lidar[k, 1], points_lidar[k, 2]
        square, variance = offset_from_fit(g, moments[i, 0], T, px, py, pz, noise)[4:]
        weight = 1.0 / ((1.0 + square / (variance * noise[1] * noise[1])) * variance)
        thin = g[6] if g[9] == PLANE else g[7]
        tilt = max(thin, 2.5e-5) / max(moments[i, 0] - 3.0, 1.0)
        for row in range(2):
            if g[9] == PLANE:
                if row == 0:
                    nx, ny, nz = g[10], g[11], g[12]
                    s = weight * tilt / (g[8] + 1e-6)
                else:
                    nx, ny, nz = (
                        g[4] * g[12] - g[5] * g[11],
                        g[5] * g[10] - g[3] * g[12],
                        g[3] * g[11] - g[4] * g[10],
                    )
                    s = weight * tilt / (g[7] + 1e-6)
            else:  # both directions across the line waver along it
                nx, ny, nz = g[3], g[4], g[5]
                s = weight * tilt / (g[8] + 1e-6)
            jacobian(T, nx, ny, nz, px, py, pz, J)
            for r in range(6):
                for c in range(r, 6):
                    H[r, c] += s * J[r] * J[c]


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def transform(T, points, out):
    """out (N, 3) = T (4, 4) applied to points (N, 3)."""
    for k in range(len(points)):
        x, y, z = points[k, 0], points[k, 1], points[k, 2]
        out[k, 0] = T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]
        out[k, 1] = T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]
        out[k, 2] = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]


@njit(cache=True, nogil=True)
def forget(keys, moments, geometry, gone):
    """Frees the voxels with the keys `gone` (M,), all in the table; those behind them close up.

    Knuth, "The art of computer programming", volume 3, section 6.4, algorithm R: no search may end at the gap.
    """
    mask = np.int64(len(keys) - 1)
    for k in range(len(gone)):
        i = slot_of(keys, gone[k])
        j = i
        while True:
            j = (j + 1) & mask
            if keys[j] == -1:
                break
            home = np.int64(home_of(keys, keys[j]))
            if ((j - home) & mask) >= ((j - i) & mask):  # its search passes the gap
                keys[i] = keys[j]
                moments[i] = moments[j]
                geometry[i] = geometry[j]
                i = j
        keys[i] = -1
        moments[i] = 0.0
        geometry[i] = 0.0


@njit(cache=True, nogil=True)
def rehash(keys, live, slots):
    """Puts the keys `live` (M,) into the empty table `keys`; slots (M,) out says where."""
    for k in range(len(live)):
        i = slot_of(keys, live[k])
        keys[i] = live[k]
        slots[k] = i
