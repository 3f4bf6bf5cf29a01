"""The outbox with a spool under it: what is in memory, what is on disk, and what a second agent makes of it."""

from __future__ import annotations

import errno
import itertools
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from edge_agent.outbox import Lost, Outbox
from edge_agent.spool import Spool
from splitslam.wire import session_pb2 as pb
from tests.edge_agent.test_spool import ROOM, frame
from tests.edge_agent.test_spool_disk import failing


@pytest.fixture
def spools(tmp_path: Path) -> Iterator[list[Spool]]:
    """Spools opened by `outbox`, closed at the end."""
    opened: list[Spool] = []
    yield opened
    for spool in opened:
        spool.close()


def outbox(
    folder: Path, spools: list[Spool], max_bytes: int = ROOM, write=os.write, limit_bytes: int = 10**6, copies: int = 0
) -> Outbox:
    """With the window wide open; a spool that another agent has open is closed first."""
    for spool in spools:
        spool.close()
    spools.append(Spool(folder, max_bytes, write))
    return Outbox(limit_bytes, 10**6, spools[-1], copies)


def sent(box: Outbox) -> list[pb.Frame]:
    frames = []
    while (next_frame := box.next_frame()) is not None:
        frames.append(next_frame)
    return frames


def seqs(frames: list[pb.Frame]) -> list[int]:
    return [f.seq for f in frames]


