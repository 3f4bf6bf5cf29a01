"""Where the robot was, by the map of now and as it was told then: a real pipeline, a real loop, both engines."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from sqlalchemy import select, update

from map_service import history, schema
from map_service.catalog import Catalog
from map_service.integrity import Seen, findings
from map_service.packing import pack_covariance, unpack_covariance
from map_service.pose_at import NotKnownError, PoseAt, SessionPoses
from map_service.rows import SessionCommit
from map_service.settings import GraphSettings
from map_service.store import Store
from map_service.types import MapAnswer, State
from splitslam import se3
from tests.map_pipeline.made_walks import SECOND
from tests.map_pipeline.test_settling import made
from tests.map_service.entries import OPENING, entry, pose, with_move
from tests.tolerances import SAME_POSE, STORED_COVARIANCE

DRIFT = np.array([0, 0, 0, 0.0, 0.012, 0])
WAY = [(0.0, 0.0), (36.0, 0.0), (0.0, 0.5)]


@dataclass(frozen=True, eq=False)
class Driven:
    """A stored walk. then: by version that has ended, the stored poses by seq just before it did."""

    key: int
    answers: list[MapAnswer]
    then: dict[int, dict[int, np.ndarray]]


def stored_poses(store: Store, key: int) -> dict[int, np.ndarray]:
    return {seq: T for page in Catalog(store).trajectory(key) for seq, _, T in page}


@dataclass(frozen=True, eq=False)
class Step:
    """What one frame of a walk brings: its answer, what is to be stored of it, the version of the map after it."""

    answer: MapAnswer
    entry: SessionCommit
    version: int


@pytest.fixture(scope="module")
def walk() -> list[Step]:
    """Committed after each frame, so that the store can be looked at as it was at every version's end."""
    pipeline, frames = made(WAY, DRIFT)
    steps: list[Step] = []
    for seq, frame in enumerate(frames, 1):
        answer = pipeline.answer(frame)
        commit = replace(pipeline.take_commit(), previous_seq=seq - 1, last_seq=seq)
        entry = SessionCommit(commit, {seq: answer.T_map_odom}, covariance={seq: answer.covariance})
        steps.append(Step(answer, entry, pipeline.chronicle.map_version))
    return steps


@pytest.fixture
def driven(store: Store, walk: list[Step]) -> Driven:
    """The walk in a store."""
    key = store.open_session(OPENING).key
    then: dict[int, dict[int, np.ndarray]] = {}
    version = 1
    for step in walk:
        if step.version > version:
            then[version] = stored_poses(store, key)
            version = step.version
        store.commit(key, 1, step.entry)
    return Driven(key, [step.answer for step in walk], then)


def at(store: Store, key: int, stamp_ns: int, version: int = 0) -> PoseAt:
    with store.reading() as connection:
        return SessionPoses(connection, key).at(stamp_ns, version)


def check_covariance(found: np.ndarray | None, expected: np.ndarray) -> None:
    assert found is not None
    sigmas = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(
        found / np.outer(sigmas, sigmas), expected / np.outer(sigmas, sigmas), atol=STORED_COVARIANCE
    )


def test_a_covariance_is_stored_to_a_part_of_its_sigmas_and_stays_one() -> None:
    rng = np.random.default_rng(5)
    for _ in range(100):
        axes = np.linalg.qr(rng.normal(size=(6, 6)))[0]
        covariance = (axes * 10.0 ** rng.uniform(-10, 1, 6)) @ axes.T
        check_covariance(back := unpack_covariance(pack_covariance(covariance)), covariance)
        assert back is not None
        assert np.linalg.eigvalsh(back)[0] > -1e-15
    flat = unpack_covariance(pack_covariance(np.diag([1e-6, 1e-6, 1e-6, 1.0, 1.0, 0.0])))  # along z it is sure
    assert flat is not None
    check_covariance(flat[:5, :5], np.diag([1e-6, 1e-6, 1e-6, 1.0, 1.0]))
    assert pack_covariance(np.full((6, 6), np.nan)) is None
    huge = np.eye(6) * 1e6
    assert np.isfinite(unpack_covariance(pack_covariance(huge))).all()  # type: ignore[arg-type]


