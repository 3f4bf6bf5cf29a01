"""`splitslam export` as it is typed: sources, files, mistakes, and what goes wrong on the way."""

from __future__ import annotations

import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path

import laspy
import numpy as np
import pytest

from splitslam.errors import InputError
from splitslam.export import command
from splitslam.export.command import ExportOptions, export
from splitslam.export.formats import FORMATS
from splitslam.ply import read_ply, write_ply
from splitslam.run.progress import Progress
from splitslam.tum import read_tum, write_tum
from tests.conftest import ROOT
from tests.export.conftest import SESSION, Run
from tests.export.made import YOKOHAMA, MadeSource, joined, pieces
from tests.map_service.harness import Service

CLOUDS = ("ply", "pcd", "las", "laz", "copc", "e57")


@pytest.mark.parametrize("name", FORMATS)
def test_a_stored_session_is_written_in_every_format(name: str, run: Run, store_url: str, tmp_path: Path) -> None:
    code, out, err = run(SESSION, "--store", store_url, "--format", name)
    assert (code, err) == (0, "") or name == "g2o"  # which says what it has no line for
    assert code == 0
    path = tmp_path / FORMATS[name].default
    assert out.startswith(f"{FORMATS[name].default}: ")
    assert path.stat().st_size > 100
    assert not list(tmp_path.glob(".*"))
    if name in CLOUDS:
        assert "EPSG:32654" in out


def test_a_server_gives_the_very_file_that_its_store_does(
    run: Run, store_url: str, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    service = Service(tmp_path_factory.mktemp("service"), store=store_url)
    service.start()
    try:
        for name in ("ply", "g2o", "grid"):
            paths = []
            for source in (("--store", store_url), ("--server", service.address)):
                folder = tmp_path / name / source[0]
                folder.mkdir(parents=True)
                code, _, err = run(SESSION, *source, "--format", name, "--out", str(folder / FORMATS[name].default))
                assert code == 0, err
                paths.append(folder)
            for path in paths[0].iterdir():
                if name == "g2o":  # a pose goes over the wire as a quaternion: its last digits differ
                    theirs = [line.split()[1:] for line in (paths[1] / path.name).read_text().splitlines()]
                    for line, other in zip(path.read_text().splitlines(), theirs, strict=True):
                        ours = np.array(line.split()[1:], float)
                        np.testing.assert_allclose(ours, np.array(other, float), rtol=1e-6, atol=1e-6)
                else:
                    assert path.read_bytes() == (paths[1] / path.name).read_bytes(), path.name
        said = run("nobody/1", "--server", service.address)
        assert said == (2, "", f"{service.address}: no session 'nobody/1'\n")
    finally:
        service.close()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """What a run has left."""
    folder = tmp_path / "results"
    folder.mkdir()
    made = MadeSource(pieces())
    write_ply(folder / "map.ply", (piece.points_map.tobytes() for piece in made.made))
    write_tum(folder / "trajectory.tum", made.trajectory())
    return folder


def test_a_run_s_folder_gives_clouds_and_paths(run: Run, folder: Path, tmp_path: Path) -> None:
    for name in ("laz", "tum"):
        assert run(str(folder), "--format", name)[0] == 0
    found = laspy.read(tmp_path / "map.laz").xyz
    np.testing.assert_allclose(found, joined(pieces())[:, :3], atol=0.51e-4)
    assert len(read_tum(tmp_path / "trajectory.tum")) == 5
    assert run(str(folder), "--format", "ply", "--voxel", "2.0")[0] == 0
    thinned = np.concatenate(list(read_ply(tmp_path / "map.ply")))
    cells = np.floor(thinned[:, :3].astype(np.float64) / 2.0)
    assert len(np.unique(cells, axis=0)) == len(thinned)
    assert len(np.unique(np.floor(joined(pieces())[:, :3] / 2.0), axis=0)) == len(thinned)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["r/1", "--format", "lasz"], "--format: expected one of ply, pcd, las, laz, copc, e57, tum, kitti"),
        (["r/1"], "r/1: expected the folder of a run, found none there; for a session ROBOT/RUN say --server"),
        (["r/1", "--server", "a:1", "--store", "sqlite:///b"], "--server, --store: expected one of them, found both"),
        (["r/1", "--store", "sqlite:///nowhere.db"], "store: sqlite:///nowhere.db: no such file"),
        (["results", "--format", "g2o"], "results: the folder of a run has no graph: expected a session"),
        (["results", "--format", "grid"], "results: the folder of a run has no keyframes: expected a session"),
        (["results", "--format", "geojson"], "results: GNSS has not told where the map lies, and GeoJSON is on Earth"),
        (["results", "--frame", "utm"], "--frame utm: results: GNSS has not told where the map lies"),
        (["results", "--frame", "moon"], "--frame: expected one of auto, map, utm, found 'moon'"),
        (["results", "--voxel", "0.001"], "--voxel: 0.001: expected 0 or 0.01 to 100"),
        (["results", "--out", "results"], "--out results: expected a file, found a folder"),
        (["results", "--out", "no/map.ply"], "--out no/map.ply: expected a file in a folder that exists"),
        (["results", "--out", "results/map.ply"], "--out results/map.ply: is there already (--force replaces it)"),
        (["results", "--format", "grid", "--out", "m.pgm"], "--out m.pgm: expected the name of the grid's YAML; its"),
        (["results", "--format", "grid", "--resolution", "0"], "--resolution: expected 0.01 to 1 m, found 0"),
        (["results", "--format", "grid", "--min-height", "3"], "--min-height, --max-height: expected 0 < min < max"),
    ],
)  # fmt: skip
def test_a_mistake_is_one_line(arguments: list[str], expected: str, run: Run, folder: Path) -> None:
    code, out, err = run(*arguments)
    assert (code, out) == (2, "")
    assert err.startswith(expected)
    assert err.count("\n") == 1
    assert sorted(path.name for path in folder.parent.iterdir()) == ["results"]


