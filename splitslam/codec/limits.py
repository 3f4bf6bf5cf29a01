"""What a payload may hold, and the error for one that is not a frame."""

from __future__ import annotations

from splitslam.errors import DataError

MAX_POINTS = 1 << 17  # five times the features of a dense 128 x 2048 image; bounds what a decoder allocates
MAX_RINGS = 256
MAX_COLUMNS = 1 << 16


class DecodeError(DataError):
    """The payload is not a frame of this codec; reason `corrupt` or `version`."""
