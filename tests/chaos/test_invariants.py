"""The judge of the chaos suite sees what is wrong: each invariant is broken here once."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np

from splitslam.tum import Trajectory
from splitslam.wire import session_pb2 as pb
from splitslam.wire import types_pb2 as types
from tests.chaos.audit import Note, one_owner
from tests.chaos.invariants import mapped_once, memory_bounded, nobody_left, not_worse
from tests.chaos.light_robot import Witness

GOOD = [
    Note("a", 1, 0, False),
    Note("a", 1, 5, False),
    Note("b", 1, 3, False),
    Note("a", 2, 5, False),
    Note("a", 2, 9, True),
]


def walk(sideways_m: float = 0.0) -> Trajectory:
    """20 m ahead in 10 s, with a bend of `sideways_m` in the middle."""
    x = np.linspace(0.0, 20.0, 101)
    positions = np.stack([x, sideways_m * np.sin(x * np.pi / 10.0), 0.0 * x], axis=1)
    return Trajectory(np.arange(101) * 100_000_000, positions, np.tile([0.0, 0.0, 0.0, 1.0], (101, 1)))


def heard(*responses: pb.StreamResponse) -> list[str]:
    witness = Witness("r")
    witness.stream_begins()
    for response in responses:
        witness.see(response)
    return witness.wrong


def welcome(epoch: int, durable: int = 0, applied: int = 0) -> pb.StreamResponse:
    return pb.StreamResponse(welcome=pb.Welcome(epoch=epoch, durable_seq=durable, applied_seq=applied))


def answer(seq: int, durable: int = 0, x_m: float = 0.0, duplicate: bool = False) -> pb.StreamResponse:
    pose = types.Transform(tx_m=x_m, qw=1.0)
    odometry = pb.Odometry(seq=seq, pose_map_lidar=pose, applied_seq=seq, durable_seq=durable)
    odometry.duplicate = duplicate
    return pb.StreamResponse(odometry=odometry)


def test_owners_that_follow_each_other_are_in_order():
    assert one_owner(GOOD) == []


def test_an_owner_that_writes_after_the_next_one_has_begun_is_seen():
    assert "epoch 1 wrote after epoch 2" in one_owner([*GOOD[:4], Note("a", 1, 7, False)])[0]


def test_a_write_after_the_end_and_one_that_goes_back_are_seen():
    assert "written after its end" in one_owner([*GOOD, Note("a", 3, 9, False)])[0]
    assert "back to 4" in one_owner([*GOOD[:2], Note("a", 1, 4, False)])[0]


def test_an_owner_that_begins_elsewhere_than_the_last_one_ended_is_seen():
    assert "began with 6" in one_owner([*GOOD[:3], replace(GOOD[3], last_seq=6)])[0]


def test_a_scan_that_is_missing_or_there_twice_is_seen():
    assert mapped_once("r", [1, 2, 3], 3) == []
    assert "not mapped: [2]" in mapped_once("r", [1, 3], 3)[0]
    assert "twice or never sent: [2, 4]" in mapped_once("r", [1, 2, 2, 3, 4], 3)[0]


def test_a_trajectory_may_be_two_centimetres_worse_and_no_more():
    assert not_worse("r", walk(0.02), walk(), walk()) == []
    assert "undisturbed 0.0 mm" in not_worse("r", walk(0.05), walk(), walk())[0]


def test_a_leak_is_seen_and_a_cache_that_fills_is_not():
    assert memory_bounded("r", [50, 90, 100, 100, 101, 102, 100, 103, 104]) == []
    assert memory_bounded("r", [100, 110, 120, 130, 140, 150, 180, 190, 220]) != []


def test_a_process_that_was_left_behind_is_seen():
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as process:
        assert str(process.pid) in nobody_left([process.pid])[0]
        process.communicate(b"\n")
    assert nobody_left([process.pid]) == []


def test_a_witness_has_nothing_against_a_service_that_keeps_its_word():
    assert (
        heard(welcome(1), answer(1), answer(2, 1), welcome(2, 1, 2), answer(1, 1, duplicate=True), answer(3, 2)) == []
    )


def test_a_witness_sees_an_epoch_that_does_not_rise():
    assert "epoch 1 after [1]" in heard(welcome(1), welcome(1))[0]


def test_a_witness_sees_durability_that_is_taken_back():
    assert "durable 1 in a Welcome, it was 2" in heard(welcome(1), answer(2, 2), welcome(2, 1, 1))[0]


def test_a_witness_sees_answers_out_of_order_and_rejected_frames():
    assert "answer to 1 after that to 2" in heard(welcome(1), answer(2), answer(1))[0]
    rejected = pb.StreamResponse(odometry=pb.Odometry(seq=1, applied_seq=1, rejected="corrupt"))
    assert "rejected: corrupt" in heard(welcome(1), rejected)[0]


def test_a_witness_sees_a_duplicate_that_is_not_the_first_answer():
    assert (
        "0.5000 m off the first"
        in heard(welcome(1), answer(1), welcome(2, 0, 1), answer(1, x_m=0.5, duplicate=True))[0]
    )
