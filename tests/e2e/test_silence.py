"""A robot whose sensors are switched off where it stands, and on again much later, goes on as if nothing had been."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from edge_agent.sources.time_map import shifted
from splitslam.bench.in_one_process import Harm, Outcome, TimedEvent, run_both
from splitslam.scan import ImuSamples
from tests import tolerances as bars

SCANS, STANDS_NS = 70, 2_000_000_000
SAMPLE_NS = 2_000_000


def silent(seconds: float, imu_goes_on: bool) -> Harm:
    """From 2 s on, while the robot still stands. imu_goes_on: with what it showed until then."""

    def harm(events: Iterator[TimedEvent]) -> Iterator[TimedEvent]:
        quiet_ns, first_ns = round(seconds * 1e9), 0
        seen: list[ImuSamples] = []
        for arrival_ns, event in events:
            first_ns = first_ns or arrival_ns
            if arrival_ns - first_ns < STANDS_NS:
                if isinstance(event, ImuSamples):
                    seen.append(event)
                yield arrival_ns, event
                continue
            if imu_goes_on and seen:
                yield from again(ImuSamples.joined(seen), arrival_ns, quiet_ns)
            seen = []
            yield arrival_ns + quiet_ns, shifted(event, quiet_ns)

    return harm


def again(seen: ImuSamples, arrival_ns: int, quiet_ns: int) -> Iterator[TimedEvent]:
    for first in range(1, quiet_ns // SAMPLE_NS, len(seen)):
        stamps_ns = seen.stamps_ns[-1] + (first + np.arange(len(seen))) * SAMPLE_NS
        late = int(stamps_ns[-1] - seen.stamps_ns[-1])
        if late < quiet_ns:
            yield arrival_ns + late, ImuSamples(stamps_ns, seen.gyro_radps, seen.accel_mps2)


def run(shared_data: Path, harm: Harm) -> Outcome:
    recording = shared_data / "yard1" / "yard1.bag"
    robot = recording.with_suffix(".yaml")
    return run_both(recording, robot, harm=harm, max_scans=SCANS, disable=("gnss",))


@pytest.fixture(scope="module")
def undisturbed(shared_data: Path) -> np.ndarray:
    return run(shared_data, lambda events: events).online().positions_m


@pytest.mark.parametrize(("seconds", "imu_goes_on"), [(4 * 3600.0, False), (300.0, True)], ids=["all", "lidar"])
def test_the_map_goes_on_where_the_robot_stood(
    shared_data: Path, undisturbed: np.ndarray, seconds: float, imu_goes_on: bool
) -> None:
    out = run(shared_data, silent(seconds, imu_goes_on))
    found = out.online().positions_m
    assert len(found) == len(undisturbed) == SCANS
    assert not +out.dropped
    assert np.linalg.norm(found - undisturbed, axis=1).max() < bars.AFTER_SILENCE_M
