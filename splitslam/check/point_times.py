"""Do points have the times that they were measured at? Told by the world: planes are thin only with the right ones.

A point seen t after the middle of its scan is brought there by `share * t` of the scan's twist:
share 1 when its time is right, 0 when somebody has deskewed the points already, -1 when the times run against the sense
in which the sensor turns. The share is estimated together with the poses of some forty scans and the planes of the
world, whose own parameters are eliminated from the normal equations (Triggs et al., "Bundle adjustment: a modern
synthesis", 2000, section 6.1). Nothing is assumed of how the sensor turns.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitslam import se3
from splitslam.check.findings import Finding, note
from splitslam.check.motion import LidarMotion
from splitslam.check.rotations import exps
from splitslam.scan import Scan

Array = NDArray[np.float64]
_POINTS, _KEPT = 1000, 600  # of a scan; scans, 20 MB
_SCANS, _FEWEST_SCANS = 40, 12
_APART_M, _APART_RAD = 0.3, 0.1
_NEAR_M, _FAR_M = 2.5, 40.0
_VOXEL_M = 1.0
_VOXEL_POINTS, _VOXEL_SCANS, _THICK_M, _FLAT = 12, 5, 0.12, 0.1
_LEAST_PLANES = 50
_NOISE_M = 0.03
_CORRELATION = 8.0  # points of a plane and a laser are wrong together, as in registration
_PRIOR = np.repeat([0.05, 0.3], 3)  # rad, m: of the poses that come in
_PRIOR_SHARE = 10.0  # nothing; where no point has a time, or nothing moves, it stays so
_ITERATIONS = 8
_SURE, _MARGIN = 0.15, 0.4


@dataclass(frozen=True, slots=True)
class TimeShare:
    """share: see above; sigma of it. planes, scans: what it rests on."""

    share: float
    sigma: float
    planes: int
    scans: int


class PointTimeProbe:
    """Takes scans as they come, then looks at those that odometry has placed."""

    def __init__(self) -> None:
        self._scans: dict[int, tuple[Array, Array]] = {}

    def add(self, scan: Scan) -> None:
        """Keeps some points of a scan: those of all directions and, as many lie near, rather the far ones."""
        if len(self._scans) == _KEPT:
            return
        points = scan.points_lidar.astype(np.float64)
        range_m = np.linalg.norm(points, axis=1)
        usable = np.flatnonzero((range_m > _NEAR_M) & (range_m < _FAR_M))
        if len(usable) == 0:
            return
        share = np.cumsum(range_m[usable])
        chosen = usable[np.searchsorted(share, np.linspace(0.0, share[-1], _POINTS, endpoint=False))]
        times_s = scan.t_offset_ns[chosen] * 1e-9
        self._scans[scan.stamp_ns + (scan.end_ns - scan.stamp_ns) // 2] = points[chosen], times_s - times_s.mean()

    def share(self, motion: LidarMotion) -> TimeShare | None:
        """motion: poses at the middles of the scans. None where motion or planes are too few to tell."""
        rows = self._moving(motion)
        if len(rows) < _FEWEST_SCANS:
            return None
        T, t_s = motion.T_odom_lidar, motion.stamps_ns * 1e-9
        twists = [se3.log(se3.inv(T[k - 1]) @ T[k + 1]) / (t_s[k + 1] - t_s[k - 1]) for k in rows]
        seen = [self._scans[int(motion.stamps_ns[k])] for k in rows]
        return _Adjustment(T[rows], seen, np.array(twists)).solve()

    def _moving(self, motion: LidarMotion) -> list[int]:
        """Scans with a neighbour on either side, apart from each other."""
        rows: list[int] = []
        for k in range(1, len(motion) - 1):
            if int(motion.stamps_ns[k]) not in self._scans:
                continue
            moved = se3.inv(motion.T_odom_lidar[rows[-1] if rows else 0]) @ motion.T_odom_lidar[k]
            if np.linalg.norm(moved[:3, 3]) > _APART_M or se3.angle(moved) > _APART_RAD:
                rows.append(k)
            if len(rows) == _SCANS:
                break
        return rows


def findings(found: TimeShare | None) -> list[Finding]:
    """What to say about it: nothing when times are right or the motion does not tell."""
    if found is None or found.sigma > _SURE:
        return []
    told = f"planes are thinnest when points move by {found.share:z.2f} +- {found.sigma:.2f} times their time"
    where = "lidar.point_times"
    if found.share < -1.0 + _MARGIN:
        return [Finding(where, f"{told}: times run against the sense in which the sensor turns", "mirrored")]
    if abs(found.share) < _MARGIN:
        return [Finding(where, f"{told}: they are deskewed already", "one_moment")]
    return [] if abs(found.share - 1.0) < _MARGIN else [note(where, told, "1.00")]


class _Adjustment:
    """Poses of the scans (K, 4, 4), the share, and planes in voxels; planes are found again in each iteration."""

    def __init__(self, T: Array, seen: list[tuple[Array, Array]], twists: Array) -> None:
        """seen: of each scan its points (N, 3), m, and their times (N,), s, about 0. twists: (K, 6)."""
        self._T = T.copy()
        self._points = np.concatenate([points for points, _ in seen])
        self._scan = np.repeat(np.arange(len(seen)), [len(points) for points, _ in seen])
        t_s, twist = np.concatenate([times for _, times in seen])[:, None], twists[self._scan]
        self._skew = t_s * (twist[:, 3:] + np.cross(twist[:, :3], self._points))
        self._share = 0.0

    def solve(self) -> TimeShare | None:
        """Gauss-Newton; None without enough planes."""
        scans = len(self._T)
        xi = np.zeros((scans, 6))
        for _ in range(_ITERATIONS):
            points = self._points + self._share * self._skew
            R = self._T[self._scan, :3, :3]
            world = (R @ points[:, :, None])[:, :, 0] + self._T[self._scan, :3, 3]
            planes = _Planes(world, self._scan)
            if planes.count < _LEAST_PLANES:
                return None
            on, normal = planes.on, planes.normals
            normal_lidar = (R[on].transpose(0, 2, 1) @ normal[:, :, None])[:, :, 0]
            J = np.hstack([np.cross(points[on], normal_lidar), normal_lidar])
            along = np.sum(normal_lidar * self._skew[on], axis=1)
            H, b = _reduced(planes, J, along, self._scan[on], scans)
            prior = np.append(np.tile(_PRIOR**-2.0, scans), _PRIOR_SHARE**-2.0)
            prior[:6] = 1e12  # the first scan stays
            H[np.diag_indices_from(H)] += prior
            step = np.asarray(np.linalg.solve(H, b - prior * np.append(xi.ravel(), self._share)), np.float64)
            turn = step[:-1].reshape(scans, 6)
            xi += turn
            self._T[:, :3, 3] += (self._T[:, :3, :3] @ turn[:, 3:, None])[:, :, 0]
            self._T[:, :3, :3] = self._T[:, :3, :3] @ exps(turn[:, :3])
            self._share += float(step[-1])
        variance = float(np.linalg.inv(H)[-1, -1])
        return TimeShare(self._share, variance**0.5, planes.count, scans)


class _Planes:
    """The voxels of a world (N, 3) that hold a plane seen by several scans.

    on: (M,) points in them. of: (M,) which plane each is on. normals: (M, 3). residual_m: (M,) distance to the plane.
    inside: (M, 3) one, and the point's place in the plane: what offset and tilt of the plane do to the residual.
    """

    def __init__(self, world: Array, scan: NDArray[np.intp]) -> None:
        cell = np.floor(world / _VOXEL_M).astype(np.int64)
        cell -= cell.min(axis=0)
        extent = cell.max(axis=0) + 1
        key = (cell[:, 0] * extent[1] + cell[:, 1]) * extent[2] + cell[:, 2]
        _, voxel, count = np.unique(key, return_inverse=True, return_counts=True)
        voxels, scans = len(count), int(scan.max()) + 1
        seen_by = np.bincount(np.unique(voxel * scans + scan) // scans, minlength=voxels)
        mean = np.stack([np.bincount(voxel, world[:, a], voxels) for a in range(3)], axis=1) / count[:, None]
        centred = world - mean[voxel]
        products = [np.bincount(voxel, centred[:, a] * centred[:, c], voxels) for a in range(3) for c in range(3)]
        values, axes = np.linalg.eigh(np.stack(products, axis=1).reshape(-1, 3, 3) / count[:, None, None])
        good = (count >= _VOXEL_POINTS) & (seen_by >= _VOXEL_SCANS)
        good &= (values[:, 0] < _THICK_M**2) & (values[:, 0] < _FLAT * values[:, 1])
        self.count = int(np.count_nonzero(good))
        self.on = np.flatnonzero(good[voxel])
        place = voxel[self.on]
        self.of = (np.cumsum(good) - 1)[place]
        axes, centred = axes[place], centred[self.on]
        self.normals = axes[:, :, 0]
        u, v = (np.sum(centred * axes[:, :, k], axis=1) for k in (1, 2))
        self.inside = np.stack([np.ones(len(u)), u, v], axis=1)
        self.residual_m = np.sum(centred * self.normals, axis=1)


def _reduced(planes: _Planes, J: Array, along: Array, scan: NDArray[np.intp], scans: int) -> tuple[Array, Array]:
    """Normal equations H (6 K + 1, 6 K + 1), b of poses and share, the planes' own parameters eliminated (Schur).

    J: (M, 6) of each point's residual by its scan's pose, right tangent; along: (M,) by the share.
    """
    r, B, of, size = planes.residual_m, planes.inside, planes.of, 6 * scans + 1
    spread_m = max(_NOISE_M, 1.4826 * float(np.median(np.abs(r))))
    w = 1.0 / ((1.0 + (r / spread_m) ** 2) * spread_m**2 * _CORRELATION)
    H, b = np.zeros((size, size)), np.empty(size)
    cross = np.zeros((planes.count, 3, size))
    for i in range(6):
        b[i:-1:6] = -np.bincount(scan, w * J[:, i] * r, scans)
        H[i:-1:6, -1] = H[-1, i:-1:6] = np.bincount(scan, w * J[:, i] * along, scans)
        for j in range(6):
            at = 6 * np.arange(scans)
            H[at + i, at + j] = np.bincount(scan, w * J[:, i] * J[:, j], scans)
        for k in range(3):
            values = np.bincount(of * scans + scan, w * B[:, k] * J[:, i], planes.count * scans)
            cross[:, k, i:-1:6] = values.reshape(planes.count, scans)
    H[-1, -1], b[-1] = np.sum(w * along**2), -np.sum(w * along * r)
    own, pull = np.empty((planes.count, 3, 3)), np.empty((planes.count, 3))
    for k in range(3):
        cross[:, k, -1] = np.bincount(of, w * B[:, k] * along, planes.count)
        pull[:, k] = np.bincount(of, w * B[:, k] * r, planes.count)
        for m in range(3):
            own[:, k, m] = np.bincount(of, w * B[:, k] * B[:, m], planes.count)
    solved = np.linalg.solve(own + 1e-9 * np.eye(3), cross)
    flat = cross.reshape(-1, size)
    return H - flat.T @ solved.reshape(-1, size), b + solved.reshape(-1, size).T @ pull.reshape(-1)
