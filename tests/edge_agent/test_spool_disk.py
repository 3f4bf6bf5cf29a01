"""A disk that is full, read-only or away costs the frames of that time, and is written no more than it must be."""

from __future__ import annotations

import contextlib
import errno
import os
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from edge_agent.spool import Spool
from edge_agent.spool import spool as spool_module
from tests.edge_agent.test_spool import ROOM, frame, kept
from tests.logs.said import said
from tests.missing import missing


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 64 kB, where the test may mount one."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(disk)]
    if os.getuid() != 0 or subprocess.run(mount, capture_output=True).returncode != 0:
        missing("no file system can be mounted here: root, and the right to do it, is needed")
    yield disk
    subprocess.run(["umount", "-l", str(disk)], check=True)


def test_a_full_disk_refuses_frames_without_harm_and_takes_them_again_when_there_is_room(small_disk: Path, caplog):
    spool = Spool(small_disk / "run", 1 << 20)
    taken = [seq for seq in range(1, 300) if spool.put(frame(seq), 0)]
    assert 100 < len(taken) < 220
    assert taken == list(range(1, len(taken) + 1))
    assert spool.errors["full"] == 299 - len(taken)
    ((event, fields),) = said(caplog)
    assert event == "spool disk fails"
    assert "No space left" in fields["detail"]
    assert all(spool.get(seq) == frame(seq) for seq in taken)
    for seq in taken:
        spool.release(seq)
    assert spool.put(frame(300), 0)
    assert spool.get(300) == frame(300)
    assert said(caplog)[-1] == ("spool takes frames again", {"folder": str(small_disk / "run")})
    spool.close()
    assert kept(small_disk / "run") == {300: frame(300)}


def fill(hog: Path) -> None:
    with hog.open("wb", buffering=0) as file, contextlib.suppress(OSError):
        while True:
            file.write(bytes(4096))


def test_a_disk_that_fills_up_from_elsewhere_is_noticed_and_its_recovery_too(small_disk: Path):
    spool = Spool(small_disk, ROOM)
    spool.put(frame(1), 0)
    hog = small_disk / "hog"
    fill(hog)
    refused = [seq for seq in range(2, 20) if not spool.put(frame(seq), 0)]
    assert len(refused) >= 8  # what the last page of the file still held
    hog.unlink()
    assert spool.put(frame(20), 0)
    assert spool.get(1) == frame(1)
    spool.close()


def failing(error: int, wrong: list[bool]) -> Callable[[int, bytes], int]:
    """os.write on a disk that fails while `wrong` says so; one that is full takes half of the bytes."""

    def write(fd: int, data: bytes) -> int:
        if not wrong:
            return os.write(fd, data)
        if error == errno.ENOSPC:
            return os.write(fd, data[: len(data) // 2])
        raise OSError(error, os.strerror(error))

    return write


@pytest.mark.parametrize(
    ("error", "kind"),
    [
        (errno.ENOSPC, "full"), (errno.EDQUOT, "full"), (errno.EROFS, "read_only"),
        (errno.EACCES, "permission"), (errno.EIO, "io"),
    ],
)  # fmt: skip
def test_each_way_to_fail_is_counted_by_its_kind_logged_once_and_leaves_nothing_half_written(
    tmp_path: Path, caplog, error: int, kind: str
):
    wrong: list[bool] = []
    spool = Spool(tmp_path, ROOM, failing(error, wrong))
    assert spool.put(frame(1), 0)
    wrong.append(True)
    assert not any(spool.put(frame(seq, 300 + seq), 0) for seq in range(2, 12))
    assert spool.errors == {kind: 10}
    assert len(caplog.records) == 1
    wrong.clear()
    assert spool.put(frame(12), 0)
    spool.close()
    again = Spool(tmp_path, ROOM)
    assert not again.errors
    assert [head.seq for head in again.recovered.heads] == [1, 12]
    again.close()


def test_a_folder_that_could_not_be_made_is_made_when_it_can(tmp_path: Path):
    spool = Spool(tmp_path / "not" / "yet", ROOM)
    assert spool.put(frame(1), 0)
    spool.close()
    assert kept(tmp_path / "not" / "yet") == {1: frame(1)}


def test_only_frames_that_stay_are_synced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """While connected a frame is gone before it is old enough: a memory card is hardly written."""
    now = {"s": 100.0}
    synced: list[int] = []
    monkeypatch.setattr(spool_module, "_SYNC_EVERY_S", 3600.0)
    monkeypatch.setattr(spool_module, "time", SimpleNamespace(monotonic=lambda: now["s"]))
    monkeypatch.setattr(os, "fsync", synced.append)
    spool = Spool(tmp_path, ROOM)
    for seq in range(1, 60):
        spool.put(frame(seq), 0)
        now["s"] += 0.1
        spool.sync_if_old()
        if seq > 10:
            spool.release(seq - 10)
    assert not synced
    now["s"] += 1.5
    spool.sync_if_old()
    assert len(synced) == 2  # the file and its folder
    spool.sync_if_old()
    assert len(synced) == 2  # nothing new
    for seq in range(50, 60):
        spool.release(seq)
    spool.close()
    assert len(synced) == 2
