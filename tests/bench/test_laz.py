"""LAZ at 1 cm as a yardstick: it must be the real codec, at its best."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np

from splitslam.bench.laz import Laz
from tests.features.made_scan import made_scan


def test_what_was_compressed_comes_back_in_steps_of_a_centimetre():
    import laspy

    lazrs: Any = importlib.import_module("lazrs")
    scan, laz = made_scan(), Laz()
    packed: list[bytes] = []
    compress = laz._compress
    laz._compress = lambda *arguments: packed.append(compress(*arguments)) or packed[-1]
    size = laz.size(scan.points_lidar, scan.ring)
    assert size == len(packed[0])
    dtype = laspy.PointFormat(0).dtype()
    out = np.zeros(len(scan) * dtype.itemsize, np.uint8)
    lazrs.decompress_points(
        np.frombuffer(packed[0], np.uint8), lazrs.LazVlr.new_for_compression(0, 0).record_data(), out, False
    )
    records = out.view(dtype)
    back = np.stack([records["X"], records["Y"], records["Z"]], axis=1) * 0.01
    order = np.argsort(scan.ring, kind="stable")
    assert np.abs(back - scan.points_lidar[order]).max() <= 0.005 + 1e-5


def test_ring_by_ring_it_needs_far_less_than_as_fired():
    scan, laz = made_scan(), Laz()
    fired = np.argsort(scan.t_offset_ns, kind="stable")
    points, ring = scan.points_lidar[fired], scan.ring[fired]
    assert laz.size(points, ring) < 0.6 * laz.size(points, np.zeros_like(ring))
    assert laz.size(points, ring) * 8 / len(scan) < 20
