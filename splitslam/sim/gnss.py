"""A GNSS receiver: WGS84 fixes of its antenna with noise that stays for half a minute, as real ones have."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from splitslam.scan import GnssFix
from splitslam.sim.seeds import stream
from splitslam.sim.spec import DriveSpec, GnssSpec
from splitslam.sim.trajectory import Trajectory

Array = NDArray[np.float64]

_A_M = 6_378_137.0
_E2 = 6.69437999014e-3
_VERTICAL = 2.0  # vertical noise over horizontal


def simulate_gnss(spec: DriveSpec, trajectory: Trajectory) -> list[GnssFix]:
    """All fixes of the drive; none when the spec has no receiver."""
    if spec.gnss is None:
        return []
    gnss = spec.gnss
    count = int(spec.duration_s * gnss.rate_hz)
    t_s = np.arange(count) / gnss.rate_hz
    R, p = trajectory.poses(t_s)
    antenna = p + R @ np.array(gnss.lever_m)
    yaw = np.radians(gnss.enu_yaw_deg)
    enu = antenna @ np.array([[np.cos(yaw), np.sin(yaw), 0], [-np.sin(yaw), np.cos(yaw), 0], [0, 0, 1.0]])
    enu += _noise(spec, gnss, count) + _jump(spec, t_s)
    horizontal = gnss.correlated_noise_m**2 + gnss.white_noise_m**2
    covariance = np.diag([horizontal, horizontal, horizontal * _VERTICAL**2])
    fixes = []
    for t, (latitude, longitude, altitude) in zip(t_s, enu_to_wgs84(enu, gnss.datum_deg_m), strict=True):
        stamp_ns = spec.start_ns + round(t * 1e9)
        fixes.append(GnssFix(stamp_ns, float(latitude), float(longitude), float(altitude), covariance))
    return fixes


def enu_to_wgs84(enu_m: Array, datum_deg_m: tuple[float, float, float]) -> Array:
    """(N, 3) m, east north up at the datum -> (N, 3) latitude deg, longitude deg, altitude m."""
    lat, lon = np.radians(datum_deg_m[0]), np.radians(datum_deg_m[1])
    sl, cl, so, co = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
    R_ecef_enu = np.array([[-so, -sl * co, cl * co], [co, -sl * so, cl * so], [0.0, cl, sl]])
    n = _A_M / np.sqrt(1.0 - _E2 * sl * sl)
    h = datum_deg_m[2]
    origin = np.array([(n + h) * cl * co, (n + h) * cl * so, (n * (1.0 - _E2) + h) * sl])
    x, y, z = (origin + enu_m @ R_ecef_enu.T).T
    flat = np.hypot(x, y)
    latitude = np.arctan2(z, flat * (1.0 - _E2))
    altitude = np.zeros_like(latitude)
    for _ in range(6):  # converges to well under a micrometre near the ground
        n = _A_M / np.sqrt(1.0 - _E2 * np.sin(latitude) ** 2)
        altitude = flat / np.cos(latitude) - n
        latitude = np.arctan2(z, flat * (1.0 - _E2 * n / (n + altitude)))
    return np.stack([np.degrees(latitude), np.degrees(np.arctan2(y, x)), altitude], axis=1)


def _noise(spec: DriveSpec, gnss: GnssSpec, count: int) -> Array:
    rng = stream(spec.seed, "gnss")
    keep = np.exp(-1.0 / (gnss.rate_hz * gnss.correlation_s))
    drive = rng.normal(0.0, 1.0, (count, 3))
    slow = np.empty((count, 3))
    state = drive[0] if count else np.zeros(3)
    for k in range(count):
        slow[k] = state
        state = keep * state + np.sqrt(1.0 - keep * keep) * drive[(k + 1) % count]
    scale = np.array([1.0, 1.0, _VERTICAL])
    return scale * (gnss.correlated_noise_m * slow + gnss.white_noise_m * rng.normal(0.0, 1.0, (count, 3)))


def _jump(spec: DriveSpec, t_s: Array) -> Array:
    """A multipath fault: the fix stands aside for some seconds."""
    faults = spec.perturbations
    on = (t_s >= faults.gnss_jump_at_s) & (t_s < faults.gnss_jump_at_s + faults.gnss_jump_over_s)
    aside_m = faults.gnss_jump_m * np.array([0.8, -0.6, 0.0])
    return np.where(on[:, None], aside_m, 0.0)
