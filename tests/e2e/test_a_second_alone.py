"""A robot that hears nothing from the map service for a second knows where it has gone meanwhile."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from splitslam import se3
from splitslam.alignment import interpolate
from splitslam.tum import read_tum
from tests import tolerances as bars
from tests.e2e.replay import replay

CYCLE, SILENT = 20, 12  # scans: of every 2 s the last 1.2 s without an answer
SETTLED = 60


def test_odom_is_good_to_centimetres_over_a_second_without_corrections(shared_data: Path):
    recording = shared_data / "yard1" / "yard1.bag"
    result = replay(recording, max_scans=400, arrives=lambda seq: seq % CYCLE < CYCLE - SILENT)
    truth = interpolate(read_tum(recording.with_suffix(".tum")), np.array(result.stamps_ns[:-1]))
    true = [se3.from_quat(p, q) for p, q in zip(truth.positions_m, truth.quats_xyzw, strict=True)]
    errors_m = []
    for end in range(SETTLED, len(true)):
        # frame i has seq i + 1; the last answer that `end` has seen is older than a second
        if (end - 1) % CYCLE < CYCLE - 2:
            continue
        begin = end - 10
        gone, was = (se3.inv(poses[begin]) @ poses[end] for poses in (result.T_odom_lidar, true))
        errors_m.append(np.linalg.norm((se3.inv(was) @ gone)[:3, 3]))
    assert len(errors_m) > 20
    print(f"median {np.median(errors_m):.4f} m, largest {np.max(errors_m):.4f} m")
    assert np.median(errors_m) <= bars.ALONE_1S_MEDIAN_M
    assert result.jumps["odom_max_m"] <= bars.ODOM_STEP_M