def test_the_pose_of_now_is_that_of_the_trajectory_and_that_of_then_is_what_was_answered(
    store: Store, driven: Driven
) -> None:
    now = stored_poses(store, driven.key)
    versions = {answer.map_version for answer in driven.answers}
    assert len(versions) > 1, "no correction moved the map"
    newest = max(versions)
    moved_m = 0.0
    for answer in driven.answers:
        found = at(store, driven.key, answer.stamp_ns)
        np.testing.assert_allclose(found.T_map_lidar, now[answer.seq], atol=SAME_POSE)
        assert (found.map_version, found.seq_before, found.seq_after) == (newest, answer.seq, answer.seq)
        assert found.state == answer.state
        check_covariance(found.covariance, answer.covariance)
        if answer.map_version < newest:
            then = at(store, driven.key, answer.stamp_ns, answer.map_version)
            np.testing.assert_allclose(then.T_map_lidar, answer.T_map_lidar, atol=SAME_POSE)
            delta = found.T_map_lidar @ se3.inv(then.T_map_lidar)
            moved_m = max(moved_m, float(np.linalg.norm((delta @ then.T_map_lidar - answer.T_map_lidar)[:3, 3])))
    assert moved_m > 0.05, "the loop has moved nothing that was told"


def test_an_earlier_scan_is_asked_for_in_a_later_version_as_that_one_ended(store: Store, driven: Driven) -> None:
    s, compared = GraphSettings(), 0
    for version, poses in driven.then.items():
        for answer in driven.answers:
            if answer.map_version < version:
                then = at(store, driven.key, answer.stamp_ns, version).T_map_lidar
                off = se3.inv(poses[answer.seq]) @ then
                assert np.linalg.norm(off[:3, 3]) < s.version_m
                assert se3.angle(off) < s.version_rad
                compared += 1
    assert compared > 20


