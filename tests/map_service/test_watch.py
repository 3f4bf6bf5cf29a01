"""What `WatchPoses` and `Events` make of a store, a look at a time."""

from __future__ import annotations

import json
from collections.abc import Iterable

import pytest

from map_service import event_watch, history, pose_watch
from map_service.catalog import Catalog
from map_service.cursor import Cursor, CursorError
from map_service.event_messages import state_event
from map_service.event_watch import EventWatch
from map_service.following import Scope
from map_service.pose_watch import PoseWatch, Start
from map_service.store import Opening, Store
from map_service.types import State
from splitslam.wire import pose_pb2 as pb
from tests.map_service.entries import entry, with_move

NOBODY: dict[str, int] = {}
ROBOT_FILE = "imu: {topic: null}"
EVENT = state_event(1, 1, State.TRACKING, State.LOST).SerializeToString()


def opened(store: Store, name: str) -> int:
    robot_id, _, run_id = name.partition("/")
    return store.open_session(Opening(name, robot_id, run_id, "site", "", ROBOT_FILE)).key


def commit(store: Store, key: int, first: int, last: int, **changes) -> None:
    store.commit(key, 1, entry(first - 1, last, keyframes=(0,) if first == 1 else (), **changes))


def pose_watch_of(store: Store, cursor: str = "", *, names: Iterable[str] = (), from_start: bool = False) -> PoseWatch:
    start = Start(Scope(frozenset(names)), Cursor.parse(cursor), NOBODY, from_start)
    return PoseWatch(store, start, 100, lambda scans: None)


def event_watch_of(store: Store, cursor: str = "", *, from_start: bool = False) -> EventWatch:
    return EventWatch(store, Scope(), Cursor.parse(cursor), from_start=from_start)


def looked(watch: PoseWatch) -> tuple[list[tuple[str, int]], list[pb.MovedKeyframes], str]:
    """Looks until there is no more: scans, moves, the last cursor."""
    scans, moves, cursor, more = [], [], "", True
    while more:
        found = watch.look()
        more = found.more
        for response in watch.take(found):
            assert not (response.poses and moves), "a scan after the move"
            scans += [(pose.session_id, pose.seq) for pose in response.poses]
            moves += [response.moved] if response.HasField("moved") else []
            cursor = response.cursor or cursor
    return scans, moves, cursor


def heard(watch: EventWatch) -> tuple[list[tuple[str, int]], int, str]:
    """Looks until there is no more: events, how many were lost, the last cursor."""
    events, last, more = [], watch.alive(), True
    while more:
        found = watch.look()
        more = found.more
        for response in watch.take(found):
            events += [(event.session_id, event.number) for event in response.events]
            last = response
    last = watch.alive() if not events else last
    return events, last.lost, watch.alive().cursor


def test_many_scans_come_in_pages_and_what_moved_after_all_of_them(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pose_watch, "PAGE_SCANS", 3)
    monkeypatch.setattr(pose_watch, "_MOST_SCANS", 5)
    for name in ("r/1", "r/2"):
        key = opened(store, name)
        commit(store, key, 1, 10)
        store.commit(key, 1, with_move(entry(10, 11, finished=name == "r/2"), 2))
    told: dict[str, list[int]] = {"r/1": [], "r/2": []}
    moves = 0
    watch = pose_watch_of(store, names=told, from_start=True)
    for _ in range(20):
        for response in watch.take(watch.look()):
            for pose in response.poses:
                told[pose.session_id].append(pose.seq)
            if response.HasField("moved"):
                assert told[response.moved.session_id] == list(range(1, 12))
                moves += 1
    assert (told, moves) == ({name: list(range(1, 12)) for name in told}, 2)
    assert not watch.done
    commit(store, opened_again(store, "r/1"), 12, 12, finished=True)
    assert looked(watch)[0] == [("r/1", 12)]
    assert watch.done


