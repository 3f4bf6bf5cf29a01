"""Whole scans through both cores on Verilator: no point and no record other than the golden model's."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from edge_agent.features.integer import Limits
from edge_agent.settings import FeatureSettings
from edge_agent.sources import open_recording
from fpga_overlay.cosim.verilated import VerilatedTop
from fpga_overlay.driver.request import ROOM_BEATS, RequestWriter
from fpga_overlay.driver.self_test import made_knots
from fpga_overlay.golden import features, packet
from fpga_overlay.golden.packet import Beats, Header
from fpga_overlay.tb import images, packets
from splitslam.robot import load_robot
from splitslam.scan import Scan

RINGS, COLUMNS, STORED_COLUMNS = 16, 1800, 2048
SCANS = 20


@pytest.fixture(scope="module")
def top() -> VerilatedTop:
    return VerilatedTop(RINGS, STORED_COLUMNS)


def mismatches(answer: Beats, expected: Beats) -> int:
    """Beats that differ, those that are missing or too many with them."""
    common = min(len(answer), len(expected))
    return abs(len(answer) - len(expected)) + int((answer[:common] != expected[:common]).any(axis=1).sum())


def test_twenty_scans_of_a_recording_come_back_without_a_mismatch(top: VerilatedTop, shared_data: Path) -> None:
    folder = shared_data / "yard1"
    writer = RequestWriter(RINGS, COLUMNS, Limits.of(FeatureSettings()))
    knots = made_knots()
    answered = records = wrong = 0
    with open_recording(folder / "yard1.bag", load_robot(folder / "yard1.yaml"), max_scans=SCANS) as recording:
        for _, scan in recording.events():
            if isinstance(scan, Scan):
                request = writer.write(scan, knots, answered, np.zeros((ROOM_BEATS + len(scan), 4), np.uint32))
                answer, _ = top.run(request.beats)
                wrong += mismatches(answer, features.answer(request.header, request.table.words, request.points))
                answered, records = answered + 1, records + int(answer[-1, 0])
    assert (answered, wrong) == (SCANS, 0)
    assert records > 20_000 * SCANS


@pytest.mark.parametrize("order", ["columns", "random"])
def test_made_images_come_back_without_a_mismatch(top: VerilatedTop, order: str) -> None:
    """Walls, steps, holes and cells hit twice; full images and thin ones; the sides pause."""
    rng = np.random.default_rng(5)
    wrong = 0
    for seed, filled in enumerate([1.0, 0.9, 0.3]):
        header = Header(RINGS, COLUMNS - 100 * seed, segments=40, sectors=6 - seed, sequence=seed)
        made = images.scan(header, seed, filled=filled, repeated=0.1, order=order)
        table = packets.motion(rng, packets.breaks(rng, 40, 1 << 22))
        points = packets.points_at(images.directions(header, made) * made.range_q[:, None] / 1024, made.ring)
        points[:, 3] |= rng.integers(0, 1 << 22, len(points), dtype=np.uint32)
        answer, _ = top.run(packet.request(header, table, points), idle=0.2 * seed, stall=0.1 * seed, seed=seed)
        wrong += mismatches(answer, features.answer(header, table, points))
        assert answer[-1, 0] > 0.8 * filled * RINGS * header.columns
    assert wrong == 0


def test_a_scan_takes_a_clock_a_point_and_a_clock_a_cell(top: VerilatedTop) -> None:
    header = Header(RINGS, COLUMNS)
    made = images.scan(header, 1, filled=1.0, repeated=0.0)
    points = packets.points_at(images.directions(header, made) * 10, made.ring)
    table = np.zeros((0, 28), np.int32)
    top.run(packet.request(header, table, points))  # the image may have to be emptied first
    _, clocks = top.run(packet.request(header, table, points))
    assert clocks < 1.01 * 2 * RINGS * COLUMNS
