"""A VLP-16: each ray is cast from where the sensor is at that laser's own firing time, and sent as the sensor does.

Firing pattern and packet layout: VLP-16 User Manual (63-9243), chapters 9.2 to 9.5.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitslam.sim.beams import Beams
from splitslam.sim.seeds import stream
from splitslam.sim.spec import DriveSpec
from splitslam.sim.trajectory import Trajectory, kidnaps_s
from splitslam.sim.world import Hits, World

Array = NDArray[np.float64]

LASERS = 16
FIRING_NS = 55_296  # one firing of all lasers, recharge included
LASER_NS = 2_304
PACKET_FIRINGS = 24  # 12 blocks of two firings
RANGE_UNIT_M = 0.002
ELEVATIONS_DEG = np.array([-15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15], float)  # by laser id
# The beams cross in front of the sensor's middle: each leaves the axis a little above or below it (drawing 86-0101).
_FOCAL_M = 0.04191
ORIGIN_UP_M = -_FOCAL_M * np.tan(np.radians(ELEVATIONS_DEG))

_BLOCK = np.dtype([("flag", "<u2"), ("azimuth", "<u2"), ("returns", [("range", "<u2"), ("intensity", "u1")], 32)])
_PACKET = np.dtype([("blocks", _BLOCK, 12), ("stamp_us", "<u4"), ("mode", "u1"), ("model", "u1")])
_STRONGEST, _VLP16 = 0x37, 0x22
_MAX_TILT = np.radians(80.0)


@dataclass(frozen=True, eq=False)
class Sweep:
    """One turn of the sensor: whole packets, the first one the first that begins in this turn.

    first_firing: counted from the drive's start. range_m (F, 16) float64, 0 for no return; intensity (F, 16) uint8;
    columns are laser ids.
    """

    first_firing: int
    range_m: Array
    intensity: NDArray[np.uint8]

    @property
    def first_ns(self) -> int:
        """Time of the first firing since the drive's start."""
        return self.first_firing * FIRING_NS

    @property
    def last_ns(self) -> int:
        """Time of the last laser's firing since the drive's start."""
        return (self.first_firing + len(self.range_m) - 1) * FIRING_NS + (LASERS - 1) * LASER_NS


