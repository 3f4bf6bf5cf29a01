"""`splitslam bench load`: what an account finds wrong, the search, and a service with real robots at it."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from splitslam.bench.load.account import Account
from splitslam.bench.load.trial import largest
from splitslam.stack.reel import Reel
from splitslam.wire import session_pb2 as pb
from splitslam.wire import types_pb2 as types
from tests.typed import typed

SECONDS = 4
bench = partial(typed, "splitslam", "bench", "load")


def two_frames() -> Account:
    frames = [pb.Frame(seq=seq, stamp_ns=seq * 100) for seq in (1, 2)]
    account = Account("rover", Reel(pb.Hello(), frames, [np.eye(4), np.eye(4)]))
    for _ in frames:
        account.sent(0.0, 0.001)
    return account


def answer(seq: int, x_m: float = 0.0, **others) -> pb.Odometry:
    return pb.Odometry(seq=seq, stamp_ns=seq * 100, pose_map_lidar=types.Transform(tx_m=x_m, qw=1.0), **others)


def test_right_answers_leave_nothing_to_say_against_them():
    account = two_frames()
    account.answer(answer(1), 0.02)
    account.answer(answer(2, x_m=0.005), 0.03)
    account.end(pb.Finished(mapped=2))
    assert not account.wrong
    assert not account.unanswered
    assert account.answer_ms() == pytest.approx([20.0, 30.0])
    assert account.late_ms() == pytest.approx([1.0, 1.0])


@pytest.mark.parametrize(
    ("second", "said"),
    [
        (answer(1), "answer 2 is of frame 1"),
        (answer(3), "answer 2 is of frame 3"),
        (answer(2, duplicate=True), "answer 2 is of frame 2, a duplicate"),
        (answer(2, rejected="corrupt"), "frame 2 was rejected: corrupt"),
        (answer(2, x_m=0.02), "frame 2 is 0.020 m"),
        (pb.Odometry(seq=2, stamp_ns=1), "frame 2 was answered with the stamp of another"),
    ],
)
def test_an_answer_that_is_not_as_it_must_be_is_told(second: pb.Odometry, said: str):
    account = two_frames()
    account.answer(answer(1), 0.02)
    account.answer(second, 0.03)
    assert len(account.wrong) == 1
    assert said in account.wrong[0]


def test_a_frame_that_the_service_has_not_mapped_is_told():
    account = two_frames()
    account.end(pb.Finished(mapped=1))
    assert account.wrong == ["rover: 1 of 2 frames are mapped at the end"]


@pytest.mark.parametrize("most", [0, 1, 5, 11, 12, 13, 23, 24, 100, 128, 400])
def test_the_search_finds_the_largest_number_in_few_tries(most: int):
    tried: list[int] = []

    def passes(robots: int) -> bool:
        tried.append(robots)
        return robots <= most

    assert largest(passes, first=12, at_most=128) == min(most, 128)
    assert len(tried) == len(set(tried)) <= 10


def test_three_robots_in_step_are_answered_in_full_and_cost_something(shared_data: Path, tmp_path: Path):
    options = ("--robots", 3, "--seconds", SECONDS, "--out", tmp_path, "--json")
    exit_code, text, errors = bench(shared_data / "yard1" / "yard1.bag", *options)
    result = json.loads((tmp_path / "load.json").read_text())
    assert json.loads(text) == result, errors
    (trial,) = result["trials"]
    assert trial["wrong"] == []
    assert (trial["frames"], trial["unanswered"]) == (3 * SECONDS * 10, 0)
    assert exit_code == (0 if trial["passed"] else 1)  # whether in time is this machine's affair
    cost = trial["cost"]
    assert 0.0 < cost["cores"] < 1.0
    assert 0.0 < cost["generator_cores"] < cost["cores"]
    assert 50.0 < cost["uplink_kbps"] < 1000.0
    assert 5.0 < cost["downlink_kbps"] < 200.0
    assert cost["store_gb_a_day"] > 0.1


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--robots", 0), "--robots: expected 1 to 128, found 0"),
        (("--seconds", 0.5), "--seconds: expected at least 1, found 0.5"),
        (("--start", "never"), "--start: expected together or spread, found 'never'"),
        (("nowhere.bag",), "nowhere.yaml: expected a robot file beside the recording (or --robot)"),
    ],
)
def test_an_option_that_cannot_be_is_one_line_and_exit_code_2(arguments: tuple, said: str):
    exit_code, out, err = bench(*arguments)
    assert (exit_code, out) == (2, "")
    assert said in err
    assert err.count("\n") == 1
