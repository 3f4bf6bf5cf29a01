"""Clouds on the robot's disk: bounded, counted, still there after a kill."""

from __future__ import annotations

import errno
from pathlib import Path

import pytest

from edge_agent.clouds.shelf import CloudShelf
from splitslam.wire import dense_pb2 as pb
from tests.dense.made import opening

NEVER_S = 1e9


def shelf(folder: Path, own: pb.UploadOpen | None = None, max_bytes: int = 10_000) -> CloudShelf:
    return CloudShelf(folder / "dense", max_bytes, own or opening())


def seqs(shelf: CloudShelf) -> list[int]:
    return [kept.seq for kept in shelf.due(NEVER_S)]


def test_only_what_the_service_has_called_a_keyframe_is_due(tmp_path: Path):
    here = shelf(tmp_path)
    for seq in (1, 2, 3):
        here.put(seq, bytes(10))
    assert seqs(here) == []
    for seq, is_key in ((2, True), (3, False), (4, True)):
        here.answered(seq, is_key)
    assert seqs(here) == [2]
    assert (here.waiting, here.bytes, dict(here.dropped)) == (2, 20, {})


def test_beyond_its_room_the_oldest_go_and_are_counted(tmp_path: Path):
    here = shelf(tmp_path, max_bytes=100)
    for seq in range(1, 8):
        here.put(seq, bytes(30), is_key=True)
    here.put(8, bytes(101), is_key=True)
    assert seqs(here) == [5, 6, 7]
    assert here.dropped == {"full": 5}
    assert sum(file.stat().st_size for file in (tmp_path / "dense").glob("*/*.key")) == here.bytes == 90


def test_a_killed_agents_clouds_are_due_at_the_next_start_known_or_not(tmp_path: Path):
    own = opening()
    before = shelf(tmp_path, own)
    before.put(1, b"one", is_key=True)
    before.put(2, b"two")
    (tmp_path / "dense" / own.run_id / "00000003.part").write_bytes(b"thr")  # it was about to write this
    again = shelf(tmp_path, own)
    assert [(kept.seq, kept.is_key, kept.inherited) for kept in again.due(NEVER_S)] == [
        (1, True, True),
        (2, False, True),
    ]
    assert [again.read(kept) for kept in again.due(NEVER_S)] == [b"one", b"two"]
    assert not list((tmp_path / "dense").glob("*/*.part"))


def test_runs_of_before_come_after_the_own_one_and_leave_nothing_behind(tmp_path: Path):
    old, own = opening(), opening()
    shelf(tmp_path, old).put(5, b"old", is_key=True)
    here = shelf(tmp_path, own)
    here.put(1, b"own", is_key=True)
    (kept,) = here.due(NEVER_S)
    assert kept.run_id == own.run_id
    here.done(kept)
    (kept,) = here.due(NEVER_S)
    assert here.opening(kept.run_id) == old
    here.done(kept)
    assert not (tmp_path / "dense" / old.run_id).exists()
    assert (here.waiting, dict(here.dropped)) == (0, {})


@pytest.mark.parametrize("left", [b"", b"\x0a\x07rov", None], ids=["empty", "half", "none"])
def test_a_run_whose_opening_was_lost_in_a_power_cut_is_told_by_its_folder_and_its_robot(
    tmp_path: Path, left: bytes | None
):
    old, own = opening(), opening()
    shelf(tmp_path, old).put(5, b"old", is_key=True)
    file = tmp_path / "dense" / old.run_id / "open"
    file.unlink() if left is None else file.write_bytes(left)
    here = shelf(tmp_path, own)
    (kept,) = here.due(NEVER_S)
    assert here.opening(kept.run_id) == old


