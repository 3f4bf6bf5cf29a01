"""The cells of benchmarks/rate_distortion.py: the same edge and map whatever goes over the wire, and bytes counted."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from benchmarks import rate_distortion, wires
from benchmarks.drives import DRIVES, Case, Files
from benchmarks.rate_picture import draw, table
from splitslam.bench.in_one_process import Seen
from splitslam.bench.lio_sam import LioSamFeatures
from splitslam.scan import ScanPacket
from tests.conftest import ROOT
from tests.features.made_scan import KnownMotion, made_scan, make_pipeline


@pytest.fixture
def seen() -> Seen:
    """The third scan of a made room: dense, as the first ones are."""
    edge, scan = make_pipeline(KnownMotion(), deskew="cpu"), made_scan()
    images = []
    node = cast(Any, edge.image_node)
    make, node.image = node.image, lambda *a: images.append(make(*a)) or images[-1]
    frame = edge.process(ScanPacket(scan))
    return Seen(scan, images[-1], frame, edge.columns, edge.beam_elevations_rad)


def test_our_wire_is_our_codec_and_nothing_else(seen: Seen):
    wire = wires.Ours()
    frame = wire(seen)
    assert wire.sent.bytes == len(seen.frame.payload) + wires.OVERHEAD_BYTES
    assert wire.sent.points == len(frame.corners) + len(frame.surfs) == seen.frame.corners + seen.frame.surfs


def test_lio_sams_wire_carries_its_features_to_a_centimetre_and_the_edges_motion(seen: Seen):
    wire = wires.LioSamZstd(20, 0.4)
    frame, ours = wire(seen), seen.decoded()
    features = LioSamFeatures(16, seen.columns)
    assert seen.image.range_q is not None
    marks = wires.FeatureMarks.of(seen.image.range_q, seen.image.column, seen.image.ring_start, features.limits)
    corners, surfs = features.select(seen.image, marks)
    assert (len(frame.corners), len(frame.surfs)) == (len(corners), len(surfs))
    for found, rows in ((frame.corners, corners), (frame.surfs, surfs)):
        expected = np.sort(seen.image.points_lidar[rows], axis=0)
        assert np.abs(np.sort(found.points_lidar, axis=0) - expected).max() < 0.0051
    assert np.array_equal(frame.motion.T_prev_lidar, ours.motion.T_prev_lidar)
    assert (frame.seq, frame.stamp_ns, frame.dense) == (ours.seq, ours.stamp_ns, ours.dense)


def test_every_wire_pays_for_the_motion(seen: Seen):
    draco, lio_sam = wires.ThinnedDraco(0.5), wires.LioSamZstd(20, 0.4)
    for wire in (draco, lio_sam):
        wire(seen)
        assert 40 < wire.sent.bytes - wires.OVERHEAD_BYTES - wire.clouds(seen)[2] < 600
    assert draco.sent.points == len(draco.clouds(seen)[1])


def test_a_drive_over_each_wire_makes_cells_that_are_not_made_again(shared_data: Path, tmp_path: Path):
    command = [sys.executable, "-m", "benchmarks.rate_distortion", "--drives", "yard1", "--max-scans", "6"]
    command += ["--levels", "1", "--out", str(tmp_path)]
    first = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=400)
    assert first.returncode == 0, first.stderr
    cells = {path.name: json.loads(path.read_text()) for path in tmp_path.glob("*.json")}
    assert len(cells) == 3
    for cell in cells.values():
        assert cell["score"]["ate_m"] < 0.05
        assert cell["kbps"] > 100
    again = subprocess.run([*command, "--show"], capture_output=True, text=True, cwd=ROOT, timeout=400)
    assert (again.stdout, again.stderr) == (first.stdout, "")
    assert (tmp_path / "rate_distortion.png").read_bytes().startswith(b"\x89PNG")


def test_with_every_third_scan_every_third_is_sent(shared_data: Path):
    stem = shared_data / "yard1/yard1"
    files = Files(stem.with_suffix(".bag"), stem.with_suffix(".yaml"), stem.with_suffix(".tum"))
    wire = wires.LioSamZstd(every=3)
    cell = rate_distortion.one(files, wire, max_scans=14)
    assert wire.sent.frames == 4
    assert cell["missing"] == 0
    assert not cell["score"]["failed"]


def test_a_failed_cell_is_named_in_the_table_and_drawn_as_failed():
    good = {"level": "a", "kbps": 100.0, "points_per_scan": 500.0, "missing": 0}
    good["score"] = {"ate_m": 0.003, "rpe_1s_m": 0.002, "failed": False}
    bad = {**good, "level": "b", "kbps": 50.0, "score": {"ate_m": 7.0, "rpe_1s_m": 2.0, "failed": True}}
    case = Case(DRIVES["yard1"])
    lines = table({case: {"draco": [good, bad]}}).splitlines()
    assert "fails (7.0 m)" in lines[2]
    assert "| 3.0 |" in lines[3]
    drawn = draw({case: {"draco": [good, bad]}}, "a")
    worse = {**bad, "score": {**bad["score"], "ate_m": 100.0}}
    assert drawn == draw({case: {"draco": [good, worse]}}, "a"), "its error has no place on the axis"
    assert drawn != draw({case: {"draco": [good]}}, "a")


def test_each_system_has_three_rates_or_more_and_a_choice_keeps_the_highest():
    for levels in rate_distortion.SYSTEMS.values():
        assert len(levels) >= 3
        names = list(levels)
        chosen = rate_distortion._spread(names, 3)
        assert len(chosen) <= 3
        assert chosen[-1] == names[-1]


def test_an_unknown_system_is_one_line_and_exit_code_2():
    command = [sys.executable, "-m", "benchmarks.rate_distortion", "--systems", "jpeg"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=200)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "--systems: expected some of ours, lio_sam_zstd, draco, found 'jpeg'\n"
