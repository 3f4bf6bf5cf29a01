"""Feature codec: a FeatureFrame as a few hundred bytes to a few kilobytes.

Points are coded where the sensor saw them: ring, column and time follow from the scan order; what is left is a range
along the ring's direction and two small residuals across it, all in whole steps. The decoder puts the points back and
moves them by the frame's own knots, so it has both the deskewed point and the beam it came from.

Version 2 is written, versions 1 and 2 are read, and `recode` makes a 1 of a 2 for services of before. The first byte of
a payload is its version.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from splitslam.codec import version1, version1_encoder, version2
from splitslam.codec.knots import quantise_knots
from splitslam.codec.limits import MAX_POINTS, DecodeError
from splitslam.features import FeatureFrame

__all__ = ["CODEC_VERSION", "MAX_POINTS", "STEP_M", "DecodeError", "decode", "encode", "quantise_knots", "recode"]

CODEC_VERSION = version2.VERSION
STEP_M = 0.02  # mean error 1 cm, at most 1.8 cm: the range noise of a sensor is 2 to 3 cm


def encode(
    frame: FeatureFrame, beam_elevations_rad: NDArray[np.float32], columns: int, step_m: float = STEP_M
) -> bytes:
    """The frame's payload; seq, stamp and dense travel outside of it. The same frame gives the same bytes.

    beam_elevations_rad: (rings,), what the ring numbers mean; columns: of the image. Every decoded point lies within
    step_m / 2 of the frame's along each of three orthogonal axes, its time within 50 us. The intensity of dense frames
    is kept in 16 steps, that of others is 0: only keyframes are exported. Raises ValueError for a frame that breaks the
    contract of FeatureSet (order, ring, column, finite points), which is a programmer's error, and DataError
    (`too_many_features`) for one with more than MAX_POINTS features.
    """
    return version2.encode(frame, beam_elevations_rad, columns, step_m)


def decode(
    payload: bytes, seq: int, stamp_ns: int, dense: bool, beam_elevations_rad: NDArray[np.float32]
) -> FeatureFrame:
    """The frame of a payload of any version so far. DecodeError for anything else."""
    known = {version1.VERSION: version1.decode, version2.VERSION: version2.decode}
    if not payload:
        raise DecodeError("corrupt", "empty")
    if payload[0] not in known:
        raise DecodeError("version", f"codec version {payload[0]}, expected 1 to {CODEC_VERSION}")
    return known[payload[0]](payload, seq, stamp_ns, dense, beam_elevations_rad)


def recode(payload: bytes, version: int, beam_elevations_rad: NDArray[np.float32], columns: int) -> bytes:
    """The frame of `payload` in an older version, at that version's own step: points move by up to half of it more.

    DecodeError for a payload that cannot be read or a version that nothing writes any more.
    """
    if version != version1.VERSION:
        raise DecodeError("version", f"codec version {version} is not written, only 1 and {CODEC_VERSION}")
    # seq and stamp travel outside; intensities are in the payload where there are any
    frame = decode(payload, 0, 0, True, beam_elevations_rad)
    return version1_encoder.encode(frame, beam_elevations_rad, columns)