def test_between_scans_the_pose_is_on_the_way_and_beyond_them_there_is_none(store: Store, driven: Driven) -> None:
    first, second = driven.answers[3], driven.answers[4]
    for version in (0, first.map_version):
        ends = [at(store, driven.key, answer.stamp_ns, version).T_map_lidar for answer in (first, second)]
        found = at(store, driven.key, first.stamp_ns + SECOND // 4, version)
        np.testing.assert_allclose(found.T_map_lidar, se3.interpolate(ends[0], ends[1], 0.25), atol=SAME_POSE)
        assert (found.seq_before, found.seq_after) == (first.seq, second.seq)
        check_covariance(found.covariance, 0.75 * first.covariance + 0.25 * second.covariance)
    with pytest.raises(NotKnownError, match="the session begins at"):
        at(store, driven.key, driven.answers[0].stamp_ns - 1)
    with pytest.raises(NotKnownError, match="the session ends at"):
        at(store, driven.key, driven.answers[-1].stamp_ns + 1)


def test_a_version_that_is_to_come_or_that_a_scan_is_not_in_is_said(store: Store, driven: Driven) -> None:
    last = driven.answers[-1]
    with pytest.raises(NotKnownError, match=f"map_version 99: known are 1 to {last.map_version}"):
        at(store, driven.key, last.stamp_ns, 99)
    with pytest.raises(NotKnownError, match=f"scan {last.seq} is first known in version {last.map_version}"):
        at(store, driven.key, last.stamp_ns, 1)


def test_where_two_scans_lie_in_two_versions_their_motion_of_now_is_taken(store: Store, driven: Driven) -> None:
    pairs = zip(driven.answers, driven.answers[1:], strict=False)
    before, after = next((a, b) for a, b in pairs if a.map_version < b.map_version)
    found = at(store, driven.key, before.stamp_ns + SECOND // 2, before.map_version)
    now = stored_poses(store, driven.key)
    half = se3.interpolate(np.eye(4), se3.inv(now[before.seq]) @ now[after.seq], 0.5)
    np.testing.assert_allclose(found.T_map_lidar, before.T_map_lidar @ half, atol=SAME_POSE)


def test_a_restored_session_goes_on_with_its_version(store: Store, driven: Driven) -> None:
    assert store.load(driven.key).map_version == driven.answers[-1].map_version


def test_a_store_with_versions_is_sound_and_damage_to_them_is_found(store: Store, driven: Driven) -> None:
    def found() -> list[str]:
        # the made clouds and payloads are real, so that only what is harmed is found
        return [finding for finding in findings(store, Seen()) if "version" in finding or "event" in finding]

    assert found() == []
    t = schema.map_versions
    for harm, said in (
        (update(t).where(t.c.version == 2).values(poses=b"x"), "map version 2: corrupt: poses of 1 bytes"),
        (update(t).where(t.c.version == 2).values(first_seq=10**6), "begins before the one before it"),
        (update(schema.sessions).values(map_version=90), "its row says 90"),
        (update(schema.sessions).values(events=17), "its row says 17"),
        (update(schema.events).values(content=b"\xff"), "event 1: corrupt"),
    ):
        with store.writing() as connection:
            connection.execute(harm)
        assert any(said in finding for finding in found()), harm


# -- bounds -------------------------------------------------------------------------------------------------------


def test_old_versions_and_events_make_room_and_the_bytes_they_took_are_given_back(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(history, "KEPT_VERSIONS", 4)
    monkeypatch.setattr(history, "KEPT_MOVES", 6)
    monkeypatch.setattr(history, "KEPT_EVENTS", 5)
    opened = store.open_session(OPENING)
    sizes = []
    for version in range(2, 13):
        made = entry(version - 2, version - 1, keyframes=(0,) if version == 2 else (), events=[b"e"])
        store.commit(opened.key, 1, with_move(made, version, 10))
        row = Catalog(store).session(OPENING.session_id)
        assert row is not None
        sizes.append(row.bytes)
    v, e = schema.map_versions, schema.events
    with store.reading() as connection:
        rows = connection.execute(select(v.c.version, v.c.poses.is_not(None)).order_by(v.c.version)).all()
        numbers = connection.execute(select(e.c.number).order_by(e.c.number)).scalars().all()
    assert [tuple(row) for row in rows] == [(n, n > 8) for n in range(7, 13)]
    assert numbers == [8, 9, 10, 11, 12]  # the first one said that the session was opened
    growth = np.diff(sizes)
    assert growth[-1] < growth[0] - 900, "a pose that is no longer kept still counts"
    frame_1_ns = 1000
    assert at(store, opened.key, frame_1_ns, 8).oldest_version == 8
    with pytest.raises(NotKnownError, match="map_version 7: known are 8 to 12"):
        at(store, opened.key, frame_1_ns, 7)


def test_versions_of_large_maps_are_bounded_by_their_bytes(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(history, "KEPT_VERSIONS_BYTES", 2500)
    opened = store.open_session(OPENING)
    for version in range(2, 8):
        made = entry(version - 2, version - 1, keyframes=(0,) if version == 2 else ())
        store.commit(opened.key, 1, with_move(made, version, 10))
    v = schema.map_versions
    with store.reading() as connection:
        kept = connection.execute(select(v.c.version).where(v.c.poses.is_not(None))).scalars().all()
    assert sorted(kept) == [6, 7]  # 960 bytes each


def test_in_its_own_version_a_scan_is_where_it_was_told_whatever_became_of_its_keyframe_or_its_place(
    store: Store,
) -> None:
    """As of scans that were carried while the robot was lost, and placed again when it was found."""
    opened = store.open_session(OPENING)
    store.commit(opened.key, 1, with_move(entry(0, 3, keyframes=(0,)), 2))
    store.commit(opened.key, 1, with_move(entry(3, 6), 3))
    told = at(store, opened.key, 2000, 1).T_map_lidar
    np.testing.assert_allclose(told, pose(102), atol=SAME_POSE)
    later = at(store, opened.key, 2000, 2).T_map_lidar  # its keyframe was at the origin as version 2 ended
    np.testing.assert_allclose(later, pose(2), atol=SAME_POSE)
    np.testing.assert_allclose(at(store, opened.key, 5000, 2).T_map_lidar, pose(105), atol=SAME_POSE)


def test_the_worse_state_of_two_scans_counts_and_scans_far_apart_have_nothing_between(store: Store) -> None:
    opened = store.open_session(OPENING)
    made = entry(0, 3, keyframes=(0,))
    states = {1: State.TRACKING, 2: State.LOST, 3: State.DEGENERATE}
    stamps_ns = {1: 10**9, 2: 2 * 10**9, 3: 3 * 10**9 + 1}
    frames = [replace(f, state=int(states[f.seq]), stamp_ns=stamps_ns[f.seq]) for f in made.commit.frames]
    store.commit(opened.key, 1, replace(made, commit=replace(made.commit, frames=frames)))
    found = at(store, opened.key, 3 * 10**9 // 2)
    assert (found.state, found.covariance) == (State.LOST, None)
    with pytest.raises(NotKnownError, match="no scan between 2000000000 and 3000000001"):
        at(store, opened.key, 5 * 10**9 // 2)