def test_a_disk_that_is_full_at_the_first_cloud_leaves_no_half_opening(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    own = opening()
    here = shelf(tmp_path, own)

    def torn(path: Path, data: bytes) -> int:
        with path.open("wb") as file:
            file.write(data[:3])
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(Path, "write_bytes", torn)
        here.put(1, b"one")
    here.put(2, b"two")
    assert here.dropped == {"disk": 1}
    folder = tmp_path / "dense" / own.run_id
    assert pb.UploadOpen.FromString((folder / "open").read_bytes()) == own
    assert sorted(file.name for file in folder.iterdir()) == ["00000002.new", "open"]


def test_what_lies_in_the_folder_and_is_none_of_ours_stops_no_agent(tmp_path: Path):
    (tmp_path / "dense").mkdir()
    (tmp_path / "dense" / opening().run_id).write_text("a file where a run's folder should be")
    (tmp_path / "dense" / opening().run_id / "00000001.key").mkdir(parents=True)
    here = shelf(tmp_path)
    here.put(1, b"one", is_key=True)
    while kept := here.due(NEVER_S):
        assert here.read(kept[0]) in (b"one", None)
        here.done(kept[0])
    assert here.waiting == 0


def test_a_disk_that_is_full_costs_counted_clouds_until_it_takes_them_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    here = shelf(tmp_path)

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(Path, "write_bytes", full)
        here.put(1, b"one", is_key=True)
        here.put(2, b"two", is_key=True)
    here.put(3, b"three", is_key=True)
    assert here.dropped == {"disk": 2}
    assert seqs(here) == [3]
    assert here.opening(here.due(NEVER_S)[0].run_id) is not None


def test_a_file_that_is_gone_is_counted(tmp_path: Path):
    here = shelf(tmp_path)
    here.put(1, b"one", is_key=True)
    (kept,) = here.due(NEVER_S)
    next((tmp_path / "dense").glob("*/*.key")).unlink()
    assert here.read(kept) is None
    assert here.dropped == {"damaged": 1}
    assert here.waiting == 0


def test_what_a_killed_agent_had_in_hand_is_asked_about_until_the_service_has_said_what_it_was(tmp_path: Path):
    own = opening()
    before = shelf(tmp_path, own)
    for seq in (1, 2, 3, 4, 5, 6):
        before.take(seq, 10 * seq)
    before.put(1, b"one")
    before.put(6, b"six")
    before.answered(6, False)
    before.answered_without(2, True, "busy")
    for _ in range(2):  # whoever is killed before an answer asks again
        again = shelf(tmp_path, own)
        assert [(kept.seq, kept.gone_ns) for kept in again.due(NEVER_S)] == [(1, None), (3, 30), (4, 40), (5, 50)]
        assert (again.waiting, again.bytes) == (1, 3)
    again.answered(3, True)
    again.answered(4, False)
    again.done(again.due(NEVER_S)[-1], "killed")
    assert again.dropped == {"killed": 2}
    assert seqs(again) == seqs(shelf(tmp_path, own)) == [1]
    assert shelf(tmp_path, own).dropped == {}


def test_a_run_of_before_stays_until_all_that_was_in_hand_is_known(tmp_path: Path):
    old = opening()
    shelf(tmp_path, old).take(7, 70)
    here = shelf(tmp_path)
    (kept,) = here.due(NEVER_S)
    assert (kept.run_id, kept.gone_ns, here.opening(kept.run_id)) == (old.run_id, 70, old)
    here.done(kept)
    assert not (tmp_path / "dense" / old.run_id).exists()
    assert here.dropped == {}


def test_room_is_made_of_clouds_and_not_of_scans_that_have_none(tmp_path: Path):
    own = opening()
    shelf(tmp_path, own).take(1, 10)
    again = shelf(tmp_path, own, max_bytes=100)
    again.put(2, bytes(60), is_key=True)
    again.put(3, bytes(60), is_key=True)
    assert again.dropped == {"full": 1}
    assert seqs(again) == [1, 3]


def test_a_disk_that_takes_no_notes_costs_no_scan(tmp_path: Path):
    (tmp_path / "dense").write_text("no folder")
    here = shelf(tmp_path)
    here.take(1, 10)
    here.answered_without(1, True, "motion")
    assert here.dropped == {"motion": 1}
