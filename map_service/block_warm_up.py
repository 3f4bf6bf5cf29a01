"""The kernels of blocks compiled, or read from their cache, before anybody waits for one."""

from __future__ import annotations

import numpy as np

from map_service.block_decoding import decode_block
from map_service.block_encoding import encode_block, first_seen
from map_service.fidelity import FULL, thinned
from map_service.pose_arrays import identities
from map_service.scans import Scans

_SCANS = 4


def warm_up_blocks() -> None:
    """Writes and reads a block of a robot that stands, at full rate and thinned."""
    n, numbers = _SCANS, np.arange(1, _SCANS + 1)
    nothing, none = np.zeros(n, np.int64), np.full((n, 6, 6), np.nan)
    poses = identities(n), identities(n), identities(n)
    factors = np.where(numbers[:, None, None] > 1, np.eye(6), none)
    stamps_ns = numbers * 100_000_000
    scans = Scans(numbers, stamps_ns, nothing, nothing, *poses, factors, np.full(n, ""), np.zeros(n, bool))
    anchors = first_seen(scans)
    for fidelity in (FULL, thinned(1e-3, 1e-3)):
        decode_block(encode_block(scans, anchors, fidelity)[0], anchors)
