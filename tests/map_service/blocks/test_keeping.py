"""Old scans move into blocks, once and for all readers alike; what is in neither place is in no test."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest
from sqlalchemy import Connection, func, insert, select, text

from map_service import block_keeping, carried, schema
from map_service.archive import backup, restore
from map_service.block_keeping import MERGED, OPEN, SCANS, BlockKeeper, Kept
from map_service.catalog import Catalog
from map_service.config import PosesConfig
from map_service.integrity import Seen, findings
from map_service.migrations import migrate
from map_service.pose_at import SessionPoses
from map_service.rows import SessionCommit
from map_service.scan_poses import stored_scans
from map_service.scans import Scans
from map_service.store import Store
from map_service.types import Commit, FactorRecord, FrameRecord, KeyframeRecord
from tests import tolerances
from tests.conftest import ROOT
from tests.map_service.blocks.made_scans import circling, furthest, scans_along
from tests.map_service.entries import JSON, OPENING
from tests.map_service.fakes import made_cloud

FULL_RATE = PosesConfig(full_rate_h=0.0)
WAY = circling(2 * OPEN + 3 * SCANS)
PIECES = OPEN + 2 * SCANS, len(WAY)  # what the store has at first, and later
ALL = scans_along(WAY)


def committed(store: Store, key: int, first: int, last: int, *, finished: bool = False) -> None:
    """Scans first + 1 to last of WAY; a keyframe each ten."""
    for begin in range(first, last, 200):
        end = min(begin + 200, last)
        _commit(store, key, begin, end, finished=finished and end == last)


def _commit(store: Store, key: int, first: int, last: int, *, finished: bool) -> None:
    scans = ALL.part(slice(first, last))
    mapped = [scan for scan in scans if scan.seq % 100 != 50]
    rejected = [(scan.seq, scan.stamp_ns, "corrupt") for scan in scans if scan.seq % 100 == 50]
    frames = [FrameRecord(s.seq, s.stamp_ns, s.keyframe, s.T_keyframe_lidar, s.T_map_lidar, s.state) for s in mapped]
    new = range(-(-first // 10), -(-last // 10))
    keyframes = [KeyframeRecord(k, 10 * k + 1, int(scans.stamp_ns[0]), WAY[10 * k], made_cloud()) for k in new]
    factors = [FactorRecord(k, "odometry" if k else "prior", JSON) for k in new]
    commit = Commit(first, last, frames, keyframes, factors, [], JSON)
    entry = SessionCommit(commit, {s.seq: s.T_map_odom for s in mapped}, rejected, finished=finished)
    store.commit(key, 1, replace(entry, covariance={s.seq: s.covariance for s in mapped}))


@pytest.fixture
def key(store: Store) -> int:
    """A session that goes on, of so many scans that two blocks can be closed."""
    opened = store.open_session(OPENING)
    committed(store, opened.key, 0, PIECES[0])
    return opened.key


def count(store: Store, table) -> int:
    with store.reading() as connection:
        return connection.execute(select(func.count()).select_from(table)).scalar_one()


def poses(store: Store, key: int) -> np.ndarray:
    return np.array([T for page in Catalog(store).trajectory(key) for _, _, T in page])


def numbers(store: Store, key: int) -> list[tuple[int, int]]:
    return [(seq, stamp_ns) for page in Catalog(store).trajectory(key) for seq, stamp_ns, _ in page]


def followed(store: Store, key: int) -> list[tuple]:
    """What WatchPoses tells from the start, but for the numbers that are told in steps."""
    told, after = [], 0
    with store.reading() as connection:
        while page := stored_scans(connection, key, "r/1", after, 200, np.eye(4)):
            after = page[-1].seq
            told += page
    return [(s.seq, s.pose and (s.pose.stamp_ns, s.pose.state, s.pose.map_version, s.pose.keyframe)) for s in told]


def sound(store: Store) -> bool:
    return list(findings(store, Seen())) == []


def test_the_oldest_scans_move_in_whole_blocks_and_every_reader_finds_them_there(store: Store, key: int) -> None:
    before = numbers(store, key), followed(store, key), poses(store, key)
    size = Catalog(store).sessions()[0].bytes
    assert BlockKeeper(store, FULL_RATE).run(0.0) == Kept(closed=SCANS)
    assert (count(store, schema.pose_blocks), count(store, schema.frames)) == (1, PIECES[0] - SCANS)
    assert (numbers(store, key), followed(store, key)) == before[:2]
    assert furthest(poses(store, key), before[2])[0] < tolerances.BLOCK_POSE_M
    assert Catalog(store).sessions()[0].bytes < size - 200 * SCANS
    assert sound(store)
    stored = store.answers(key, seq=7)[0]
    assert furthest(stored.T_map_lidar[None], WAY[6:7])[0] < tolerances.BLOCK_ANSWER_M  # type: ignore[index]
    assert store.answers(key, seq=50)[0].rejected == "corrupt"
    with store.reading() as connection:
        found = SessionPoses(connection, key).at(int(ALL.stamp_ns[20]))
    assert (found.seq_before, found.seq_after, found.thinned) == (21, 21, False)
    np.testing.assert_allclose(found.T_map_lidar, WAY[20], atol=2 * tolerances.BLOCK_POSE_M)


def test_a_machine_that_takes_its_time_is_not_cut_off_by_the_database(
    store: Store, key: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """PostgreSQL ends a transaction that is idle for a second; and meanwhile the session could commit nothing."""
    encode, before = block_keeping.encode_block, len(numbers(store, key))

    def slow(*what) -> tuple[bytes, int]:
        time.sleep(1.5)
        committed(other, key, PIECES[0], PIECES[0] + 10)
        return encode(*what)

    monkeypatch.setattr(block_keeping, "encode_block", slow)
    other = Store(store.engine.url.render_as_string(hide_password=False))
    assert BlockKeeper(store, FULL_RATE).run(0.0, 1) == Kept(closed=SCANS)
    other.close()
    assert len(numbers(store, key)) in (before + 9, before + 10)  # one may be of those that are rejected


@pytest.mark.parametrize("change", ["moved", "gone", "deleted"])
def test_what_has_changed_since_it_was_read_stays_as_it_is(
    store: Store, key: int, change: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Until the next time."""
    encode = block_keeping.encode_block
    statements = {
        "moved": "UPDATE frames SET pose_keyframe_lidar = online_map_lidar WHERE seq = 3",
        "gone": "DELETE FROM frames WHERE seq = 3",
    }

    def meanwhile(*what) -> tuple[bytes, int]:
        if change == "deleted":
            Catalog(other).delete(OPENING.session_id)
        else:
            with other.writing() as connection:
                connection.execute(text(statements[change]))
        return encode(*what)

    monkeypatch.setattr(block_keeping, "encode_block", meanwhile)
    other = Store(store.engine.url.render_as_string(hide_password=False))
    assert BlockKeeper(store, FULL_RATE).run(0.0) == Kept()
    other.close()
    assert count(store, schema.pose_blocks) == count(store, schema.anchors) == 0
    assert count(store, schema.frames) == {"moved": PIECES[0], "gone": PIECES[0] - 1, "deleted": 0}[change]
    monkeypatch.undo()
    again = BlockKeeper(store, FULL_RATE).run(0.0)
    assert again == {"moved": Kept(closed=SCANS), "gone": Kept(closed=SCANS), "deleted": Kept()}[change]


