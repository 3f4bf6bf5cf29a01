from __future__ import annotations

from edge_agent.outbox import Lost, Outbox
from splitslam.wire import session_pb2 as pb


def frame(seq: int, dense: bool = False, size: int = 100) -> pb.Frame:
    return pb.Frame(seq=seq, dense=dense, payload=b"x" * size)


def filled(count: int, window: int = 100, limit_bytes: int = 1_000_000) -> Outbox:
    outbox = Outbox(limit_bytes, window)
    for seq in range(1, count + 1):
        outbox.add(frame(seq), 0.0)
    return outbox


def sent(outbox: Outbox) -> list[int]:
    seqs = []
    while (next_frame := outbox.next_frame()) is not None:
        seqs.append(next_frame.seq)
    return seqs


def three_answered(outbox: Outbox, durable_seq: int) -> None:
    """All are sent, 1 to 3 are answered."""
    sent(outbox)
    for seq in (1, 2, 3):
        outbox.answer(seq)
    outbox.mark_durable(durable_seq)


def test_no_more_frames_are_in_flight_than_the_window_allows():
    outbox = filled(5, window=2)
    assert sent(outbox) == [1, 2]
    assert outbox.answer(1) is not None
    assert sent(outbox) == [3]


def test_a_frame_is_kept_until_it_is_both_durable_and_answered():
    outbox = filled(3)
    sent(outbox)
    outbox.mark_durable(2)
    assert len(outbox) == 3
    outbox.answer(1)
    assert len(outbox) == 2
    outbox.answer(2)
    outbox.answer(3)
    assert [outbox.first_unanswered(), len(outbox)] == [None, 1]
    outbox.mark_durable(3)
    assert (len(outbox), outbox.bytes) == (0, 0)


def test_after_a_break_what_the_server_has_not_applied_or_not_answered_goes_again_in_order():
    outbox = filled(6)
    three_answered(outbox, durable_seq=1)
    assert outbox.rewind(applied_seq=4, durable_seq=1)
    assert sent(outbox) == [4, 5, 6]  # 4 was applied, but its answer got lost


def test_after_the_loss_of_the_server_answered_frames_that_were_not_durable_go_again():
    outbox = filled(6)
    three_answered(outbox, durable_seq=1)
    assert outbox.rewind(applied_seq=1, durable_seq=1)
    assert sent(outbox) == [2, 3, 4, 5, 6]
    assert outbox.answer(2) is None  # handed on before
    assert outbox.answer(4) is not None


def test_a_server_that_lost_durable_frames_is_found_out():
    outbox = filled(4)
    three_answered(outbox, durable_seq=3)
    assert not outbox.rewind(applied_seq=2, durable_seq=2)


def test_an_answer_is_handed_on_once_and_only_for_a_frame_that_was_sent():
    outbox = filled(2, window=1)
    sent(outbox)
    assert outbox.answer(2) is None
    assert outbox.answer(7) is None
    assert outbox.answer(1) is not None
    assert outbox.answer(1) is None


def test_a_full_buffer_drops_the_oldest_frame_that_is_not_dense_and_dense_ones_last():
    size = frame(1, dense=True).ByteSize() + 8
    outbox = Outbox(limit_bytes=3 * size, window=4)
    dense = {1, 3, 5}
    for seq in range(1, 7):
        outbox.add(frame(seq, seq in dense), 0.0)
    assert [lost.seq for lost in outbox.lost] == [2, 4, 6]
    outbox.add(frame(7, dense=True), 0.0)
    assert outbox.lost[3:] == [Lost(1, "buffer_full")]


def test_a_frame_in_flight_is_not_dropped():
    outbox = Outbox(limit_bytes=frame(1).ByteSize() * 2 + 4, window=1)
    outbox.add(frame(1), 0.0)
    assert sent(outbox) == [1]
    outbox.add(frame(2), 0.0)
    outbox.add(frame(3), 0.0)
    assert [lost.seq for lost in outbox.lost] == [2]


def test_a_hole_is_declared_by_the_frame_after_it_and_by_no_other():
    outbox = Outbox(limit_bytes=4 * frame(1, dense=True).ByteSize(), window=100)
    for seq in range(1, 8):
        outbox.add(frame(seq, dense=seq in (1, 2, 6)), 0.0)
    declared = {}
    while (next_frame := outbox.next_frame()) is not None:
        declared[next_frame.seq] = next_frame.follows_seq
    assert declared == {1: 0, 2: 0, 6: 2, 7: 0}