def test_a_missing_library_is_named_with_what_brings_it(
    run: Run, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from splitslam.export import formats

    monkeypatch.setattr(formats.importlib.util, "find_spec", lambda name: None)
    code, _, err = run(str(folder), "--format", "e57")
    assert (code, err) == (2, "pye57 is not installed: pip install 'splitslam[export]'\n")


def test_a_store_without_the_session_says_so(run: Run, store_url: str) -> None:
    code, _, err = run("rover/2", "--store", store_url)
    assert code == 2
    assert err.endswith("no session 'rover/2'\n")


# -- what goes wrong on the way -----------------------------------------------------------------------------------


def exported(monkeypatch: pytest.MonkeyPatch, source: MadeSource, name: str, out: Path) -> None:
    monkeypatch.setattr(command, "open_source", lambda *_: nullcontext(source))
    with Progress() as progress:
        export(ExportOptions("robot/run", name, out=out, force=True), progress)


@pytest.mark.parametrize("error", [KeyboardInterrupt, InputError])
@pytest.mark.parametrize("name", [*CLOUDS, "grid"])
def test_what_breaks_off_leaves_the_file_as_it_was(
    name: str, error: type[BaseException], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / FORMATS[name].default
    path.write_text("before")
    source = MadeSource(pieces(), fails_after=3, error=error)
    with pytest.raises(error):
        exported(monkeypatch, source, name, path)
    assert path.read_text() == "before"
    assert list(tmp_path.iterdir()) == [path]


@contextmanager
def largest_file(size: int) -> Iterator[None]:
    """As a full disk: writing beyond it fails."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize("name", [*CLOUDS, "grid"])
def test_a_full_disk_leaves_no_half_file(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = MadeSource(pieces(count=20), YOKOHAMA)
    with pytest.raises(OSError), largest_file(100_000):
        exported(monkeypatch, source, name, tmp_path / FORMATS[name].default)
    assert list(tmp_path.iterdir()) == []


SLOW = """
import time
from contextlib import nullcontext
from splitslam.cli import main
from splitslam.export import command
from tests.export.made import MadeSource, pieces

class Slow(MadeSource):
    def pieces(self, voxel_m):
        yield from pieces(count=1)
        print("half", flush=True)
        time.sleep(60)

command.open_source = lambda *_: nullcontext(Slow(pieces()))
main()
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_without_a_trace(number: signal.Signals, tmp_path: Path) -> None:
    arguments = [
        sys.executable,
        "-c",
        SLOW,
        "export",
        "r/1",
        "--format",
        "copc",
        "--out",
        str(tmp_path / "map.copc.laz"),
    ]
    with subprocess.Popen(arguments, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "half\n"
        time.sleep(0.1)
        process.send_signal(number)
        _, err = process.communicate(timeout=100)
    assert (process.returncode, err) == (130, "interrupted\n")
    assert list(tmp_path.iterdir()) == []
