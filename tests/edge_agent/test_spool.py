"""What has been written to the spool survives: kills, cut-off files, flipped bits, disks that are full or read-only."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st

from edge_agent.spool import Spool
from splitslam.wire import session_pb2 as pb

ROOM = 1 << 20
QUICK = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None  # hundreds of small files, each synced at its end


def frame(seq: int, size: int = 300, dense: bool = False) -> pb.Frame:
    payload = bytes((seq * 7 + k) % 256 for k in range(size))
    return pb.Frame(seq=seq, stamp_ns=seq * 10**8, dense=dense, payload=payload)


def kept(folder: Path, max_bytes: int = ROOM) -> dict[int, pb.Frame | None]:
    """What a new start finds."""
    spool = Spool(folder, max_bytes)
    found = {head.seq: spool.get(head.seq) for head in spool.recovered.heads}
    spool.close()
    return found


def files(folder: Path) -> list[Path]:
    return sorted(folder.glob("*.seg"))


# --- restarts ---------------------------------------------------------------------------------------------------------


def test_what_was_put_is_there_after_a_restart_byte_for_byte_and_says_how_far_the_run_came(tmp_path: Path):
    spool = Spool(tmp_path, ROOM)
    for seq in range(1, 6):
        assert spool.put(frame(seq, dense=seq == 4), durable_seq=seq // 2)
    spool.close()
    again = Spool(tmp_path, ROOM)
    assert [(head.seq, head.dense) for head in again.recovered.heads] == [(k, k == 4) for k in range(1, 6)]
    assert [again.get(seq) for seq in range(1, 6)] == [frame(seq, dense=seq == 4) for seq in range(1, 6)]
    newest = again.recovered.newest
    assert newest is not None
    assert (newest.seq, newest.stamp_ns, again.recovered.durable_seq) == (5, 5 * 10**8, 2)
    assert again.recovered.says_how_far
    again.close()


def test_frames_that_are_durable_leave_the_disk_but_for_the_file_that_says_how_far_the_run_came(tmp_path: Path):
    spool = Spool(tmp_path, 8 * 4000)  # files of 4,000 bytes
    for seq in range(1, 101):
        spool.put(frame(seq), durable_seq=max(seq - 3, 0))
        if seq > 3:
            spool.release(seq - 3)
        assert spool.bytes <= 2 * 4000
    for seq in (98, 99, 100):
        spool.release(seq)
    spool.close()
    assert len(files(tmp_path)) == 1
    again = Spool(tmp_path, 8 * 4000)
    assert again.recovered.newest is not None
    assert again.recovered.newest.seq == 100
    assert again.recovered.durable_seq == 97
    for head in again.recovered.heads:
        again.release(head.seq)
    again.close()
    again = Spool(tmp_path, 8 * 4000)
    assert again.recovered.newest is not None
    assert again.recovered.newest.seq == 100
    for head in again.recovered.heads:
        again.release(head.seq)
    again.put(frame(101), 100)  # a newer file says it now
    again.close()
    assert list(kept(tmp_path)) == [101]


def test_a_frame_that_was_given_up_does_not_come_back(tmp_path: Path):
    spool = Spool(tmp_path, ROOM)
    for seq in range(1, 6):
        spool.put(frame(seq), 0)
    spool.give_up(3)
    spool.close()
    assert sorted(kept(tmp_path)) == [1, 2, 4, 5]


@settings(max_examples=60, deadline=None)
@given(
    sizes=st.lists(st.integers(0, 900), min_size=1, max_size=30),
    gone=st.sets(st.integers(1, 30)),
    cut=st.floats(0, 1),
)
def test_whatever_is_cut_off_the_end_all_before_it_is_recovered(sizes: list[int], gone: set[int], cut: float):
    with tempfile.TemporaryDirectory(dir=QUICK) as name:
        folder = Path(name)
        spool = Spool(folder, 8 * 3000)
        ends: dict[int, tuple[Path, int]] = {}
        for seq, size in enumerate(sizes, 1):
            spool.put(frame(seq, size), 0)
            last = files(folder)[-1]
            ends[seq] = (last, last.stat().st_size)
        for seq in gone & set(ends):
            spool.give_up(seq)
        spool.close()
        last = files(folder)[-1]
        left = int(cut * last.stat().st_size)
        os.truncate(last, left)
        found = kept(folder)
        whole = {seq for seq, (path, end) in ends.items() if path != last or end <= left}
        assert set(found) == whole - gone
        assert all(found[seq] == frame(seq, sizes[seq - 1]) for seq in found)


@settings(max_examples=60, deadline=None)
@given(where=st.floats(0, 1, exclude_max=True), bit=st.integers(0, 7))
def test_a_flipped_bit_costs_the_frame_that_it_hit_and_is_counted(where: float, bit: int):
    with tempfile.TemporaryDirectory(dir=QUICK) as name:
        folder = Path(name)
        spool = Spool(folder, ROOM)
        ends = [0]
        for seq in range(1, 21):
            spool.put(frame(seq), 0)
            ends.append(spool.bytes)
        spool.close()
        (path,) = files(folder)
        data = bytearray(path.read_bytes())
        at = int(where * len(data))
        data[at] ^= 1 << bit
        path.write_bytes(data)
        again = Spool(folder, ROOM)
        lost = next(seq for seq in range(1, 21) if at < ends[seq])
        found = {head.seq: again.get(head.seq) for head in again.recovered.heads}
        if at - ends[lost - 1] == 4:  # the mark of a frame that was given up
            assert set(found) in (set(range(1, 21)), set(range(1, 21)) - {lost})
        else:
            assert set(found) == set(range(1, 21)) - {lost}
            assert again.errors["damaged"] == 1
        assert all(found[seq] == frame(seq) for seq in found)
        again.close()


def test_damage_that_comes_after_the_start_costs_that_frame_alone(tmp_path: Path):
    spool = Spool(tmp_path, ROOM)
    for seq in range(1, 4):
        spool.put(frame(seq), 0)
    (path,) = files(tmp_path)
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    assert [spool.get(seq) is not None for seq in (1, 2, 3)] == [True, False, True]
    assert spool.errors == {"damaged": 1}
    spool.close()


def test_everything_that_a_killed_process_had_put_is_there(tmp_path: Path):
    program = (
        "import sys\nfrom pathlib import Path\nfrom edge_agent.spool import Spool\n"
        "from tests.edge_agent.test_spool import frame\n"
        "spool = Spool(Path(sys.argv[1]), 1 << 20)\n"
        "seq = 0\nwhile True:\n    seq += 1\n    assert spool.put(frame(seq), 0)\n    print(seq, flush=True)\n"
    )
    child = subprocess.Popen([sys.executable, "-c", program, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    for line in child.stdout:
        if int(line) >= 200:
            child.send_signal(signal.SIGKILL)
            break
    said = [int(line) for line in child.stdout if line.strip()]
    child.wait()
    child.stdout.close()
    found = kept(tmp_path)
    assert set(range(1, max([200, *said]) + 1)) <= set(found)
    assert all(found[seq] == frame(seq) for seq in found)


# --- room -------------------------------------------------------------------------------------------------------------


@settings(max_examples=40, deadline=None)
@given(order=st.lists(st.integers(0, 10**6), min_size=40, max_size=120))
def test_the_files_stay_within_their_room_whatever_goes_and_lose_nothing_else(order: list[int]):
    with tempfile.TemporaryDirectory(dir=QUICK) as name:
        room = 8 * 4000
        spool = Spool(Path(name), room)
        here: list[int] = []
        for seq, dice in enumerate(order, 1):
            spool.put(frame(seq), 0)
            here.append(seq)
            while spool.overfull:
                spool.give_up(here.pop(dice % len(here)))
            assert spool.bytes <= room
        assert [spool.get(seq) for seq in here] == [frame(seq) for seq in here]
        spool.close()
        assert sorted(kept(Path(name))) == here
