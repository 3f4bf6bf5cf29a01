"""A receiver that stands 15 m aside for 6 s on a recording, and says nothing of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from splitslam.scan import GnssFix
from tests import tolerances
from tests.e2e.replay import TimedEvent, replay

EAST_DEG, NORTH_DEG = 12.0 / 90_600.0, 9.0 / 110_950.0  # 15 m at yard1's latitude


def jumping(events: Iterator[TimedEvent]) -> Iterator[TimedEvent]:
    start_ns = None
    for arrival_ns, event in events:
        start_ns = start_ns or arrival_ns
        if isinstance(event, GnssFix) and 15.0 <= (event.stamp_ns - start_ns) * 1e-9 < 21.0:
            latitude, longitude = event.latitude_deg - NORTH_DEG, event.longitude_deg + EAST_DEG
            event = replace(event, latitude_deg=latitude, longitude_deg=longitude)
        yield arrival_ns, event


def test_yard1_does_not_feel_its_gnss_jump(shared_data: Path):
    recording = shared_data / "yard1" / "yard1.bag"
    calm = replay(recording, max_scans=260)
    jumped = replay(recording, jumping, max_scans=260)
    moved_m = np.linalg.norm(np.array(jumped.T_map_lidar)[:, :3, 3] - np.array(calm.T_map_lidar)[:, :3, 3], axis=1)
    assert jumped.pipeline is not None
    assert jumped.pipeline.statistics()["gnss_rejected"]["gated"] >= 3
    assert jumped.pipeline.stats.gnss_factors >= 3
    assert moved_m.max() < 0.1 * tolerances.GNSS_JUMP_MOVES_MAP_M
    assert jumped.jumps["odom_max_m"] < tolerances.ODOM_STEP_M
