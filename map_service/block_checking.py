"""What a block says is read again before its scans have no other place: what cannot be told in one stays as it is."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from map_service.block_decoding import decode_block
from map_service.fidelity import Fidelity
from map_service.pose_arrays import apart
from map_service.scans import Scans
from splitslam.errors import DataError

Array = NDArray[np.float64]
_STEPS = 8.0  # of rounding: a pose that is told against one that is held is off by two steps an axis, and a half


def check_block(content: bytes, scans: Scans, anchors: Mapping[int, Array], fidelity: Fidelity) -> None:
    """Raises DataError("corrupt") unless `content` tells these scans, poses within what `fidelity` allows."""
    read = decode_block(content, anchors)
    same = "seq", "keyframe", "state", "rejected"
    if wrong := [name for name in same if not np.array_equal(getattr(read, name), getattr(scans, name))]:
        raise DataError("corrupt", f"a block of another {wrong[0]} than its scans")
    full = ~read.thinned
    if not np.array_equal(read.stamp_ns[full], scans.stamp_ns[full]):
        raise DataError("corrupt", "a block of other stamps than its scans")
    there = scans.mapped
    for name in ("T_keyframe_lidar", "T_map_lidar", "T_map_odom"):
        off = apart(getattr(scans, name)[there], getattr(read, name)[there])
        turned_rad, moved_m = (np.linalg.norm(part, axis=1).max(initial=0.0) for part in (off[:, :3], off[:, 3:]))
        within_rad = fidelity.within_rad + _STEPS * fidelity.rotation_rad
        within_m = fidelity.within_m + _STEPS * fidelity.position_m
        if not (turned_rad <= within_rad and moved_m <= within_m):  # also for NaN
            raise DataError("corrupt", f"a block that is off by {moved_m:.3g} m and {turned_rad:.3g} rad ({name})")
