"""The range coder as an object: one stream of numbers that goes out or comes in."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from splitslam.codec import _coder_kernels as kernels
from splitslam.codec._point_kernels import BLOCKS
from splitslam.codec.limits import DecodeError

Integers = NDArray[np.int64]
KNOTS, MOTION, OFFSETS, SLOPES = range(0, 40, 10)  # contexts of `numbers`, in blocks of kernels.BLOCK


class Coder:
    """Numbers pass through `fields`, `numbers` and the point kernels: in while encoding, out while decoding.

    So one function says how a part of a frame is laid out, for both ways.
    """

    def __init__(self, data: NDArray[np.uint8], decoding: bool) -> None:
        self.decoding = decoding
        self._data = data
        model = np.empty(kernels.WEIGHTS + BLOCKS * kernels.BLOCK, np.int32)
        self.arrays = np.empty(6, np.int64), data, model
        kernels.start(*self.arrays, decoding)

    def fields(self, values: list[int], widths: tuple[int, ...]) -> list[int]:
        """Unsigned numbers of so many bits, all equally likely."""
        array = np.array(values, np.int64)
        kernels.code_fields(*self.arrays[:2], array, np.array(widths, np.int64))
        return array.tolist()

    def numbers(self, values: Integers, context: int = MOTION) -> Integers:
        """Signed numbers that are small more often than not; filled in place while decoding."""
        kernels.code_numbers(*self.arrays, context, context // 10, values)
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
