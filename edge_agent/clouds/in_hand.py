"""Whole scans of which neither the disk has the cloud nor the agent the map service's word: what a kill takes along.

A file of records: seq and stamp_ns, int64, little-endian; once a scan is settled its seq again, negative. What the
kernel has taken outlives the agent, though not a power cut.
"""

from __future__ import annotations

import os
import struct
import threading
from pathlib import Path

_RECORD = struct.Struct("<qq")


class InHand:
    """Of one run. `add` and `settle` may be called from any thread and raise OSError when it cannot be noted."""

    def __init__(self, path: Path) -> None:
        """path: of the file, in a folder that is there when something is noted; what it holds already is read."""
        self._path, self._lock = path, threading.Lock()
        self.stamps_ns = _read(path)  # by seq

    def add(self, seq: int, stamp_ns: int) -> None:
        """The scan of this frame may become a loss."""
        with self._lock:
            self.stamps_ns[seq] = stamp_ns
            self._note(seq, stamp_ns)

    def settle(self, seq: int) -> None:
        """Its cloud is on the disk, or was counted, or nobody wants it."""
        with self._lock:
            if self.stamps_ns.pop(seq, None) is None:
                return
            if self.stamps_ns:
                self._note(-seq, 0)
            else:
                os.truncate(self._path, 0)

    def _note(self, seq: int, stamp_ns: int) -> None:
        with self._path.open("ab", buffering=0) as file:
            file.write(_RECORD.pack(seq, stamp_ns))


def _read(path: Path) -> dict[int, int]:
    try:
        data = path.read_bytes()
    except OSError:
        return {}
    found: dict[int, int] = {}
    for seq, stamp_ns in _RECORD.iter_unpack(data[: len(data) // _RECORD.size * _RECORD.size]):
        if seq > 0:
            found[seq] = stamp_ns
        else:
            found.pop(-seq, None)
    return found
