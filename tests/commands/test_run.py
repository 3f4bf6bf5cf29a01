"""Orchestration with stand-ins for both programs."""

from __future__ import annotations

import json
import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from splitslam.errors import InputError
from splitslam.run.options import RunOptions
from splitslam.run.orchestrate import run_recording
from splitslam.run.processes import RunFailedError
from splitslam.run.progress import Progress
from splitslam.tum import read_tum
from tests.commands import fakes

RESULTS = {
    *("trajectory.tum", "online.tum", "online_covariance.csv", "odom.tum", "imu.tum"),
    *("map.ply", "report.json", "report.html", "keyframes.csv", "scans.csv"),
}


@pytest.fixture(autouse=True)
def nothing_is_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Whatever happens: both programs have ended, and no temporary folder stays."""
    pids = tmp_path / "pids"
    pids.mkdir()
    monkeypatch.setenv("FAKE_PIDS", str(pids))
    yield
    assert not [path for path in pids.iterdir() if Path("/proc", path.read_text()).exists()]
    assert not list(tmp_path.glob("**/.splitslam-*"))


def run(options: RunOptions, edge: str = "good", service: str = "good") -> dict:
    return run_recording(options, Progress(), fakes.programs(edge, service))


def test_a_run_writes_all_results_and_nothing_else(options: RunOptions):
    report = run(options)
    assert {path.name for path in options.out.iterdir()} == RESULTS
    assert json.loads((options.out / "report.json").read_text()) == report
    assert len(read_tum(options.out / "trajectory.tum")) == fakes.SCANS
    assert (options.out / "online.tum").read_text() == fakes.tum_lines(0.01)


def test_the_report_has_every_key_that_is_documented(options: RunOptions):
    report = run(replace(options, truth=_truth(options)))
    documented = set(
        re.findall(r"^\| `([a-z0-9_.]+)`", (Path(__file__).parents[2] / "docs/report.md").read_text(), re.M)
    )
    assert documented >= {"scans.read", "jumps.odom_max_m", "uplink.payload_sha256"}
    assert _leaves(report) == documented


_WHOLE = (
    "dropped_by_reason.",
    "deskew.troubles.",
    "gnss_rejected.",
    "outages.scans.",
    "dense.dropped.",
    "evaluation.trajectory.",
    "evaluation.online.",
)


def _leaves(value: object, prefix: str = "") -> set[str]:
    """Dotted names; the five figures of a stage, and what has names of its own as keys, count as one."""
    if not isinstance(value, dict) or prefix.startswith(_WHOLE) or "mean" in value:
        return {prefix.removesuffix(".")}
    return set().union(*(_leaves(inner, f"{prefix}{key}.") for key, inner in value.items()))


def _truth(options: RunOptions) -> Path:
    path = options.recording.with_name("truth.tum")
    path.write_text(fakes.tum_lines(3.0))
    return path


def test_counts_come_from_both_sides_and_map_cpu_is_per_mapped_scan(options: RunOptions):
    report = run(options)
    assert report["scans"] == {"read": 13, "sent": 12, "mapped": 12, "dropped": 1}
    assert (report["keyframes"], report["loops"], report["gnss_factors"]) == (fakes.KEYFRAMES, 1, 2)
    assert report["cpu_ms_per_scan"] == {"edge": 3.0, "map": 10.0, "reader": 2.0}
    assert report["path_m"] == pytest.approx(0.2 * 11)
    assert "evaluation" not in report


def test_with_a_truth_the_report_is_scored(options: RunOptions):
    report = run(replace(options, truth=_truth(options)))
    assert report["evaluation"]["trajectory"]["ate_m"] == pytest.approx(0.0, abs=1e-9)
    assert report["evaluation"]["online"]["n"] == fakes.SCANS


def test_a_truth_of_another_time_does_not_cost_the_run(options: RunOptions, capfd: pytest.CaptureFixture[str]):
    truth = _truth(options)
    truth.write_text(truth.read_text().replace("1700000000", "1600000000"))
    assert "evaluation" not in run(replace(options, truth=truth))
    assert "not scored" in capfd.readouterr().err.replace("\n", " ")


def test_the_map_is_a_binary_ply_of_all_keyframes_points(options: RunOptions):
    run(options)
    header, _, body = (options.out / "map.ply").read_bytes().partition(b"end_header\n")
    lines = header.decode().splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    assert [line for line in lines if line.startswith("property")] == [
        f"property float {name}" for name in ("x", "y", "z", "intensity")
    ]
    count = int(next(line for line in lines if line.startswith("element vertex")).split()[-1])
    points = np.frombuffer(body, "<f4").reshape(-1, 4)
    assert count == len(points) == fakes.KEYFRAMES * fakes.POINTS
    assert np.array_equal(points[: fakes.POINTS], np.random.default_rng(0).normal(size=(fakes.POINTS, 4)).astype("<f4"))


def test_the_page_needs_no_other_file_and_no_network(options: RunOptions):
    run(replace(options, truth=_truth(options)))
    page = (options.out / "report.html").read_text()
    assert page.count("<svg") == 6
    assert not re.search(r'(src|href)="(?!data:|#)', page)
    assert "<script" not in page
    assert "$" not in re.sub(r"<svg.*?</svg>|data:image[^\"]*", "", page, flags=re.S)


def test_foreign_files_and_folders_in_out_stay(options: RunOptions):
    options.out.mkdir()
    (options.out / "notes.txt").write_text("mine")
    (options.out / "trajectory.tum").write_text("of an earlier run")
    run(options)
    assert (options.out / "notes.txt").read_text() == "mine"
    assert len(read_tum(options.out / "trajectory.tum")) == fakes.SCANS


@pytest.mark.parametrize(
    ("edge", "service", "expected", "exit_code"),
    [
        ("bad_input", "good", r"^some\.bag: topic /points: expected one of /a, /b$", 2),
        ("note_then_bad_input", "good", r"^127\.0\.0\.1:1: expected a map service there$", 2),
        ("crash", "good", r"edge-agent ended with exit code 1: RuntimeError: wheels came off", 1),
        ("killed", "good", "edge-agent was ended by SIGKILL", 1),
        ("stopped", "good", "stopped before the end", 1),
        ("hang", "crash", r"map-service ended with exit code 3: Fatal: out of memory", 1),
        ("deaf", "crash", r"map-service ended with exit code 3", 1),
        ("good", "bad_port", r"^map-service: listen 127\.0\.0\.1:0: cannot be bound$", 2),
        ("good", "no_map", "map service: StreamMap: the cloud is gone", 1),
        ("good", "empty", "no scan was mapped", 1),
    ],
)
def test_a_run_that_fails_says_why_and_writes_nothing(
    options: RunOptions, monkeypatch: pytest.MonkeyPatch, edge: str, service: str, expected: str, exit_code: int
):
    monkeypatch.setattr("splitslam.run.agent._STOP_S", 0.5)
    with pytest.raises(RunFailedError, match=expected) as caught:
        run(options, edge, service)
    assert caught.value.exit_code == exit_code
    assert not options.out.exists()


def test_bad_input_shows_the_error_only_and_a_crash_shows_what_came_before(
    options: RunOptions, capfd: pytest.CaptureFixture[str]
):
    with pytest.raises(RunFailedError):
        run(options, "note_then_bad_input")
    assert capfd.readouterr().err == ""
    with pytest.raises(RunFailedError):
        run(options, "crash")
    shown = capfd.readouterr().err
    assert shown.startswith("lidar.topic: /points chosen\n")
    assert "Traceback" in shown


def test_a_service_that_ignores_sigterm_is_killed(options: RunOptions, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("splitslam.run.service._STOP_S", 0.5)
    assert run(options, service="deaf")["keyframes"] == fakes.KEYFRAMES


def test_a_failed_run_leaves_results_of_an_earlier_one_as_they_were(options: RunOptions):
    run(options)
    before = {path.name: path.read_bytes() for path in options.out.iterdir()}
    with pytest.raises(RunFailedError):
        run(options, "crash")
    assert {path.name: path.read_bytes() for path in options.out.iterdir()} == before


def test_options_beat_the_environment_and_that_beats_the_file(
    options: RunOptions, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    file = tmp_path / "run.yaml"
    file.write_text(
        "edge: {uplink: {max_kbps: 100, window: 3}, pipeline: {deskew: off, step_m: 0.02}, site_id: file}\n"
    )
    monkeypatch.setenv("SPLITSLAM_EDGE__SITE_ID", "environment")
    monkeypatch.setenv("SPLITSLAM_EDGE__SERVER", "10.0.0.1:1")
    monkeypatch.setenv("SPLITSLAM_EDGE__UPLINK__MAX_KBPS", "200")
    monkeypatch.setenv("FAKE_CONFIG", str(tmp_path / "seen.json"))
    monkeypatch.delenv("SPLITSLAM_DATA", raising=False)  # of these tests themselves
    run(
        replace(
            options, config=file, max_kbps=300.0, deskew="cpu", disable=("loops", "gnss"), max_scans=7, realtime=True
        )
    )
    seen = json.loads((tmp_path / "seen.json").read_text())
    assert (seen["uplink"]["max_kbps"], seen["uplink"]["window"]) == (300.0, 3)
    assert (seen["pipeline"]["deskew"], seen["pipeline"]["step_m"]) == ("cpu", 0.02)
    assert seen["site_id"] == "environment"
    assert seen["environment"] == []
    assert seen["server"].startswith("127.0.0.1:")
    assert seen["disable"] == ["loops", "gnss"]
    source = {"realtime": True, "max_scans": 7, "queue_scans": 20, "began_s": None}
    source |= dict.fromkeys(("live", "ros1", "ros2"))
    assert seen["source"] | {"recording": ""} == {"recording": "", **source}


def test_a_given_server_is_used_and_none_is_started(options: RunOptions, tmp_path: Path):
    with pytest.raises(RunFailedError, match="map service: Get"):
        run(replace(options, server="127.0.0.1:1"))
    assert not (tmp_path / "pids" / "map.pid").exists()


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (
            "edge: {uplink: {max_kps: 1}}",
            r"run\.yaml: edge: uplink\.max_kps: unknown key; nearest known: uplink\.max_kbps",
        ),
        ("map: {pipeline: {loops: {radius: 1}}}", r"run\.yaml: map: pipeline\.loops\.radius: unknown key"),
        ("edge: {server: 'a:1'}", r"run\.yaml: edge\.server: expected not to be given here"),
        ("map: 3", r"run\.yaml: map: expected keys and values, found 3"),
        ("uplink: {}", r"run\.yaml: uplink: unknown key; expected the sections edge and map"),
    ],
)
def test_a_bad_configuration_is_found_before_anything_is_started(
    options: RunOptions, tmp_path: Path, text: str, expected: str
):
    file = tmp_path / "run.yaml"
    file.write_text(text)
    with pytest.raises(InputError, match=expected) as caught:
        run(replace(options, config=file))
    assert "\n" not in str(caught.value)
    assert not list((tmp_path / "pids").iterdir())


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"recording": Path("nowhere.bag")}, r"^nowhere\.bag: expected a recording"),
        ({"deskew": "gpu"}, r"^--deskew: expected one of auto, .*, found 'gpu'"),
        ({"disable": ("loop",)}, r"^--disable: expected one of loops, gnss, imu, wheels, found 'loop'; nearest: loops"),
        ({"max_kbps": 0.0}, r"^--max-kbps: expected more than 0"),
        ({"max_kbps": float("nan")}, r"^--max-kbps: expected more than 0"),
        ({"max_scans": 0}, r"^--max-scans: expected at least 1"),
        ({"server": "nowhere"}, r"^--server: expected host:port"),
        ({"robot": Path("nowhere.yaml")}, r"^nowhere\.yaml: "),
        ({"truth": Path("nowhere.tum")}, r"^nowhere\.tum: expected a trajectory"),
        ({"config": Path("nowhere.yaml")}, r"^nowhere\.yaml: "),
        ({"out": Path("/proc/nowhere")}, r"^--out /proc/nowhere: expected a folder that can be written"),
        ({"out": Path(__file__)}, r"^--out .*test_run\.py: expected a folder that can be written"),
        ({"picture": Path("/nowhere/a.png")}, r"^--picture /nowhere/a\.png: expected a file in a folder that exists"),
    ],
)
def test_a_bad_option_is_one_line_that_names_it(options: RunOptions, tmp_path: Path, change: dict, expected: str):
    with pytest.raises(InputError, match=expected) as caught:
        run(replace(options, **change))
    assert "\n" not in str(caught.value)
    assert not list((tmp_path / "pids").iterdir())
    assert not options.out.exists()


def test_a_picture_is_a_png(options: RunOptions, tmp_path: Path):
    run(replace(options, picture=tmp_path / "run.png"))
    assert (tmp_path / "run.png").read_bytes().startswith(b"\x89PNG")


def test_configuration_files_are_yaml_the_programs_can_read(options: RunOptions):
    from splitslam.config import dump, load
    from splitslam.run.configs import configs

    agent, service = configs(options, Path(os.devnull))
    for model in (agent, service):
        path = options.recording.with_name("again.yaml")
        path.write_text(dump(model))
        assert load(type(model), path) == model
        assert isinstance(yaml.safe_load(dump(model)), dict)
