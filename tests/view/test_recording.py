"""A recording of a run, and that looking at it tells nobody anything."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

from splitslam.security.loopback import is_loopback
from splitslam.view.folder import RECORDING
from tests.e2e.commands import BIN, run
from tests.security.strace import addresses
from tests.view.made_run import write_run

SCANS = 40
_CHUNK = re.compile(r"^Chunk\(\w+\) with (\d+) rows .*? - (\S+) - data columns: \[(.*)\]", re.MULTILINE)


def rows(recording: Path, path: str, column: str) -> int:
    """How often a column of an entity was logged."""
    command = (sys.executable, "-m", "rerun", "rrd", "print", str(recording))
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    return sum(int(n) for n, found, columns in _CHUNK.findall(said) if found == path and column in columns.split())


def test_a_run_with_view_records_every_scan_and_every_keyframe(shared_data: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    report = run(out, shared_data / "yard1" / "yard1.bag", "--max-scans", str(SCANS), "--view").report
    recording = out / RECORDING
    mapped, keyframes = report["scans"]["mapped"], report["keyframes"]
    assert mapped >= SCANS - 1
    assert rows(recording, "/world/yard1/lidar", "Transform3D:translation") == mapped
    assert rows(recording, "/world/yard1/lidar/matches", "LineStrips3D:strips") == mapped
    clouds = [rows(recording, f"/world/yard1/map/newest/{k}", "Points3D:positions") for k in range(keyframes + 1)]
    assert clouds == [1] * keyframes + [0]
    assert rows(recording, "/uplink/yard1/kbps", "Scalars:scalars") == mapped


def test_a_view_talks_to_this_machine_alone(tmp_path: Path) -> None:
    write_run(tmp_path)
    talked = addresses([str(BIN / "splitslam"), "view", str(tmp_path), "--web", "--seconds", "3"], tmp_path)
    assert talked, "not even Rerun's server was seen"
    assert all(is_loopback(address.removeprefix("::ffff:")) for address, _ in talked), talked