def test_a_session_that_goes_on_keeps_what_may_still_be_placed_anew_in_rows(store: Store, key: int) -> None:
    BlockKeeper(store, FULL_RATE).run(0.0)
    committed(store, key, *PIECES)
    assert BlockKeeper(store, FULL_RATE).run(0.0).closed == (len(WAY) - OPEN) // SCANS * SCANS - SCANS
    with store.reading() as connection:
        open_ = connection.execute(select(schema.frames.c.seq).where(schema.frames.c.rejected == "")).scalars().all()
    assert OPEN == carried.MOST
    assert len(open_) >= OPEN
    # a robot that is found has all that it was carried along placed anew
    new = [(seq, WAY[0]) for seq in open_[-OPEN:]]
    commit = Commit(len(WAY), len(WAY) + 1, [], [], [], [], JSON, frames_again=new)
    store.commit(key, 1, SessionCommit(commit, {}, [(len(WAY) + 1, 1, "time")]))
    with store.reading() as connection:
        moved = select(func.count(schema.frames.c.pose_keyframe_lidar.distinct()))
        assert connection.execute(moved.where(schema.frames.c.seq >= open_[-OPEN])).scalar() == 1


def test_of_a_session_that_has_ended_nothing_stays_in_rows(store: Store, key: int) -> None:
    committed(store, key, *PIECES, finished=True)
    before = numbers(store, key), followed(store, key)
    keeper = BlockKeeper(store, FULL_RATE)
    assert keeper.run(0.0).closed == len(WAY)
    assert count(store, schema.frames) == 0
    assert (numbers(store, key), followed(store, key)) == before
    assert [a.seq for a in store.answers(key, last=300)] == list(range(len(WAY) - 299, len(WAY) + 1))
    assert keeper.run(0.0) == Kept()
    assert sound(store)