class Vlp16:
    """The sensor on its way through a world."""

    def __init__(self, spec: DriveSpec, world: World, trajectory: Trajectory) -> None:
        self._spec = spec
        self._trajectory = trajectory
        self._beams = Beams(spec, world, trajectory)
        bias = stream(spec.seed, "laser bias").normal(0.0, 1.0, LASERS)
        self._laser_bias_m = spec.perturbations.laser_bias_m * bias

    @property
    def scans(self) -> int:
        """Whole turns within the drive."""
        return int(self._spec.duration_s * self._spec.lidar.rate_hz + 1e-9)

    def sweeps(self) -> Iterator[Sweep]:
        """All turns in order, without those that are lost."""
        lost = stream(self._spec.seed, "lost scans").random(self.scans) < self._spec.perturbations.scans_lost
        for k in np.flatnonzero(~lost).tolist():
            yield self._sweep(k)

    def rays(self, firings: NDArray[np.int64]) -> tuple[Array, Array, Array]:
        """Firing numbers (F,) -> times (F * 16,) s, origins and directions (F * 16, 3) in the world frame."""
        ns = firings[:, None] * FIRING_NS + np.arange(LASERS) * LASER_NS
        t_s = ns.ravel().astype(np.float64) * 1e-9
        azimuth = self._azimuth(t_s)
        elevation = np.tile(np.radians(ELEVATIONS_DEG), len(firings))
        flat = np.cos(elevation)
        direction_lidar = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=1)
        R, position = self._trajectory.poses(t_s)
        origin = position + R[:, :, 2] * np.tile(ORIGIN_UP_M, len(firings))[:, None]
        return t_s, origin, np.einsum("nij,nj->ni", R, direction_lidar)

    def _sweep(self, k: int) -> Sweep:
        first, end = (_first_packet(n, self._spec.lidar.rate_hz) * PACKET_FIRINGS for n in (k, k + 1))
        t_s, origins, directions = self.rays(np.arange(first, end))
        range_m, intensity = self._measure(k, self._beams.cast(k, t_s, origins, directions))
        hidden = self._hidden(t_s) | self._blind(k)
        range_m[hidden], intensity[hidden] = 0.0, 0
        return Sweep(first, range_m.reshape(-1, LASERS), intensity.reshape(-1, LASERS))

    def _hidden(self, t_s: Array) -> NDArray[np.bool_]:
        """Beams (N,) into the sector that is blocked: so many degrees wide, behind the sensor."""
        behind = np.abs(np.remainder(self._azimuth(t_s), 2 * np.pi) - np.pi)
        return behind < np.radians(self._spec.perturbations.blocked_deg) / 2

    def _blind(self, k: int) -> bool:
        """In the scan in which it is kidnapped the sensor sees nothing."""
        start = k / self._spec.lidar.rate_hz
        return any(start <= t < start + 1 / self._spec.lidar.rate_hz for t in kidnaps_s(self._spec))

    def _azimuth(self, t_s: Array) -> Array:
        """Where the beams point, rad, left of the sensor's x axis: it turns clockwise, seen from above."""
        return -2 * np.pi * self._spec.lidar.rate_hz * t_s

    def _measure(self, k: int, hits: Hits) -> tuple[Array, NDArray[np.uint8]]:
        """What the sensor reports of true hits: noise, biases, returns too weak, too near or too far."""
        lidar = self._spec.lidar
        rng = stream(self._spec.seed, "range", k)
        noise = rng.normal(0.0, 1.0, (3, len(hits.range_m)))
        true_m = np.where(np.isfinite(hits.range_m), hits.range_m, 0.0)
        tilt = np.arccos(np.clip(hits.cos_incidence, np.cos(_MAX_TILT), 1.0))
        bias = self._spec.perturbations.incidence_bias_m * np.tan(tilt) / np.tan(_MAX_TILT)
        range_m = true_m + lidar.range_noise_m * noise[0] + np.tile(self._laser_bias_m, len(true_m) // LASERS) + bias
        strength = hits.strength * np.exp(0.3 * noise[1])
        seen = (strength > lidar.detection) & (range_m >= lidar.min_range_m) & (range_m <= lidar.max_range_m)
        intensity = np.clip(hits.reflectivity * (0.6 + 0.4 * hits.cos_incidence) + 2.0 * noise[2], 1.0, 255.0)
        return np.where(seen, range_m, 0.0), np.where(seen, intensity, 0.0).astype(np.uint8)


def packets(sweep: Sweep, rate_hz: float, start_ns: int) -> list[tuple[int, bytes]]:
    """(stamp_ns of the first firing, 1206 bytes) of each packet, as the sensor sends them (strongest return)."""
    count = len(sweep.range_m) // PACKET_FIRINGS
    firing = sweep.first_firing + np.arange(count * PACKET_FIRINGS)
    azimuth = np.rint(firing[::2] * (FIRING_NS * 1e-9 * rate_hz * 36_000)).astype(np.int64) % 36_000
    out = np.zeros(count, _PACKET)
    out["blocks"]["flag"] = 0xEEFF
    out["blocks"]["azimuth"] = azimuth.reshape(count, 12)
    out["blocks"]["returns"]["range"] = np.rint(sweep.range_m / RANGE_UNIT_M).reshape(count, 12, 32)
    out["blocks"]["returns"]["intensity"] = sweep.intensity.reshape(count, 12, 32)
    stamps = start_ns + firing[::PACKET_FIRINGS] * FIRING_NS
    out["stamp_us"] = stamps // 1000 % 3_600_000_000  # since the top of the hour
    out["mode"], out["model"] = _STRONGEST, _VLP16
    return [(int(stamp), row.tobytes()) for stamp, row in zip(stamps, out, strict=True)]


def _first_packet(turn: int, rate_hz: float) -> int:
    """Number of the first packet whose first firing lies in this turn."""
    return int(np.ceil(turn / rate_hz / (PACKET_FIRINGS * FIRING_NS * 1e-9) - 1e-9))
