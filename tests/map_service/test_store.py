"""The store: epochs, fenced atomic commits, what comes back."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sqlalchemy import event, select, update

from map_service import schema
from map_service.catalog import Catalog
from map_service.rows import SessionCommit
from map_service.store import FencedError, FinishedError, Store, StoreError
from map_service.types import Commit, KeyframeRecord
from splitslam.errors import InputError
from tests.map_service.entries import OPENING, entry, pose, with_move

POSE_TOLERANCE = 1e-12  # a rotation goes through a unit quaternion in float64


def test_each_opening_adds_one_to_the_epoch(store: Store) -> None:
    assert [store.open_session(OPENING).epoch for _ in range(3)] == [1, 2, 3]


def test_two_owners_never_get_the_same_epoch(url: str) -> None:
    stores = [Store(url) for _ in range(4)]
    with ThreadPoolExecutor(4) as threads:
        opened = list(threads.map(lambda i: stores[i % 4].open_session(OPENING), range(40)))
    assert sorted(o.epoch for o in opened) == list(range(1, 41))
    assert len({o.key for o in opened}) == 1
    for s in stores:
        s.close()


def test_what_was_committed_comes_back_as_it_was(store: Store) -> None:
    opened = store.open_session(OPENING)
    first = entry(0, 3, keyframes=(0,))
    store.commit(opened.key, 1, first)
    second = entry(3, 6, keyframes=(1,), rejected=[(6, 6000, "corrupt")], statistics='{"cpu_ms": 5}')
    second.commit.frames.pop()
    store.commit(opened.key, 1, second)
    snapshot = store.load(opened.key)
    assert (snapshot.last_seq, snapshot.tracker, snapshot.mapped) == (6, b"tracker 6", 5)
    answers = store.answers(opened.key, last=6)
    (page,) = Catalog(store).trajectory(opened.key)
    given = first.commit.frames + second.commit.frames
    for frame, answer, (seq, stamp_ns, T_map_lidar) in zip(given, answers[:5], page, strict=True):
        assert (answer.seq, answer.stamp_ns, answer.state) == (frame.seq, frame.stamp_ns, frame.state)
        assert (seq, stamp_ns) == (frame.seq, frame.stamp_ns)
        assert answer.T_map_lidar is not None
        np.testing.assert_allclose(answer.T_map_lidar, frame.T_map_lidar_online, atol=POSE_TOLERANCE)
        np.testing.assert_allclose(T_map_lidar, pose(1000) @ frame.T_keyframe_lidar, atol=POSE_TOLERANCE)
    assert answers[5].rejected == "corrupt"
    assert [k.index for k in snapshot.keyframes] == [0, 1]
    assert snapshot.places == [b"place 0", b"place 1"]
    assert store.clouds(opened.key, [1, 0]) == {0: b"\x00", 1: b"\x01"}
    assert [(f.index, f.kind, f.payload) for f in snapshot.factors] == [(0, "prior", b"factor"), (1, "loop", b"factor")]
    row = Catalog(store).session("r/1")
    assert row is not None
    assert (row.frames, row.rejected, row.keyframes, row.loops, row.gnss_factors) == (5, 1, 2, 1, 0)
    assert (row.first_stamp_ns, row.last_stamp_ns) == (1000, 5000)
    again = store.open_session(OPENING)
    assert (again.epoch, again.last_seq, again.statistics) == (2, 6, '{"cpu_ms": 5}')


def test_a_session_is_as_long_as_what_was_mapped_of_it(store: Store) -> None:
    """The stamp of a rejected frame may be any number."""
    opened = store.open_session(OPENING)
    ahead, back = 1 << 62, -5

    def times() -> tuple[int, int]:
        row = Catalog(store).session("r/1")
        assert row is not None
        return row.first_stamp_ns, row.last_stamp_ns

    nothing = Commit(0, 2, [], [], [], [], b"")
    store.commit(opened.key, 1, SessionCommit(nothing, {}, [(1, ahead, "time"), (2, back, "corrupt")]))
    assert times() == (0, 0)
    store.commit(opened.key, 1, entry(2, 5, keyframes=(0,)))
    assert times() == (3000, 5000)
    some = entry(5, 8, rejected=[(8, ahead, "time")])
    some.commit.frames.pop()
    store.commit(opened.key, 1, some)
    assert times() == (3000, 7000)


def test_the_last_answers_come_back_in_order_with_both_poses(store: Store) -> None:
    opened = store.open_session(OPENING)
    store.commit(opened.key, 1, entry(0, 5, keyframes=(0,)))
    answers = store.answers(opened.key, last=2)
    assert [a.seq for a in answers] == [4, 5]
    (fourth,) = store.answers(opened.key, seq=4)
    assert fourth.T_map_lidar is not None
    assert fourth.T_map_odom is not None
    np.testing.assert_allclose(fourth.T_map_lidar, pose(104), atol=POSE_TOLERANCE)
    np.testing.assert_allclose(fourth.T_map_odom, pose(204), atol=POSE_TOLERANCE)


@pytest.mark.parametrize(
    ("epoch", "previous"),
    [
        pytest.param(1, 3, id="an older epoch"),
        pytest.param(2, 2, id="frames that the store has already"),
        pytest.param(2, 4, id="frames with a hole before them"),
    ],
)
def test_a_commit_that_does_not_fit_is_fenced_and_writes_nothing(store: Store, epoch: int, previous: int) -> None:
    opened = store.open_session(OPENING)
    store.commit(opened.key, 1, entry(0, 3, keyframes=(0,)))
    store.open_session(OPENING)
    with pytest.raises(FencedError):
        store.commit(opened.key, epoch, entry(previous, 8, keyframes=(1,)))
    snapshot = store.load(opened.key)
    assert (snapshot.last_seq, snapshot.mapped, len(snapshot.keyframes)) == (3, 3, 1)
    assert len(store.answers(opened.key, last=9)) == 3


def test_a_commit_whose_outcome_was_lost_can_be_sent_again(store: Store) -> None:
    opened = store.open_session(OPENING)
    for _ in range(2):
        store.commit(opened.key, 1, entry(0, 3, keyframes=(0,)))
    assert len(store.answers(opened.key, last=9)) == 3


def test_a_commit_is_all_or_nothing(store: Store) -> None:
    opened = store.open_session(OPENING)
    broken = entry(0, 3, keyframes=(0,))
    broken.commit.factors.append(broken.commit.factors[0])  # the same key twice: refused after the frames went in
    with pytest.raises(Exception, match=r"(?i)unique"):
        store.commit(opened.key, 1, broken)
    snapshot = store.load(opened.key)
    assert (snapshot.last_seq, store.answers(opened.key, last=9), snapshot.keyframes) == (0, [], [])


def test_a_keyframe_that_comes_again_replaces_the_one_before(store: Store) -> None:
    opened = store.open_session(OPENING)
    store.commit(opened.key, 1, entry(0, 3, keyframes=(0,)))
    again = entry(3, 4)
    again.commit.keyframes.append(KeyframeRecord(0, 1, 1000, pose(7), b"better"))
    store.commit(opened.key, 1, again)
    (keyframe,) = store.load(opened.key).keyframes
    assert store.clouds(opened.key, [0]) == {0: b"better"}
    np.testing.assert_allclose(keyframe.T_map_lidar, pose(7), atol=POSE_TOLERANCE)
    row = Catalog(store).session("r/1")
    assert row is not None
    assert row.keyframes == 1


def test_the_trajectory_follows_the_corrected_keyframes(store: Store) -> None:
    opened = store.open_session(OPENING)
    store.commit(opened.key, 1, entry(0, 3, keyframes=(0,)))
    moved = entry(3, 4)
    moved.commit.keyframe_poses.append((0, pose(42)))
    store.commit(opened.key, 1, moved)
    (page,) = Catalog(store).trajectory(opened.key)
    assert [seq for seq, _, _ in page] == [1, 2, 3, 4]
    np.testing.assert_allclose(page[2][2], pose(42) @ pose(3), atol=POSE_TOLERANCE)


def test_frames_that_are_placed_again_keep_the_answer_they_were_given(store: Store) -> None:
    opened = store.open_session(OPENING)
    first = entry(0, 3, keyframes=(0,))
    store.commit(opened.key, 1, first)
    later = entry(3, 5, rejected=[(5, 5000, "corrupt")])
    later.commit.frames.pop()
    later.commit.frames_again.extend([(2, pose(70)), (5, pose(71))])  # a rejected one has no pose to correct
    store.commit(opened.key, 1, later)
    (page,) = Catalog(store).trajectory(opened.key)
    assert [seq for seq, _, _ in page] == [1, 2, 3, 4]
    np.testing.assert_allclose(page[0][2], pose(1000) @ pose(1), atol=POSE_TOLERANCE)
    np.testing.assert_allclose(page[1][2], pose(1000) @ pose(70), atol=POSE_TOLERANCE)
    given = store.answers(opened.key, seq=2)[0].T_map_lidar
    assert given is not None
    np.testing.assert_allclose(given, first.commit.frames[1].T_map_lidar_online, atol=POSE_TOLERANCE)


def test_a_trajectory_comes_in_pages_of_at_most_a_thousand(store: Store) -> None:
    opened = store.open_session(OPENING)
    store.commit(opened.key, 1, entry(0, 2500, keyframes=(0,)))
    assert [len(page) for page in Catalog(store).trajectory(opened.key)] == [1000, 1000, 500]


def test_a_map_is_read_keyframe_by_keyframe_as_the_first_thing_of_a_transaction(store: Store) -> None:
    opened = store.open_session(OPENING)
    store.commit(opened.key, 1, entry(0, 40, keyframes=tuple(range(20))))
    assert [keyframe.index for keyframe in Catalog(store).keyframes(opened.key)] == list(range(20))


def test_a_finished_session_takes_no_commit_and_no_owner(store: Store) -> None:
    opened = store.open_session(OPENING)
    store.commit(opened.key, 1, entry(0, 3, keyframes=(0,), finished=True))
    with pytest.raises(FencedError):
        store.commit(opened.key, 1, entry(3, 4))
    with pytest.raises(FinishedError):
        store.open_session(OPENING)


def test_the_owner_of_a_deleted_session_cannot_write_into_its_successor(store: Store) -> None:
    old = store.open_session(OPENING)
    assert Catalog(store).delete("r/1") is not None
    new = store.open_session(OPENING)
    assert new.epoch == old.epoch
    with pytest.raises(FencedError):
        store.commit(old.key, old.epoch, entry(0, 3, keyframes=(0,)))
    assert store.load(new.key).last_seq == 0


def test_a_delete_says_what_it_removed_and_leaves_no_row(store: Store) -> None:
    for session_id in ("r/1", "r/2"):
        opened = store.open_session(replace(OPENING, session_id=session_id))
        store.commit(opened.key, 1, with_move(entry(0, 3, keyframes=(0, 1), holes=[(2, 0)]), 2))
    catalog = Catalog(store)
    total = catalog.bytes_by_site()["site"]
    deleted = catalog.delete("r/1")
    assert deleted is not None
    assert (deleted.frames, deleted.keyframes, 2 * deleted.bytes) == (3, 2, total)
    assert catalog.bytes_by_site() == {"site": total - deleted.bytes}
    with store.reading() as connection:
        for table in schema.SESSION_TABLES:
            later = table in (schema.pose_blocks, schema.anchors, schema.dense_clouds)  # filled after commits
            assert {row.session for row in connection.execute(table.select())} == (set() if later else {opened.key})
    assert catalog.delete("r/1") is None


def test_a_session_that_another_holds_locked_is_a_store_error(url: str, store: Store) -> None:
    opened = store.open_session(OPENING)
    impatient = Store(url)
    if impatient.engine.dialect.name == "sqlite":
        with impatient.reading() as connection:
            connection.exec_driver_sql("PRAGMA busy_timeout=50")
    else:
        event.listen(impatient.engine, "begin", lambda c: c.exec_driver_sql("SET LOCAL lock_timeout = 50"))
    with store.writing() as connection:
        connection.execute(update(schema.sessions).values(robot_file="locked"))
        with pytest.raises(StoreError, match="lock"):
            impatient.commit(opened.key, 1, entry(0, 1, keyframes=(0,)))
    impatient.commit(opened.key, 1, entry(0, 1, keyframes=(0,)))
    impatient.close()


@pytest.mark.parametrize(
    ("bad", "said"),
    [
        ("nonsense", "expected sqlite:///FILE"),
        ("sqlite://", "expected sqlite:///FILE"),
        ("sqlite:////nowhere/at/all/map.db", "no directory /nowhere/at/all"),
        ("sqlite:////tmp", "store: sqlite:////tmp: expected a file, found a directory"),
        ("oracle+none://user:secret@host/db", "host/db"),
    ],
)
def test_a_url_that_cannot_be_opened_is_one_line_without_its_password(bad: str, said: str) -> None:
    with pytest.raises(InputError) as error:
        Store(bad)
    assert said in str(error.value)
    assert "secret" not in str(error.value)
    assert "\n" not in str(error.value)


def test_a_file_that_is_no_database_is_said_so(tmp_path: Path) -> None:
    (tmp_path / "map.db").write_text("this is not a database " * 100)
    with pytest.raises(InputError, match="not a database"):
        Store(f"sqlite:///{tmp_path}/map.db")


def test_commits_survive_a_power_cut(store: Store) -> None:
    expected = {
        "sqlite": {"PRAGMA synchronous": 2, "PRAGMA journal_mode": "wal"},
        "postgresql": {"SHOW synchronous_commit": "on", "SHOW fsync": "on"},
    }[store.engine.dialect.name]
    with store.reading() as connection:
        assert {query: connection.exec_driver_sql(query).scalar() for query in expected} == expected


def test_a_reader_sees_one_state_of_the_store_throughout(store: Store) -> None:
    opened = store.open_session(OPENING)
    with store.reading() as connection:
        query = select(schema.sessions.c.last_seq)
        before = connection.execute(query).scalar()
        store.commit(opened.key, 1, entry(0, 3, keyframes=(0,)))
        assert (before, connection.execute(query).scalar()) == (0, 0)
