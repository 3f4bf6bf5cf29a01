"""Live answers and stored scans of one session, merged: each once, in order, whatever comes when."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from map_service.pose_track import PoseTrack, TrackedScan
from splitslam.wire import pose_pb2 as pb

BACKLOG = 10


def scan(seq: int) -> TrackedScan:
    """Every seventh was rejected."""
    return TrackedScan(seq, None if seq % 7 == 0 else pb.ScanPose(seq=seq))


def seqs(poses: list[pb.ScanPose]) -> list[int]:
    return [pose.seq for pose in poses]


def test_live_answers_that_follow_on_what_was_told_need_no_store() -> None:
    track = PoseTrack(last=3, paced_until=3, backlog=BACKLOG)
    for seq in (4, 5, 6):
        track.answered(1, scan(seq))
    assert seqs(track.live()) == [4, 5, 6]
    track.answered(1, scan(9))  # the robot gave 7 and 8 up, and the same stream says what comes next
    assert seqs(track.live()) == [9]


def test_a_live_answer_with_something_before_it_waits_for_the_store() -> None:
    track = PoseTrack(last=3, paced_until=3, backlog=BACKLOG)
    track.answered(1, scan(6))
    track.answered(1, scan(8))
    assert track.live() == []
    assert seqs(track.stored([scan(4), scan(5)])) == [4, 5, 6, 8]


def test_what_another_replica_answered_meanwhile_is_not_skipped() -> None:
    track = PoseTrack(last=0, paced_until=0, backlog=BACKLOG)
    track.answered(1, scan(1))
    assert seqs(track.live()) == [1]
    track.answered(2, scan(6))  # the session has been elsewhere
    assert track.live() == []
    assert seqs(track.stored([scan(s) for s in (2, 3, 4, 5, 6)])) == [2, 3, 4, 5, 6]


def test_answers_that_are_given_again_after_a_crash_are_told_once() -> None:
    track = PoseTrack(last=0, paced_until=0, backlog=BACKLOG)
    for seq in (1, 2, 3):
        track.answered(1, scan(seq))
    assert seqs(track.live()) == [1, 2, 3]
    for seq in (2, 3, 4):
        track.answered(2, scan(seq))
    assert seqs(track.live()) == [4]


def test_more_than_the_backlog_is_left_out_and_counted_but_not_what_was_asked_for() -> None:
    track = PoseTrack(last=0, paced_until=50, backlog=BACKLOG)
    assert track.next_after(50) == 0
    assert seqs(track.stored([scan(s) for s in range(1, 51)])) == [s for s in range(1, 51) if s % 7]
    assert track.leave_out(75) == 15
    assert track.last == 65
    assert track.next_after(75) == 65


@given(st.data())
def test_every_scan_is_told_once_and_in_order_however_the_session_moves(data: st.DataObject) -> None:
    """The session is answered here or elsewhere by turns, is committed at any time and taken up again from there."""
    draw = data.draw
    track = PoseTrack(last=0, paced_until=0, backlog=1000)
    told: list[int] = []
    answered: dict[int, int] = {}  # in order: what exists, holes included by not being there
    durable = newest = 0
    stream, here = 1, True
    for _ in range(draw(st.integers(5, 60))):
        match draw(st.sampled_from(["answer", "answer", "answer", "commit", "look", "move", "crash", "live"])):
            case "answer":
                newest += draw(st.sampled_from([1, 1, 1, 3]))
                answered[newest] = newest
                if here:
                    track.answered(stream, scan(newest))
            case "commit":
                durable = newest
            case "look":
                page = [s for s in sorted(answered) if track.last < s <= durable][: draw(st.integers(0, 5))]
                told += seqs(track.stored([scan(s) for s in page]))
            case "move":  # all that was answered is durable first
                durable, stream, here = newest, stream + 1, not here
            case "crash":  # what was not durable is mapped again, elsewhere or here, with the same numbers
                again = [s for s in sorted(answered) if s > durable]
                stream, here = stream + 1, draw(st.booleans())
                for seq in again if here else ():
                    track.answered(stream, scan(seq))
            case "live":
                told += seqs(track.live())
    told += seqs(track.stored([scan(s) for s in sorted(answered) if s > track.last]))
    assert told == [s for s in sorted(answered) if s % 7]


@pytest.mark.parametrize("live", [3, 30])
def test_memory_is_bounded_while_nobody_reads(live: int) -> None:
    track = PoseTrack(last=0, paced_until=0, backlog=BACKLOG)
    for seq in range(2, 2 + live):
        track.answered(1, scan(seq))
    assert len(track._live) <= BACKLOG
    told = seqs(track.stored([scan(s) for s in range(1, 2 + live)]))
    assert told == [s for s in range(1, 2 + live) if s % 7]