@pytest.mark.parametrize("copies", [0, 1000, 10**6])
def test_frames_come_back_from_disk_as_they_were_and_in_order_however_many_are_in_memory_too(
    tmp_path: Path, spools: list[Spool], copies: int
):
    box = outbox(tmp_path, spools, copies=copies)
    for seq in range(1, 21):
        box.add(frame(seq), 0.0)
    assert sum(held.frame is not None for held in box._held.values()) == min(20, copies // frame(1).ByteSize())
    assert sent(box) == [frame(seq) for seq in range(1, 21)]
    for seq in range(1, 21):
        assert box.answer(seq) is not None
    box.mark_durable(20)
    assert (len(box), box.bytes, len(spools[0]), box._copies.bytes) == (0, 0, 0, 0)


def test_a_second_agent_replays_what_the_service_has_not_applied_and_keeps_what_is_not_durable(
    tmp_path: Path, spools: list[Spool]
):
    box = outbox(tmp_path, spools)
    for seq in range(1, 11):
        box.add(frame(seq), 0.0)
    box.mark_durable(2)
    box = outbox(tmp_path, spools)
    assert box.first_unanswered() == 1
    assert box.rewind(applied_seq=6, durable_seq=4)
    assert seqs(sent(box)) == [7, 8, 9, 10]
    assert len(box) == 6  # 5 and 6 are applied and would be lost with the service
    assert box.first_unanswered() == 7
    assert box.rewind(applied_seq=4, durable_seq=4)
    assert seqs(sent(box)) == [5, 6, 7, 8, 9, 10]


def test_a_service_that_lost_what_an_agent_before_knew_to_be_durable_is_found_out(tmp_path: Path, spools: list[Spool]):
    box = outbox(tmp_path, spools)
    box.add(frame(1), 0.0)
    box.mark_durable(1)
    box.add(frame(2), 0.0)
    assert not outbox(tmp_path, spools).rewind(applied_seq=0, durable_seq=0)


def test_a_full_spool_gives_up_the_oldest_sparse_frames_first_and_a_second_agent_declares_the_hole(
    tmp_path: Path, spools: list[Spool]
):
    room = 8 * 4000
    box = outbox(tmp_path, spools, room)
    dense = {1, 2, 3, 10, 20, 30, 40, 50, 60, 70, 80, 90}
    for seq in range(1, 101):
        box.add(frame(seq, dense=seq in dense), 0.0)
        assert spools[0].bytes <= room
    gone = [lost.seq for lost in box.lost]
    kept = sorted(set(range(1, 101)) - set(gone))
    assert {lost.reason for lost in box.lost} == {"buffer_full"}
    assert gone == [seq for seq in range(1, max(gone) + 1) if seq not in dense]
    assert len(kept) > 40
    for again in (box, outbox(tmp_path, spools, room)):
        assert again.rewind(0, 0)
        frames = sent(again)
        assert seqs(frames) == kept
        for before, after in itertools.pairwise(kept):
            declared = {f.seq: f.follows_seq for f in frames}[after]
            assert declared == (before if after != before + 1 else 0)


def test_when_only_dense_frames_are_left_the_oldest_of_them_goes(tmp_path: Path, spools: list[Spool]):
    box = outbox(tmp_path, spools, 8 * 4000)
    for seq in range(1, 101):
        box.add(frame(seq, dense=True), 0.0)
    gone = [lost.seq for lost in box.lost]
    assert gone == list(range(1, len(gone) + 1))
    # the session cannot begin with a hole: an empty first frame stands in for it
    first, second = sent(box)[:2]
    assert (first.seq, first.payload, second.seq, second.follows_seq) == (1, b"", len(gone) + 1, 1)
    assert box.answer(1) is None


def test_a_disk_that_fails_leaves_frames_in_memory_and_gets_them_when_it_is_back(tmp_path: Path, spools: list[Spool]):
    wrong: list[bool] = []
    box = outbox(tmp_path, spools, write=failing(errno.ENOSPC, wrong))
    box.add(frame(1), 0.0)
    assert box.all_on_disk
    wrong.append(True)
    for seq in range(2, 6):
        box.add(frame(seq), 0.0)
    assert (box.all_on_disk, len(spools[0]), box.lost) == (False, 1, [])
    wrong.clear()
    box.add(frame(6), 0.0)
    assert (box.all_on_disk, len(spools[0])) == (True, 6)
    assert seqs(sent(box)) == [1, 2, 3, 4, 5, 6]
    assert seqs(sent(outbox(tmp_path, spools))) == [1, 2, 3, 4, 5, 6]


def test_while_the_disk_fails_memory_is_bounded_and_sparse_frames_go_first(tmp_path: Path, spools: list[Spool]):
    wrong: list[bool] = []
    size = frame(1, dense=True).ByteSize()
    box = outbox(tmp_path, spools, write=failing(errno.EIO, wrong), limit_bytes=4 * size + 8)
    box.add(frame(1), 0.0)
    wrong.append(True)
    for seq in range(2, 9):
        box.add(frame(seq, dense=seq % 2 == 0), 0.0)
    assert box.lost == [Lost(3, "buffer_full"), Lost(5, "buffer_full"), Lost(7, "buffer_full")]
    assert seqs(sent(box)) == [1, 2, 4, 6, 8]


def test_a_frame_that_cannot_be_read_any_more_is_lost_by_name_and_the_next_one_says_so(
    tmp_path: Path, spools: list[Spool]
):
    box = outbox(tmp_path, spools)
    for seq in range(1, 5):
        box.add(frame(seq), 0.0)
    (path,) = tmp_path.glob("*.seg")
    data = bytearray(path.read_bytes())
    data[int(len(data) * 0.6)] ^= 1
    path.write_bytes(data)
    assert [(f.seq, f.follows_seq) for f in sent(box)] == [(1, 0), (2, 0), (4, 2)]
    assert box.lost == [Lost(3, "spool_damaged")]


def test_damage_at_the_very_beginning_is_bridged_by_an_empty_first_frame(tmp_path: Path, spools: list[Spool]):
    box = outbox(tmp_path, spools)
    for seq in range(1, 4):
        box.add(frame(seq), 0.0)
    (path,) = tmp_path.glob("*.seg")
    data = bytearray(path.read_bytes())
    data[60] ^= 1
    path.write_bytes(data)
    box = outbox(tmp_path, spools)
    assert box.rewind(0, 0)
    assert [(f.seq, f.follows_seq, len(f.payload)) for f in sent(box)] == [(1, 0, 0), (2, 0, 300), (3, 0, 300)]
    assert box.next_frame() is None
