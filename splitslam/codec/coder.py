"""The range coder as an object: one stream of numbers that goes out or comes in."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from splitslam.codec import _coder_kernels as kernels
from splitslam.codec._point_kernels import BLOCKS
from splitslam.codec.limits import DecodeError

Integers = NDArray[np.int64]
KNOTS, MOTION, OFFSETS, SLOPES, TIMES = range(0, 50, 10)  # where their contexts begin, in blocks of kernels.BLOCK


class Coder:
    """Numbers pass through `fields`, `numbers` and the point kernels: in while encoding, out while decoding.

    So one function says how a part of a frame is laid out, for both ways.
    """

    def __init__(self, data: NDArray[np.uint8], decoding: bool) -> None:
        self.decoding = decoding
        self._data = data
        model = np.empty(BLOCKS * kernels.BLOCK, np.int32)
        self.arrays = np.empty(kernels.STATE, np.int64), data, model
        kernels.start(*self.arrays, decoding)

    def fields(self, values: Integers, widths: tuple[int, ...]) -> Integers:
        """Unsigned numbers of so many bits, all equally likely; filled in place while decoding."""
        kernels.code_fields(*self.arrays[:2], values, np.array(widths, np.int64))
        return values

    def numbers(self, values: Integers, context: int) -> Integers:
        """Signed numbers that are small more often than not; filled in place while decoding."""
        kernels.code_numbers(*self.arrays, context, values)
        return values

    def close(self) -> bytes:
        """What was encoded; or DecodeError when the data end too early or too late for what was decoded."""
        if not self.decoding:
            size = int(kernels.finish(*self.arrays[:2]))
            if size > len(self._data):
                raise ValueError(f"{size} bytes, expected at most {len(self._data)}")
            return self._data[:size].tobytes()
        beyond = int(self.arrays[0][kernels.POSITION]) - len(self._data)
        if not 0 <= beyond <= kernels.SPARED:
            raise DecodeError("corrupt", f"the decoder stopped {beyond} bytes after the end")
        return b""
