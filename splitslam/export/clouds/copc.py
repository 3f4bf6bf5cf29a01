"""Cloud Optimized Point Cloud 1.0: a LAZ file whose chunks are the nodes of an octree, with an index (copc.io)."""

from __future__ import annotations

import importlib
import struct
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any, BinaryIO

import laspy
import numpy as np
from laspy.point.record import PackedPointRecord
from laspy.vlrs.known import LasZipVlr
from laspy.vlrs.vlrlist import VLRList

from splitslam.export.clouds.las import STEP_M, las_header, las_records, lazrs_errors
from splitslam.export.clouds.octree import CELLS, Node, Octree, Root
from splitslam.export.placing import Placing
from splitslam.maps import MapPiece

_INFO = struct.Struct("<5d2Q2d88x")  # centre, half side, spacing, index: offset and size, first and last GPS time
_ENTRY = struct.Struct("<4iQ2i")  # depth, x, y, z, offset, bytes, points
_EVLR_HEADER_BYTES = 60
_RECORD = laspy.PointFormat(6).dtype()


def write_copc_cloud(path: Path, pieces: Iterable[MapPiece], placing: Placing) -> int:
    """Returns the number of points. The map is sorted on disk, in a folder beside `path` (30 bytes a point).

    Raises InputError as las_records does.
    """
    with tempfile.TemporaryDirectory(prefix=".splitslam-", dir=path.parent) as folder:
        octree = Octree(Path(folder), _RECORD)
        for piece in pieces:
            if len(piece.points_map):
                octree.add(las_records(piece, placing))
        with path.open("w+b") as file, lazrs_errors(path):
            return _write(file, octree, placing)


def _write(file: BinaryIO, octree: Octree, placing: Placing) -> int:
    lazrs: Any = importlib.import_module("lazrs")  # compiled, without type information
    laz_vlr = lazrs.LazVlr.new_for_compression(6, 0, use_variable_size_chunks=True)
    header = las_header(placing)
    info = laspy.VLR("copc", 1, "copc info", _INFO.pack(*[0.0] * 5, 0, 0, 0.0, 0.0))
    header.vlrs.insert(0, info)  # where readers expect it
    header.vlrs.append(LasZipVlr(laz_vlr.record_data()))
    header.are_points_compressed = True
    header.partial_reset()
    header.write_to(file)
    compressor = lazrs.LasZipCompressor(file, laz_vlr)
    compressor.reserve_offset_to_chunk_table()  # else before the first chunk, where its offset is taken
    nodes: list[tuple[Node, int, int]] = []  # with start and number of points
    root = octree.root()
    for node, records in octree.nodes():
        header.grow(PackedPointRecord(records, header.point_format))
        if nodes:  # not after the last one: LASzip reads no file that ends with an empty chunk
            compressor.finish_current_chunk()
        nodes.append((node, file.tell(), len(records)))
        compressor.compress_many(np.frombuffer(records.tobytes(), np.uint8))
    compressor.done()
    header.start_of_first_evlr, header.number_of_evlrs = file.tell(), 1
    ends = [start for _, start, _ in nodes[1:]] + [_chunk_table(file, header)]
    page = b"".join(
        _ENTRY.pack(*node, start, end - start, points) for (node, start, points), end in zip(nodes, ends, strict=False)
    )
    file.seek(header.start_of_first_evlr)
    VLRList([laspy.VLR("copc", 1000, "EPT hierarchy", page)]).write_to(file, as_extended=True)
    if not nodes:
        header.maxs, header.mins = np.zeros(3), np.zeros(3)
        header.max_gps_time = header.min_gps_time = 0.0
    info.record_data = _info(root, header, placing, header.start_of_first_evlr + _EVLR_HEADER_BYTES, len(page))
    file.seek(0)
    header.write_to(file, ensure_same_size=True)
    return header.point_count


def _chunk_table(file: BinaryIO, header: laspy.LasHeader) -> int:
    """Where the table of chunks begins: where the last one ends."""
    file.seek(header.offset_to_point_data)
    return struct.unpack("<q", file.read(8))[0]


def _info(root: Root, header: laspy.LasHeader, placing: Placing, offset: int, size: int) -> bytes:
    side_m = 2.0**root.shift * STEP_M
    centre = np.array(root.corner) * STEP_M + placing.offset_m + side_m / 2.0
    times = float(header.min_gps_time), float(header.max_gps_time)
    return _INFO.pack(*centre.tolist(), side_m / 2.0, side_m / 2.0**CELLS, offset, size, *times)
