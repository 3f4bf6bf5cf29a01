"""`splitslam bench partition` on recordings: what it writes, and that its bytes are those of the recording."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from edge_agent.sources import open_recording
from edge_agent.tally import RAW_IMU_BYTES, RAW_POINT_BYTES
from splitslam.bench import laz
from splitslam.bench.in_one_process import Seen, run_both
from splitslam.robot import load_robot
from splitslam.tum import read_tum
from tests.e2e.commands import run
from tests.typed import typed

SCANS = 12
bench = partial(typed, "splitslam", "bench", "partition")


@pytest.fixture(scope="module")
def made(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    out = tmp_path_factory.mktemp("partition")
    recordings = (shared_data / "yard1/yard1.bag", shared_data / "kitti_0005/kitti_0005_ring16.bag")
    exit_code, text, errors = bench(*recordings, "--max-scans", SCANS, "--out", out)
    assert exit_code == 0, errors
    return out, text


def test_it_writes_json_and_picture_and_prints_the_tables(made: tuple[Path, str]):
    out, text = made
    assert sorted(path.name for path in out.iterdir()) == ["partition.json", "partition.png"]
    assert (out / "partition.png").read_bytes().startswith(b"\x89PNG")
    for part in ("yard1:", "kitti_0005_ring16:", "67.85 and 125.63 Mbit/s", "Case 3, LIO-SAM's features"):
        assert part in text


def test_case_1_is_the_recordings_own_points_and_imu_messages(made: tuple[Path, str], shared_data: Path):
    result = json.loads((made[0] / "partition.json").read_text())["recordings"][0]
    path = shared_data / "yard1/yard1.bag"
    with open_recording(path, load_robot(path.with_suffix(".yaml")), max_scans=SCANS) as recording:
        for _ in recording.events():
            pass
    counts, seconds = recording.counts, (recording.end_ns - recording.start_ns) * 1e-9
    case1 = result["cases"]["case1"]
    assert (result["scans"], result["recording_s"]) == (SCANS, pytest.approx(seconds))
    assert case1["points_mbps"] == pytest.approx(RAW_POINT_BYTES * counts.read_points * 8e-6 / seconds)
    assert case1["imu_mbps"] == pytest.approx(RAW_IMU_BYTES * counts.imu_messages * 8e-6 / seconds)
    assert result["native_mbps"] == pytest.approx(counts.native_bytes * 8e-6 / seconds)


def test_each_cut_is_in_its_place(made: tuple[Path, str]):
    yard1, kitti = json.loads((made[0] / "partition.json").read_text())["recordings"]
    cases = yard1["cases"]
    assert 5_000 <= cases["case3"]["points_per_scan"] <= 7_000  # as between LIO-SAM's own nodes
    assert 0.9 < cases["case2"]["ratio_to_case1"] < 1.1  # the paper: 1 / 1.02
    assert 5.0 < cases["case3"]["ratio_to_case1"] < 12.0  # the paper: 6.7
    assert cases["ours"]["ratio_to_case1"] > 5 * cases["case3"]["ratio_to_case1"]
    assert kitti["native_mbps"] is None
    assert all(case["imu_mbps"] == 0 for name, case in cases.items() if name != "case1")
    if laz.installed():
        assert 7 < yard1["laz_bits_per_point"] < 13


def test_our_bytes_are_more_than_the_payload_and_less_than_twice_it(shared_data: Path, tmp_path: Path):
    path, payload = shared_data / "yard1/yard1.bag", []

    def wire(seen: Seen):
        payload.append(len(seen.frame.payload))
        return seen.decoded()

    run_both(path, path.with_suffix(".yaml"), wire=wire, max_scans=SCANS)
    exit_code, text, errors = bench(
        path, "--robot", path.with_suffix(".yaml"), "--max-scans", SCANS, "--out", tmp_path, "--json"
    )
    assert exit_code == 0, errors
    ours = json.loads(text)["recordings"][0]["cases"]["ours"]["bytes_per_scan"]
    assert np.mean(payload) < ours < 2 * np.mean(payload)


def test_one_process_maps_as_the_programs_do(shared_data: Path, tmp_path: Path):
    path = shared_data / "yard1/yard1.bag"
    mapped = run_both(path, path.with_suffix(".yaml"), max_scans=SCANS)
    programs = run(tmp_path / "run", path, "--max-scans", str(SCANS), "--disable", "loops")
    expected = read_tum(programs.out / "trajectory.tum")
    np.testing.assert_allclose(mapped.final().positions_m, expected.positions_m, atol=1e-8)  # a file has 9 decimals
    assert mapped.counts.scans_read == SCANS


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ([], "Missing argument 'RECORDING...'"),
        (["a.bag"], "a.bag: expected a recording"),
        (["a.bag", "b.bag", "--robot", "c.yaml"], "--robot: expected one recording with it, found 2"),
        (["pyproject.toml", "--max-scans", "0"], "pyproject.yaml: expected a robot file beside the recording"),
        (["pyproject.toml", "--robot", "Makefile", "--max-scans", "0"], "--max-scans: expected at least 1, found 0"),
        (["pyproject.toml", "--robot", "Makefile", "--disable", "gnns"], "nearest: gnss"),
        (["pyproject.toml", "--robot", "nowhere.yaml"], "nowhere.yaml"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(arguments: list[str], expected: str, tmp_path: Path):
    exit_code, out, err = bench(*arguments, "--out", tmp_path / "out")
    assert (exit_code, out) == (2, "")
    assert expected in err
    assert err.count("\n") == 1
    assert not (tmp_path / "out").exists()
