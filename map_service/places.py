"""Places recognised by their looks: a rotation-invariant descriptor of each keyframe's surroundings, and its index.

The descriptor is the highest point in each ring and sector around the place (Scan Context, Kim and Kim, IROS 2018),
kept as its Fourier spectrum along the sectors. The magnitudes of the low frequencies do not change when the robot
looks elsewhere: they are the key for the look-up. The whole spectrum gives, by circular correlation, how alike two
places are and the heading between them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from map_service import _place_kernels as kernels
from map_service.growing import GrowingArray
from map_service.settings import PlaceSettings
from splitslam import se3
from splitslam.errors import DataError

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class PlaceMatch:
    """The most alike older place: likeness -1 .. 1; T_older_newer (4, 4) between levelled frames, a rough guess."""

    older: int
    likeness: float
    T_older_newer: Array


class PlaceIndex:
    """Descriptors of places 0, 1, 2, ... and the search among them."""

    def __init__(self, settings: PlaceSettings) -> None:
        self.settings = s = settings
        self._heights = np.zeros((s.rings, s.sectors))
        self._spectra = GrowingArray((s.rings, s.sectors // 2 + 1), np.complex64)
        self._keys = GrowingArray((s.rings * s.key_frequencies,), np.float32)

    def __len__(self) -> int:
        return len(self._keys)

    def add(self, points_level: NDArray[np.float32]) -> None:
        """Describes the next place: points (N, 3), m, around the sensor, z up."""
        self._append(*self._describe(points_level, np.zeros(2)))

    def packed(self, place: int) -> bytes:
        """A description as it is stored: spectrum complex64, key float32, little-endian; 5 kB."""
        return self._spectra.rows[place].astype("<c8").tobytes() + self._keys.rows[place].astype("<f4").tobytes()

    def add_packed(self, data: bytes) -> None:
        """Adds the next place from what `packed` made. Raises DataError for another length."""
        s = self.settings
        shape, key = (s.rings, s.sectors // 2 + 1), s.rings * s.key_frequencies
        expected = 8 * shape[0] * shape[1] + 4 * key
        if len(data) != expected:
            raise DataError("corrupt", f"place descriptor of {len(data)} bytes: expected {expected}")
        spectrum = np.frombuffer(data, "<c8", shape[0] * shape[1]).reshape(shape)
        self._append(spectrum, np.frombuffer(data, "<f4", key, spectrum.nbytes))

    def _append(self, spectrum: NDArray, key: NDArray) -> None:
        self._spectra.append(spectrum)
        self._keys.append(key)

    def search(self, points_level: NDArray[np.float32], count: int) -> PlaceMatch | None:
        """The most alike of places 0 .. count - 1; None when there are none or the newer place is empty.

        The newer place is also described from beside where it is, so that a robot on another lane finds itself.
        """
        s = self.settings
        if not count:
            return None
        offsets = s.lane_m * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]], float)
        described = [self._describe(points_level, offset) for offset in offsets]
        keys = np.stack([key for _, key in described])
        likenesses = np.einsum("nk,jk->jn", self._keys.rows[:count], keys)  # BLAS would start threads for so little
        best: PlaceMatch | None = None
        for offset, (spectrum, _), likeness in zip(offsets, described, likenesses, strict=True):
            chosen = _largest(likeness, s.shortlist)
            correlation = np.fft.irfft((self._spectra.rows[chosen] * np.conj(spectrum)).sum(axis=1), s.sectors, axis=1)
            i, shift = np.unravel_index(int(np.argmax(correlation)), correlation.shape)
            value = float(correlation[i, shift])
            if value > (0.0 if best is None else best.likeness):
                turn = se3.exp(np.array([0, 0, 2 * np.pi * float(shift) / s.sectors, 0, 0, 0]))
                T = turn @ se3.compose(np.eye(3), np.array([-offset[0], -offset[1], 0.0]))
                best = PlaceMatch(int(chosen[i]), value, T)
        return best

    def _describe(self, points_level: NDArray[np.float32], centre: Array) -> tuple[NDArray, NDArray]:
        """Spectrum (rings, frequencies) and key, both of length 1; zeros for a place without anything in it."""
        s = self.settings
        kernels.polar_heights(points_level, centre, s.reach_m / s.rings, s.floor_m, s.ceiling_m, self._heights)
        relief = self._heights - self._heights.mean(axis=1, keepdims=True)
        spectrum = np.fft.rfft(relief / max(float(np.linalg.norm(relief)), 1e-9), axis=1)
        key = np.abs(spectrum[:, 1 : 1 + s.key_frequencies]).ravel()
        return spectrum.astype(np.complex64), (key / max(float(np.linalg.norm(key)), 1e-9)).astype(np.float32)


def _largest(values: NDArray, count: int) -> NDArray[np.int64]:
    """Indices of the `count` largest values, in order of index."""
    if len(values) <= count:
        return np.arange(len(values))
    return np.sort(np.argpartition(values, -count)[-count:])