def opened_again(store: Store, name: str) -> int:
    row = Catalog(store).session(name)
    assert row is not None
    return row.id


def test_a_cursor_goes_on_after_what_was_told_and_with_sessions_that_came_and_went(store: Store) -> None:
    first = opened(store, "r/1")
    commit(store, first, 1, 5)
    scans, _, cursor = looked(pose_watch_of(store, from_start=True))
    assert [seq for _, seq in scans] == [1, 2, 3, 4, 5]
    commit(store, first, 6, 7, finished=True)
    second = opened(store, "r/2")
    commit(store, second, 1, 2, finished=True)
    scans, _, cursor = looked(pose_watch_of(store, cursor))
    assert scans == [("r/1", 6), ("r/1", 7), ("r/2", 1), ("r/2", 2)]
    assert looked(pose_watch_of(store, cursor))[0] == []


def test_sessions_that_have_ended_are_told_only_by_name(store: Store) -> None:
    commit(store, opened(store, "r/1"), 1, 2, finished=True)
    assert looked(pose_watch_of(store, from_start=True))[0] == []
    watch = pose_watch_of(store, names=["r/1"], from_start=True)
    assert looked(watch)[0] == [("r/1", 1), ("r/1", 2)]
    assert watch.done


def test_a_session_that_was_deleted_and_begun_anew_under_its_name_is_told_from_its_start(store: Store) -> None:
    commit(store, opened(store, "r/1"), 1, 5, events=[EVENT] * 5)
    poses, events = pose_watch_of(store), event_watch_of(store)
    looked(poses)
    heard(events)
    Catalog(store).delete("r/1")
    commit(store, opened(store, "r/1"), 1, 2)
    assert looked(poses)[0] == [("r/1", 1), ("r/1", 2)]
    assert heard(events)[0] == [("r/1", 1)]


def test_before_the_first_look_there_is_no_cursor_that_would_ask_for_everything(store: Store) -> None:
    assert pose_watch_of(store).alive().cursor == ""
    assert event_watch_of(store).alive().cursor == ""
    opened(store, "r/1")
    assert heard(event_watch_of(store))[0] == []
    assert heard(event_watch_of(store, from_start=True))[0] == [("r/1", 1)]


def test_events_come_in_pages_once_each_and_those_that_are_gone_are_counted(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(history, "KEPT_EVENTS", 8)
    monkeypatch.setattr(event_watch, "PAGE_EVENTS", 3)
    ended = opened(store, "r/1")
    commit(store, ended, 1, 2, events=[EVENT] * 4, finished=True)
    going = opened(store, "r/2")
    commit(store, going, 1, 2, events=[EVENT] * 20)
    watch = event_watch_of(store, from_start=True)
    events, lost, cursor = heard(watch)
    assert sorted(events) == [("r/1", n) for n in range(1, 6)] + [("r/2", n) for n in range(14, 22)]
    assert len(set(events)) == len(events)
    assert lost == 13
    assert Cursor.parse(cursor) == Cursor(going, {"r/2": 21})
    commit(store, going, 3, 3, events=[EVENT])
    third = opened(store, "r/3")
    commit(store, third, 1, 1, finished=True)
    assert heard(event_watch_of(store, cursor))[:2] == ([("r/2", 22), ("r/3", 1)], 0)
    assert heard(watch)[0] == [("r/2", 22), ("r/3", 1)]


MANY = json.dumps([1, {f"r/{k}": 1 for k in range(40_000)}])  # sessions, more than a database can be asked about


@pytest.mark.parametrize(
    "text", ["soup", "[1]", "{}", '[1,{"a":"b"}]', "[1.5,{}]", "[-1,{}]", "[1,[]]", "null", "[" * 9999, MANY]
)
def test_what_is_no_cursor_is_said(text: str) -> None:
    with pytest.raises(CursorError, match="expected one of an earlier message"):
        Cursor.parse(text)
