"""From frames to files: the service's word may come before the cloud is on disk, or after."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest

from edge_agent.clouds import keeper as module
from edge_agent.clouds.keeper import CloudKeeper
from edge_agent.clouds.shelf import CloudShelf
from splitslam.codec import STEP_M
from tests.dense.made import opening, whole_scan


@pytest.fixture
def shelf(tmp_path: Path) -> CloudShelf:
    return CloudShelf(tmp_path, 10**6, opening())


def due(shelf: CloudShelf) -> list[int]:
    return [kept.seq for kept in shelf.due(1e9)]


def test_only_keyframes_stay_whenever_the_answer_comes(shelf: CloudShelf):
    keeper = CloudKeeper(shelf, STEP_M, lockstep=True)
    for seq in (1, 2, 3, 4):
        keeper.keep(whole_scan(seq))
    keeper.answered(2, True)  # most likely before its cloud is on disk
    keeper.answered(3, False)
    keeper.flush()
    keeper.answered(1, True)
    keeper.answered(4, False)
    keeper.close()
    assert due(shelf) == [1, 2]
    assert shelf.waiting == 2
    assert not shelf.dropped


def test_what_comes_too_fast_is_a_loss_only_of_keyframes(shelf: CloudShelf, monkeypatch: pytest.MonkeyPatch):
    gate = threading.Event()
    monkeypatch.setattr(module.dense_cloud, "encode", lambda *_: b"cloud" if gate.wait(60) else b"")
    keeper = CloudKeeper(shelf, STEP_M, lockstep=False)
    for seq in range(1, 11):  # four wait, or are at work
        keeper.keep(whole_scan(seq, 1))
    for seq in range(1, 11):
        keeper.answered(seq, seq != 10)
    gate.set()
    keeper.close()
    assert shelf.dropped == {"busy": 5}
    assert due(shelf) == [1, 2, 3, 4]


def test_a_scan_that_cannot_be_encoded_is_counted_and_the_next_one_is_kept(shelf: CloudShelf):
    keeper = CloudKeeper(shelf, STEP_M, lockstep=True)
    bad = whole_scan(1)
    bad.points.points_lidar[0] = float("nan")
    keeper.keep(bad)
    keeper.lose(2, 20, "motion")
    keeper.keep(whole_scan(3))
    keeper.flush()
    for seq in (1, 2, 3):
        keeper.answered(seq, True)
    keeper.close()
    assert shelf.dropped == {"encode": 1, "motion": 1}
    assert due(shelf) == [3]


def test_the_next_agent_knows_of_every_scan_that_a_killed_one_had_not_written_or_heard_of(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    own, gate = opening(), threading.Event()
    keeper = CloudKeeper(CloudShelf(tmp_path, 10**6, own), STEP_M, lockstep=False)
    keeper.keep(whole_scan(1))
    keeper.lose(2, 20, "motion")
    keeper.lose(3, 30, "motion")
    keeper.answered(3, False)
    keeper.flush()
    monkeypatch.setattr(module.dense_cloud, "encode", lambda *_: b"cloud" if gate.wait(60) else b"")
    for seq in range(4, 10):  # four wait, or are at work
        keeper.keep(whole_scan(seq, 1))
    after = CloudShelf(tmp_path, 10**6, own)
    assert [kept.seq for kept in after.due(1e9) if kept.gone_ns is None] == [1]
    assert [kept.seq for kept in after.due(1e9) if kept.gone_ns is not None] == [2, 4, 5, 6, 7, 8, 9]
    gate.set()
    keeper.close()
