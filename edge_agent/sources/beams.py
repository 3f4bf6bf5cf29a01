"""Elevation of each ring: from the model's table, the robot file's list, or the first scans."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from splitslam.errors import InputError
from splitslam.robot import Lidar

# Ring 0 is the lowest, as the ROS drivers number them (VLP-16 and HDL-32E user manuals).
MODEL_ELEVATIONS_DEG: dict[str, NDArray[np.floating]] = {
    "vlp16": np.arange(-15.0, 15.5, 2.0),
    "hdl32": np.arange(-23.0, 9.0) * np.float64(4.0 / 3.0),
}
_FAR_M = 3.0  # nearer, a laser's own offset in the head bends its elevation
_MERGE_RAD = np.deg2rad(0.12)


def known_elevations_rad(lidar: Lidar) -> NDArray[np.float32] | None:
    """(rings,) float32 when the robot file or the model's table knows them, else None."""
    if lidar.beam_elevations_deg is not None:
        return np.deg2rad(np.array(lidar.beam_elevations_deg)).astype(np.float32)
    table = MODEL_ELEVATIONS_DEG.get(lidar.model)
    if table is None:
        return None
    if len(table) != lidar.rings:
        raise InputError(f"lidar.rings: a {lidar.model} has {len(table)} rings, found {lidar.rings}")
    return np.deg2rad(table).astype(np.float32)


def elevation_rad(points_lidar: NDArray[np.float32]) -> NDArray[np.float32]:
    """(N, 3) m -> (N,) angle above the lidar's x-y plane."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.arctan2(points_lidar[:, 2], np.hypot(points_lidar[:, 0], points_lidar[:, 1]))


def _far(points_lidar: NDArray[np.float32]) -> NDArray[np.bool_]:
    with np.errstate(over="ignore", invalid="ignore"):
        horizontal_m = np.hypot(points_lidar[:, 0], points_lidar[:, 1])
    return np.isfinite(points_lidar).all(axis=1) & (horizontal_m > _FAR_M)


def estimate_per_ring(
    clouds: Sequence[tuple[NDArray[np.float32], NDArray[np.integer]]], rings: int
) -> NDArray[np.float32] | None:
    """Median elevation of every ring over (points_lidar, ring) of several scans, (rings,) float32 rad.

    Rings without a far point are put between their neighbours. None when fewer than two rings were seen.
    """
    points = np.concatenate([cloud[_far(cloud)] for cloud, _ in clouds])
    ring = np.concatenate([ring[_far(cloud)] for cloud, ring in clouds])
    angle = elevation_rad(points)
    seen, medians = [], []
    for number in range(rings):
        of_ring = angle[ring == number]
        if len(of_ring) >= 5:
            seen.append(number)
            medians.append(float(np.median(of_ring)))
    if len(seen) < 2 and rings > 1:
        return None
    elevations = np.interp(np.arange(rings), seen, medians)
    if len(seen) >= 2:  # beyond the outermost rings seen: go on with their spacing
        step = (medians[-1] - medians[0]) / (seen[-1] - seen[0])
        below, above = np.arange(seen[0]), np.arange(seen[-1] + 1, rings)
        elevations[below] = medians[0] + (below - seen[0]) * step
        elevations[above] = medians[-1] + (above - seen[-1]) * step
    return np.clip(elevations, -np.pi / 2, np.pi / 2).astype(np.float32)


def estimate_without_ring(clouds: Sequence[NDArray[np.float32]], rings: int) -> NDArray[np.float32]:
    """The `rings` strongest clusters of elevation, lowest first, (rings,) float32 rad."""
    angle = np.concatenate([elevation_rad(cloud[_far(cloud)]) for cloud in clouds]).astype(np.float64)
    if len(angle) < rings:
        raise InputError("lidar.beam_elevations_deg: must be given: points have no ring and too few are far enough")
    bin_rad = _MERGE_RAD / 4
    low = float(angle.min()) - bin_rad
    histogram = np.bincount(((angle - low) / bin_rad).astype(np.int64) + 2).astype(np.float64)
    smooth = np.convolve(histogram, [0.25, 0.5, 1.0, 0.5, 0.25], mode="same")
    peaks: list[float] = []
    for place in np.argsort(-smooth, kind="stable"):
        centre = low + (place - 1.5) * bin_rad
        if smooth[place] <= 0 or len(peaks) == rings:
            break
        if all(abs(centre - other) > _MERGE_RAD for other in peaks):
            peaks.append(centre)
    if len(peaks) < rings:
        raise InputError(f"lidar.rings: points have no ring and only {len(peaks)} elevations, expected {rings}")
    centres = np.sort(np.array(peaks))
    nearest = nearest_ring(angle, centres)
    medians = [np.median(angle[nearest == number]) for number in range(rings)]
    return np.sort(np.array(medians)).astype(np.float32)


def nearest_ring(angle: NDArray[np.floating], elevations_rad: NDArray[np.floating]) -> NDArray[np.int64]:
    """(N,) elevation -> (N,) index of the nearest of `elevations_rad` (any order); NaN gives 0."""
    order = np.argsort(elevations_rad, kind="stable")
    middles = 0.5 * (elevations_rad[order][1:] + elevations_rad[order][:-1])
    place = np.searchsorted(middles, angle)
    return order[np.minimum(place, len(order) - 1)]
