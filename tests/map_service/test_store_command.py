"""`map-service store ...` and `map-service sessions ...` as an operator types them."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from sqlalchemy import text

from map_service.migrations import VERSION
from map_service.store import Store
from splitslam.ply import read_points
from splitslam.tum import read_tum
from tests.map_service.entries import OPENING, sound
from tests.map_service.fakes import POINTS_LIDAR
from tests.typed import Said, typed

Run = Callable[..., Said]


@pytest.fixture
def run(url: str, tmp_path: Path) -> Run:
    """A command on the store."""

    def on_the_store(*words: str, store: str = url) -> Said:
        return typed("map-service", *words, "--store", store, folder=tmp_path)

    return on_the_store


@pytest.fixture
def filled(url: str) -> None:
    store = Store(url)
    for i in range(2):
        opened = store.open_session(replace(OPENING, session_id=f"r/{i}"))
        store.commit(opened.key, 1, replace(sound(), finished=i == 0))
    store.close()


@pytest.mark.usefixtures("filled")
def test_sessions_are_listed_shown_and_deleted(run: Run) -> None:
    code, out, _ = run("sessions", "list")
    assert code == 0
    assert [line.split()[:5] for line in out.splitlines()] == [
        ["r/0", "site", "finished", "6", "frames"],
        ["r/1", "site", "open", "6", "frames"],
    ]
    assert run("sessions", "list", "--site", "elsewhere") == (0, "", "")
    shown = json.loads(run("sessions", "show", "r/0")[1])
    assert (shown["last_seq"], shown["keyframes"], shown["statistics"]) == (9, 2, {})
    code, out, _ = run("sessions", "delete", "r/0")
    assert code == 0
    assert out.startswith("deleted r/0: 7 frames, 2 keyframes, ")
    code, _, err = run("sessions", "delete", "r/1")
    assert (code, err) == (2, "session 'r/1' has not ended: its robot could not go on with it (--force deletes it)\n")
    assert run("sessions", "delete", "r/1", "--force")[0] == 0
    assert run("sessions", "list") == (0, "", "")
    assert run("sessions", "delete", "r/1") == (2, "", "no session 'r/1'\n")


@pytest.mark.usefixtures("filled")
def test_a_session_is_exported_as_map_and_trajectory_or_not_at_all(run: Run, tmp_path: Path, url: str) -> None:
    out = tmp_path / "out"
    code, said, _ = run("sessions", "export", "r/1", "--out", str(out))
    points = 2 * len(POINTS_LIDAR)
    assert (code, said) == (0, f"{out}/map.ply: {points} points\n{out}/trajectory.tum: 6 poses\n")
    assert len(read_tum(out / "trajectory.tum")) == 6
    assert len(read_points(out / "map.ply")) == points
    run("sessions", "export", "r/1", "--out", str(out), "--voxel-m", "100")
    assert len(read_points(out / "map.ply")) < points
    assert run("sessions", "export", "r/9", "--out", str(out)) == (2, "", "no session 'r/9'\n")
    code, _, err = run("sessions", "export", "r/1", "--out", str(out), "--voxel-m", "0.001")
    assert (code, err) == (2, "--voxel-m: 0.001: expected 0 or 0.01 to 100\n")
    store = Store(url)
    with store.writing() as connection:
        connection.execute(text("UPDATE clouds SET cloud = :bad"), {"bad": b"no cloud"})
    store.close()
    code, _, err = run("sessions", "export", "r/1", "--out", str(tmp_path / "other"))
    assert (code, err.count("\n")) == (2, 1)
    assert "map-service store check" in err
    assert not (tmp_path / "other").exists()


@pytest.mark.usefixtures("filled")
def test_a_store_is_checked_backed_up_and_restored(run: Run, tmp_path: Path, url: str) -> None:
    assert run("store", "check") == (0, "sound: 2 sessions, 12 frames, 4 keyframes\n", "")
    file = tmp_path / "backup"
    code, out, _ = run("store", "backup", str(file))
    assert (code, out.split(":")[1].split(",")[0]) == (0, " 2 sessions")
    assert run("store", "restore", str(file))[0] == 2
    assert run("store", "restore", str(file), "--force")[:2] == (
        0,
        f"{file}: 2 sessions, 14 frames, 4 keyframes restored\n",
    )
    elsewhere = f"sqlite:///{tmp_path}/new.db"
    assert run("store", "check", store=elsewhere) == (2, "", f"store: {elsewhere}: no such file\n")
    folder = f"sqlite:///{tmp_path}"
    assert run("store", "check", store=folder) == (2, "", f"store: {folder}: expected a file, found a directory\n")
    assert run("store", "restore", str(file), store=elsewhere)[0] == 0
    assert run("store", "check", store=elsewhere)[1] == "sound: 2 sessions, 12 frames, 4 keyframes\n"
    store = Store(url)
    with store.writing() as connection:
        connection.execute(text("DELETE FROM clouds WHERE keyframe = 1"))
    store.close()
    assert run("store", "check")[:2] == (1, "r/0: keyframe 1 has no cloud\nr/1: keyframe 1 has no cloud\n")


def test_a_store_is_migrated_both_ways(run: Run, url: str) -> None:
    assert run("store", "migrate") == (0, f"no store -> schema version {VERSION}\n", "")
    assert run("store", "migrate") == (0, f"schema version {VERSION} already\n", "")
    assert run("store", "migrate", "--to", "1") == (0, f"schema version {VERSION} -> schema version 1\n", "")
    Store(url).close()
    assert run("store", "migrate")[1] == f"schema version {VERSION} already\n"
    code, _, err = run("store", "migrate", "--to", "99")
    assert (code, err) == (2, f"store: no way to schema version 99: this program knows 1 to {VERSION}\n")


def test_space_of_a_deleted_session_goes_back_to_the_file_system(run: Run, tmp_path: Path) -> None:
    file = tmp_path / "map.db"
    store = Store(f"sqlite:///{file}")
    opened = store.open_session(OPENING)
    made = sound()
    made.commit.keyframes[1] = replace(made.commit.keyframes[1], cloud=bytes(5_000_000))
    store.commit(opened.key, 1, made)
    store.close()
    before = file.stat().st_size
    out = run("sessions", "delete", "r/1", "--force", store=f"sqlite:///{file}")[1]
    assert "given back to the file system" in out
    assert before > 5_000_000
    assert file.stat().st_size < 500_000


def test_a_file_of_an_older_release_keeps_its_space_until_it_is_compacted(run: Run, tmp_path: Path) -> None:
    file = tmp_path / "old.db"
    store = Store(f"sqlite:///{file}")
    raw = store.engine.raw_connection()
    raw.cursor().execute("PRAGMA auto_vacuum=0")
    raw.cursor().execute("VACUUM")
    raw.close()
    opened = store.open_session(OPENING)
    made = sound()
    made.commit.keyframes[1] = replace(made.commit.keyframes[1], cloud=bytes(5_000_000))
    store.commit(opened.key, 1, made)
    store.close()
    url = f"sqlite:///{file}"
    assert "map-service store compact" in run("sessions", "delete", "r/1", "--force", store=url)[1]
    assert "given back to the file system" in run("store", "compact", store=url)[1]
    assert file.stat().st_size < 500_000
