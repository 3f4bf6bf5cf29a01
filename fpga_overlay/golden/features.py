"""The feature core: range image, and curvature, marks and candidates of its points ring by ring.

The kernels are the edge agent's own (`edge_agent.features`): the CPU path and the logic share them.
"""

from __future__ import annotations

import numpy as np

from edge_agent.features import integer
from fpga_overlay.golden import packet
from fpga_overlay.golden.deskew import DeskewedPoints, deskew
from fpga_overlay.golden.packet import Beats, Header


def records(header: Header, points: DeskewedPoints) -> tuple[np.ndarray, int]:
    """((M,) uint64 records, duplicates) of a scan's points, ordered by ring and column; the first of a cell wins."""
    valid = np.flatnonzero(points.flags & packet.POINT_VALID)
    cell = points.ring[valid] * packet.MAX_COLUMNS + points.column[valid]
    cells, first = np.unique(cell, return_index=True)
    index = valid[first]
    ring, column = cells // packet.MAX_COLUMNS, cells % packet.MAX_COLUMNS
    ring_start = np.searchsorted(ring, np.arange(header.rings + 1)).astype(np.int32)
    limits = integer.Limits(header.occlusion, header.corner, header.flat, header.sectors)
    found = integer.FeatureMarks.of(
        points.range_q[index].astype(np.int32), column.astype(np.uint16), ring_start, limits
    )
    fields = [(index, 0), (column, 18), (ring, 29), (found.d, 36), (found.sector, 58), (found.marks, 61)]
    out = np.zeros(len(index), np.uint64)
    for value, shift in fields:
        out |= value.astype(np.uint64) << np.uint64(shift)
    return out, len(valid) - len(index)


def answer(header: Header, table: np.ndarray, points: Beats) -> Beats:
    """The packet that leaves the second core."""
    return answer_to(header, deskew(header, table, points))


def answer_to(header: Header, result: DeskewedPoints) -> Beats:
    """What the second core makes of the first one's result."""
    points, valid = len(result.flags), int(np.count_nonzero(result.flags & packet.POINT_VALID))
    found, duplicates = np.zeros(0, np.uint64), 0
    if not header.flags & packet.BYPASS_FEATURES:
        found, duplicates = records(header, result)
    padded = np.zeros(len(found) + len(found) % 2, np.uint64)
    padded[: len(found)] = found
    status = packet.MAGIC << 16 | packet.VERSION << 8
    trailer = [[status, points, points - valid, header.sequence], [len(found), duplicates, 0, 0]]
    parts = [header.beats(), result.beats(), padded.view(np.uint32).reshape(-1, 4), np.array(trailer, np.uint32)]
    return np.concatenate(parts)
