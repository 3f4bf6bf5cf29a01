"""A worker's part: nothing is made while nobody looks, and nothing that goes wrong reaches the session."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from map_service.channel import Seen, Watch
from map_service.seen import MapSeen
from map_service.views import MapTold, SessionViews
from splitslam import se3
from splitslam.view.decoding import keyframe_poses
from splitslam.wire import session_pb2 as pb
from splitslam.wire import view_pb2


class Glass:
    """A session that cannot be looked at without a crash."""

    request = SimpleNamespace(session_id="rover-7/1", opening=SimpleNamespace(site_id="north"))
    stream = 3

    def seen(self, newest_fixes: int) -> Any:
        raise RuntimeError("somebody has looked")


def map_of(*poses: np.ndarray, loops: int = 0) -> MapSeen:
    none = np.zeros(0, np.int64), np.zeros((0, 3))
    return MapSeen(np.array(poses).reshape(-1, 4, 4), [(0, i) for i in range(1, loops + 1)], *none)


def at(x_m: float) -> np.ndarray:
    return se3.compose(np.eye(3), np.array([x_m, 0.0, 0.0]))


@pytest.mark.parametrize(
    ("watch", "looks"), [(Watch(), 0), (Watch(frozenset({"rover-8"})), 0), (Watch(frozenset({"rover-7"})), 1)]
)
def test_a_session_is_looked_at_when_somebody_wants_it_and_a_failure_harms_nobody(
    watch: Watch, looks: int, caplog: pytest.LogCaptureFixture
) -> None:
    sent: list[Seen] = []
    views, session = SessionViews(sent.append), Glass()
    views.watch(watch)
    views.scan(session, pb.Frame(seq=1), pb.Odometry(seq=1))  # type: ignore[arg-type]
    views.end(session)  # type: ignore[arg-type]
    assert not sent
    assert sum(record.getMessage() == "view failed" for record in caplog.records) == 2 * looks


@pytest.mark.parametrize("answer", [pb.Odometry(seq=1, duplicate=True), pb.Odometry(seq=1, rejected="corrupt")])
def test_an_answer_that_is_no_new_scan_is_not_shown(answer: pb.Odometry, caplog: pytest.LogCaptureFixture) -> None:
    views = SessionViews(lambda message: None)
    views.watch(Watch(all_robots=True))
    views.scan(Glass(), pb.Frame(seq=1), answer)  # type: ignore[arg-type]
    assert not caplog.records


def test_only_keyframes_that_are_new_or_have_moved_are_told() -> None:
    told = MapTold()

    def tell(now: MapSeen) -> dict[int, float]:
        message = view_pb2.MapSeen()
        told.fill(message, now)
        return {index: T[0, 3] for index, T in keyframe_poses(message).items()}

    assert tell(map_of(at(0), at(1))) == {0: 0.0, 1: 1.0}
    assert tell(map_of(at(0), at(1))) == {}
    assert tell(map_of(at(0), at(1.5), at(2))) == {1: 1.5, 2: 2.0}
    creeping = [tell(map_of(at(0), at(1.5 + 0.002 * k), at(2 + k))) for k in range(1, 5)]
    assert all(2 in moved for moved in creeping)
    assert sum(1 in moved for moved in creeping) == 1, "what moves by less than one sees adds up until one does"
    turned = se3.compose(se3.so3_exp(np.array([0, 0, 0.01])), np.zeros(3))
    assert list(tell(map_of(turned, at(1.508), at(6)))) == [0]


def test_a_map_that_has_lost_its_newest_keyframes_is_told_whole_again() -> None:
    told = MapTold()
    told.fill(view_pb2.MapSeen(), map_of(at(0), at(1), at(2), loops=2))
    message = view_pb2.MapSeen()
    told.fill(message, map_of(at(0), at(1), loops=1))
    assert (list(message.keyframes), list(message.loops)) == ([0, 1], [0, 1])


def test_loops_are_told_when_there_are_more() -> None:
    told, messages = MapTold(), [view_pb2.MapSeen() for _ in range(3)]
    for message, loops in zip(messages, (1, 1, 2), strict=True):
        told.fill(message, map_of(at(0), at(1), at(2), loops=loops))
    assert [list(message.loops) for message in messages] == [[0, 1], [], [0, 1, 0, 2]]
