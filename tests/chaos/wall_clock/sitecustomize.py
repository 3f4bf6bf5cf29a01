"""Lets a test move the wall clock of every Python program that it starts, while they run.

Found by the interpreter itself when this folder is on PYTHONPATH. $CHAOS_CLOCK: a file of 8 bytes, seconds as a double.
Monotonic clocks are left alone, as the kernel leaves them alone when somebody sets the time.
"""

import mmap
import os
import struct
import time

_path = os.environ.get("CHAOS_CLOCK")
if _path:
    with open(_path, "rb") as _file:
        _shift = mmap.mmap(_file.fileno(), 8, prot=mmap.PROT_READ)
    _time, _time_ns = time.time, time.time_ns

    def _shift_s() -> float:
        return struct.unpack("d", _shift[:8])[0]

    time.time = lambda: _time() + _shift_s()
    time.time_ns = lambda: _time_ns() + int(_shift_s() * 1e9)
