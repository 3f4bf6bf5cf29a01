"""Kernels of the registration: points moved, the normal equations of equation 3, and what is solved with them.

Rows of `fits` (N, 16) are the geometry of the voxels that the points (N, 3), frame `lidar`, were matched with, see
_kernels.py; kind 0 without a match. Of symmetric matrices (6, 6) the equations fill the upper triangle.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from splitslam._se3_kernels import exp, log, multiply
from splitslam.registration._kernels import COUNT, FASTMATH, KEYFRAME, KIND, L_MAX, L_MID, L_MIN, LONGEST, PLANE


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def transform(T, points, out):
    """out (N, 3) = T (4, 4) applied to points (N, 3)."""
    for k in range(len(points)):
        x, y, z = points[k, 0], points[k, 1], points[k, 2]
        out[k, 0] = T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]
        out[k, 1] = T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]
        out[k, 2] = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def deskew_again(points, offsets_s, delta_twist, out):
    """out (N, 3) = points, moved by a twist error (6,) for their times (N,), to first order: p + (dv + dw x p) t."""
    wx, wy, wz = delta_twist[0], delta_twist[1], delta_twist[2]
    vx, vy, vz = delta_twist[3], delta_twist[4], delta_twist[5]
    for k in range(len(points)):
        x, y, z, t = points[k, 0], points[k, 1], points[k, 2], offsets_s[k]
        out[k, 0] = x + t * (vx + wy * z - wz * y)
        out[k, 1] = y + t * (vy + wz * x - wx * z)
        out[k, 2] = z + t * (vz + wx * y - wy * x)


@njit(cache=True, nogil=True, fastmath=FASTMATH, inline="always")
def offset_from_fit(g, T, px, py, pz, point_sigma_m):
    """(dx, dy, dz, along, square, variance) of T p against a fit g.

    d: from the fit's mean. along: its part along the normal or line. square: the residual's, off the plane or line.
    variance: of the residual: the fit's own thickness and the sensor's noise, and with them the fit's uncertainty at
    that place (least squares of n points: 1 / n + distance^2 / (n spread)).
    """
    dx = T[0, 0] * px + T[0, 1] * py + T[0, 2] * pz + T[0, 3] - g[0]
    dy = T[1, 0] * px + T[1, 1] * py + T[1, 2] * pz + T[1, 3] - g[1]
    dz = T[2, 0] * px + T[2, 1] * py + T[2, 2] * pz + T[2, 3] - g[2]
    along = dx * g[3] + dy * g[4] + dz * g[5]
    across2 = max(dx * dx + dy * dy + dz * dz - along * along, 0.0)
    if g[KIND] == PLANE:
        square, aside2, thin, spread = along * along, across2, g[L_MIN], g[L_MID]
    else:
        square, aside2, thin, spread = across2, along * along, g[L_MID], g[L_MAX]
    variance = (thin + point_sigma_m * point_sigma_m) * (1.0 + (1.0 + aside2 / (spread + 1e-4)) / g[COUNT])
    return dx, dy, dz, along, square, variance


@njit(cache=True, nogil=True, fastmath=FASTMATH, inline="always")
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
def linearise(fits, points_lidar, T, noise, H, b):
    """Adds the weighted normal equations of equation 3 to H (6, 6), b (6,); returns (matched, inliers, sum r^2).

    Right perturbation T exp(xi), xi = rotation first: d(R p + t) = -R [p]x w + R v. The weight is the inverse
    variance of the residual (`offset_from_fit`) times Cauchy's robust weight. noise (3,): sigma of a point (m), scale
    of the robust weight (sigmas), and the residual (m) beyond which a match counts for nothing.
    """
    matched = 0
    inliers = 0
    squares = 0.0
    J = np.empty(6)
    for k in range(len(points_lidar)):
        g = fits[k]
        if g[KIND] == 0.0:
            continue
        px, py, pz = points_lidar[k, 0], points_lidar[k, 1], points_lidar[k, 2]
        dx, dy, dz, along, square, variance = offset_from_fit(g, T, px, py, pz, noise[0])
        if square > noise[2] * noise[2]:
            continue
        matched += 1
        whitened = square / variance
        weight = 1.0 / ((1.0 + whitened / (noise[1] * noise[1])) * variance)
        if g[KIND] == PLANE:
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
    return matched, inliers, squares


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def spurious(fits, points_lidar, T, noise, H):
    """Adds to H (6, 6) the information that `linearise` reports, in the mean, because fitted axes are noisy.

    A plane's normal wavers about its in-plane axes j with variance l_min / (n l_j), a line's direction about both
    others with l_mid / (n l_max): a smooth tunnel's walls seem to say where along it the sensor is. Variances of
    principal axes to first order: Jolliffe, "Principal Component Analysis", 2002, section 3.6.
    """
    J = np.empty(6)
    for k in range(len(points_lidar)):
        g = fits[k]
        if g[KIND] == 0.0:
            continue
        px, py, pz = points_lidar[k, 0], points_lidar[k, 1], points_lidar[k, 2]
        square, variance = offset_from_fit(g, T, px, py, pz, noise[0])[4:]
        weight = 1.0 / ((1.0 + square / (variance * noise[1] * noise[1])) * variance)
        thin = g[L_MIN] if g[KIND] == PLANE else g[L_MID]
        tilt = max(thin, 2.5e-5) / max(g[COUNT] - 3.0, 1.0)
        for row in range(2):
            if g[KIND] == PLANE:
                lx, ly, lz = g[LONGEST], g[LONGEST + 1], g[LONGEST + 2]
                if row == 0:
                    nx, ny, nz = lx, ly, lz
                    s = weight * tilt / (g[L_MAX] + 1e-6)
                else:
                    nx, ny, nz = g[4] * lz - g[5] * ly, g[5] * lx - g[3] * lz, g[3] * ly - g[4] * lx
                    s = weight * tilt / (g[L_MID] + 1e-6)
            else:  # both directions across the line waver along it
                nx, ny, nz = g[3], g[4], g[5]
                s = weight * tilt / (g[L_MAX] + 1e-6)
            jacobian(T, nx, ny, nz, px, py, pz, J)
            for r in range(6):
                for c in range(r, 6):
                    H[r, c] += s * J[r] * J[c]


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def factorise(A):
    """Cholesky's factor of A (n, n), given by its upper triangle: into the lower one and, of both, the diagonal.

    False where A is not positive definite.
    """
    for c in range(len(A)):
        for r in range(c, len(A)):
            s = A[c, r]
            for k in range(c):
                s -= A[r, k] * A[c, k]
            if r > c:
                A[r, c] = s / A[c, c]
            elif s > 0.0:
                A[c, c] = math.sqrt(s)
            else:
                return False
    return True


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def exceeds(H, other, factor, scale):
    """Is H - factor * other, in units of scale (n,), positive definite? Of both (n, n) the upper triangles count."""
    A = np.empty_like(H)
    for r in range(len(H)):
        for c in range(r, len(H)):
            A[r, c] = (H[r, c] - factor * other[r, c]) / (scale[r] * scale[c])
    return factorise(A)


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def solve(H, information, b, xi, damping, step):
    """Levenberg-Marquardt: step (n,) of (H + information) (1 + damping on the diagonal) = b - information xi.

    False where the sum is not positive definite: step is then zero.
    """
    n = len(H)
    A = np.empty_like(H)
    for r in range(n):
        step[r] = b[r]
        for c in range(n):
            step[r] -= information[r, c] * xi[c]
            if c >= r:
                A[r, c] = H[r, c] + information[r, c]
        A[r, r] *= 1.0 + damping
    if not factorise(A):
        step[:] = 0.0
        return False
    for r in range(n):
        for k in range(r):
            step[r] -= A[r, k] * step[k]
        step[r] /= A[r, r]
    for r in range(n - 1, -1, -1):
        for k in range(r + 1, n):
            step[r] -= A[k, r] * step[k]
        step[r] /= A[r, r]
    return True


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def invert(H, information, out):
    """out (n, n) = (H + information)^-1. False, and out is then zero, where the sum is not positive definite."""
    n = len(H)
    A = np.empty_like(H)
    out[:] = 0.0
    for r in range(n):
        for c in range(r, n):
            A[r, c] = H[r, c] + information[r, c]
    if not factorise(A):
        return False
    for k in range(n):  # the inverse's columns from those of the unit matrix, forwards and back
        out[k, k] = 1.0 / A[k, k]
        for r in range(k + 1, n):
            for c in range(k, r):
                out[r, k] -= A[r, c] * out[c, k]
            out[r, k] /= A[r, r]
        for r in range(n - 1, -1, -1):
            for c in range(r + 1, n):
                out[r, k] -= A[c, r] * out[c, k]
            out[r, k] /= A[r, r]
    return True


@njit(cache=True, nogil=True)
def first_seen(corners, surfs, first):
    """first out: the keyframes that saw first what was matched, of fits (N, 16) of both classes; returns how many."""
    count = 0
    for fits in (corners, surfs):
        for k in range(len(fits)):
            if fits[k, KIND] != 0.0:
                first[count] = np.int64(fits[k, KEYFRAME])
                count += 1
    return count


@njit(cache=True, nogil=True)
def mirror(H):
    """Symmetric H (n, n) from its upper triangle."""
    for r in range(len(H)):
        for c in range(r):
            H[r, c] = H[c, r]


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def equations(corners, surfs, T, noise, H, b):
    """H (6, 6) and b (6,) = the whole normal equations of both classes, each (fits, points); returns as `linearise`."""
    H[:], b[:] = 0.0, 0.0
    of_corners = linearise(corners[0], corners[1], T, noise, H, b)
    of_surfs = linearise(surfs[0], surfs[1], T, noise, H, b)
    mirror(H)
    return of_corners[0] + of_surfs[0], of_corners[1] + of_surfs[1], of_corners[2] + of_surfs[2]


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def spurious_of_both(corners, surfs, T, noise, H):
    """H (6, 6) = the whole spurious information of both classes, each (fits, points)."""
    H[:] = 0.0
    spurious(corners[0], corners[1], T, noise, H)
    spurious(surfs[0], surfs[1], T, noise, H)
    mirror(H)


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def advance(H, information, b, T, T_back, tangents, gains, damping):
    """One step of Levenberg-Marquardt, by which T (4, 4) is moved.

    tangents (3, 6), brought up to date: xi of T from the prediction, whose inverse is T_back; the twist that xi implies
    for the scan; the step. gains (2, 6): of xi to the twist, 1/s; of a tangent to metres at a lever arm.
    Returns by how much the step turns, rad, and moves, m, and by how much the twist has changed, m/s at a lever arm.
    """
    xi, twist, step = tangents[0], tangents[1], tangents[2]
    solve(H, information, b, xi, damping, step)
    D, moved = np.empty((4, 4)), np.empty((4, 4))
    exp(step, D)
    multiply(T, D, moved)
    T[:] = moved
    multiply(T_back, T, D)
    log(D, xi)
    changed = 0.0
    for k in range(6):
        before, twist[k] = twist[k], gains[0, k] * xi[k]
        changed += ((twist[k] - before) * gains[1, k]) ** 2
    turned_rad = math.sqrt(step[0] ** 2 + step[1] ** 2 + step[2] ** 2)
    moved_m = math.sqrt(step[3] ** 2 + step[4] ** 2 + step[5] ** 2)
    return turned_rad, moved_m, math.sqrt(changed)