def test_what_is_older_than_the_full_rate_is_kept_is_thinned_within_the_bounds_and_says_so(
    store: Store, key: int
) -> None:
    committed(store, key, *PIECES, finished=True)
    with store.reading() as connection:
        finished_s = connection.execute(select(schema.sessions.c.finished_s)).scalar_one()
    before, count_before = poses(store, key), len(numbers(store, key))
    config = PosesConfig(full_rate_h=1.0)
    keeper = BlockKeeper(store, config)
    assert keeper.run(finished_s + 3000.0).thinned == 0
    young = followed(store, key)
    thinned = keeper.run(finished_s + 3700.0).thinned
    assert thinned > 0.5 * len(WAY)
    blocks = -(-len(WAY) // SCANS)
    assert count(store, schema.pose_blocks) == -(-blocks // MERGED)
    assert len(numbers(store, key)) == count_before
    away_m, turned_rad = furthest(poses(store, key), before)
    assert away_m < config.within_m + tolerances.STAMP_OF_THINNED_S
    assert turned_rad < math.radians(config.within_deg)
    assert [one[0] for one in followed(store, key)] == [one[0] for one in young]
    with store.reading() as connection:
        told = stored_scans(connection, key, "r/1", 0, 1000, np.eye(4))
        at = SessionPoses(connection, key).at(int(ALL.stamp_ns[20]))
        assert connection.execute(select(func.sum(schema.pose_blocks.c.thinned))).scalar() == thinned
    assert sum(s.pose.thinned for s in told if s.pose) > 500
    assert not told[0].pose.thinned  # type: ignore[union-attr]
    assert at.thinned
    np.testing.assert_allclose(at.T_map_lidar[:3, 3], WAY[20][:3, 3], atol=config.within_m)
    assert keeper.run(finished_s + 1e6) == Kept()
    assert sound(store)


def test_a_running_session_is_thinned_by_its_own_time(store: Store, key: int) -> None:
    committed(store, key, *PIECES)
    blocks = (len(WAY) - OPEN) // SCANS
    keeper = BlockKeeper(store, PosesConfig(full_rate_h=1e-3))
    assert blocks < MERGED
    assert keeper.run(0.0).thinned == 0, "not before they are as many as become one"


@pytest.mark.parametrize("most", [1, 2])
def test_a_run_does_no_more_than_it_may_and_the_next_one_goes_on(store: Store, key: int, most: int) -> None:
    committed(store, key, *PIECES, finished=True)
    keeper, closed = BlockKeeper(store, FULL_RATE), []
    while done := keeper.run(0.0, most).closed:
        closed.append(done)
    assert sum(closed) == len(WAY)
    assert max(closed) == most * SCANS


def test_scans_that_cannot_be_read_stay_where_they_are_and_hold_nobody_up(store: Store, key: int) -> None:
    with store.writing() as connection:
        connection.execute(text("UPDATE frames SET online_map_lidar = online_map_odom, keyframe = -5 WHERE seq = 3"))
    other = store.open_session(replace(OPENING, session_id="r/2"))
    committed(store, other.key, 0, PIECES[0])
    assert BlockKeeper(store, FULL_RATE).run(0.0) == Kept(closed=SCANS)
    with store.reading() as connection:
        assert connection.execute(select(schema.pose_blocks.c.session)).scalars().all() == [other.key]


@pytest.mark.parametrize("later_ns", [-1, 0])
def test_scans_whose_stamps_do_not_rise_keep_their_rows(store: Store, key: int, later_ns: int) -> None:
    """No service writes such; a block of them could not be read again."""
    stamp_ns = int(ALL.stamp_ns[19]) + later_ns
    with store.writing() as connection:
        connection.execute(schema.frames.update().where(schema.frames.c.seq.in_([21, 22])).values(stamp_ns=stamp_ns))
    before = numbers(store, key), followed(store, key)
    assert BlockKeeper(store, FULL_RATE).run(0.0) == Kept()
    assert (numbers(store, key), followed(store, key)) == before


@pytest.mark.parametrize("harm", ["unreadable", "elsewhere", "another"])
def test_rows_go_only_when_what_a_block_says_of_them_has_been_read_again(
    store: Store, key: int, harm: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    encode = block_keeping.encode_block

    def harmed(scans: Scans, *rest) -> tuple[bytes, int]:
        if harm == "unreadable":
            return encode(scans, *rest)[0][:-1], 0
        if harm == "elsewhere":
            return encode(replace(scans, T_keyframe_lidar=scans.T_keyframe_lidar + 0.01 * np.eye(4, k=3)), *rest)
        return encode(replace(scans, seq=scans.seq + 1), *rest)

    monkeypatch.setattr(block_keeping, "encode_block", harmed)
    before = numbers(store, key), followed(store, key)
    assert BlockKeeper(store, FULL_RATE).run(0.0) == Kept()
    assert (numbers(store, key), followed(store, key)) == before
    assert count(store, schema.pose_blocks) == count(store, schema.anchors) == 0


@pytest.mark.parametrize("harm", ["content", "keyframe"])
def test_a_block_that_was_damaged_is_found(store: Store, key: int, harm: str) -> None:
    BlockKeeper(store, FULL_RATE).run(0.0)
    with store.writing() as connection:
        if harm == "content":
            content = bytearray(connection.execute(select(schema.pose_blocks.c.content)).scalar_one())
            content[len(content) // 2] ^= 1
            connection.execute(schema.pose_blocks.update().values(content=bytes(content)))
        else:
            connection.execute(schema.pose_blocks.update().values(last_seq=SCANS - 1))
    found = list(findings(store, Seen()))
    assert any(line.startswith("r/1: block 1") for line in found), found


# -- upgrades, backups, crashes -------------------------------------------------------------------------------------


def test_a_store_of_the_version_before_is_opened_and_keeps_its_rows_for_a_day(store: Store, key: int) -> None:
    """Replicas of the version before know rows alone."""
    migrate(store.engine, 4)
    migrate(store.engine)
    with store.reading() as connection:
        since_s = float(connection.execute(text("SELECT value FROM meta WHERE key = 'since_5'")).scalar_one())
    keeper = BlockKeeper(store, FULL_RATE)
    assert keeper.run(since_s + 86_000.0) == Kept()
    assert keeper.run(since_s + 86_401.0) == Kept(closed=SCANS)


def test_the_way_back_gives_every_scan_its_row_again(store: Store, key: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also on a machine that has to compile the kernels of blocks first."""
    reopen = block_keeping.reopen

    def slow(connection: Connection) -> None:
        time.sleep(1.5)
        reopen(connection)

    monkeypatch.setattr(block_keeping, "reopen", slow)
    committed(store, key, *PIECES, finished=True)
    size = Catalog(store).sessions()[0].bytes
    before = numbers(store, key), followed(store, key), poses(store, key)
    BlockKeeper(store, FULL_RATE).run(0.0)
    migrate(store.engine, 4)
    assert count(store, schema.frames) == len(WAY)
    assert Catalog(store).sessions()[0].bytes == size
    migrate(store.engine)
    assert (numbers(store, key), followed(store, key)) == before[:2]
    assert furthest(poses(store, key), before[2])[0] < tolerances.BLOCK_POSE_M
    assert sound(store)


def test_blocks_are_backed_up_restored_and_deleted_with_their_session(store: Store, key: int, tmp_path) -> None:
    BlockKeeper(store, FULL_RATE).run(0.0)
    before = poses(store, key)
    assert backup(store, tmp_path / "backup").frames == PIECES[0]
    assert restore(store, tmp_path / "backup", force=True).frames == PIECES[0]
    (row,) = Catalog(store).sessions()
    np.testing.assert_array_equal(poses(store, row.id), before)
    deleted = Catalog(store).delete(row.session_id)
    assert deleted is not None
    assert deleted.frames == PIECES[0]
    assert all(count(store, table) == 0 for table in schema.SESSION_TABLES)


@pytest.mark.parametrize("moment", ["written", "deleted"])
def test_whoever_dies_between_writing_a_block_and_deleting_its_rows_has_done_neither(
    store: Store, key: int, moment: str
) -> None:
    before = numbers(store, key), followed(store, key)
    url = store.engine.url.render_as_string(hide_password=False).replace("+psycopg", "")
    command = [sys.executable, "-m", "tests.map_service.blocks.stuck_keeper", url, moment]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as keeper:
        assert keeper.stdout is not None
        assert keeper.stdout.readline().strip() == moment
        os.kill(keeper.pid, signal.SIGKILL)
    assert (numbers(store, key), followed(store, key)) == before
    assert count(store, schema.pose_blocks) == 0
    assert sound(store)
    assert BlockKeeper(store, FULL_RATE).run(0.0) == Kept(closed=SCANS)
    assert (numbers(store, key), followed(store, key)) == before


def test_a_block_cannot_be_written_twice(store: Store, key: int) -> None:
    BlockKeeper(store, FULL_RATE).run(0.0)
    with store.reading() as connection:
        row = connection.execute(select(schema.pose_blocks)).one()._asdict()
    with pytest.raises(Exception, match=r"(?i)unique"), store.writing() as connection:
        connection.execute(insert(schema.pose_blocks).values(row))
