"""Each kind of damage is found and named."""

from __future__ import annotations

from dataclasses import replace

import pytest
from sqlalchemy import text

from map_service.cloud import decode_cloud
from map_service.integrity import Seen, findings
from map_service.places import PlaceIndex
from map_service.settings import PlaceSettings
from map_service.store import Store
from splitslam.errors import DataError
from tests.map_service.entries import OPENING, sound
from tests.map_service.fakes import POINTS_LIDAR, made_cloud


@pytest.fixture
def session(store: Store) -> int:
    opened = store.open_session(OPENING)
    store.commit(opened.key, 1, sound())
    return opened.key


@pytest.mark.usefixtures("session")
def test_a_sound_store_has_no_findings(store: Store) -> None:
    seen = Seen()
    assert list(findings(store, seen)) == []
    assert (seen.sessions, seen.frames, seen.keyframes) == (1, 6, 2)


@pytest.mark.usefixtures("session")
@pytest.mark.parametrize(
    ("harm", "found"),
    [
        ("DELETE FROM frames WHERE seq = 3", ["frames 3 to 3 are missing, and the robot", "5 frames, its row says 6"]),
        ("DELETE FROM holes", ["frames 5 to 6 are missing, and the robot did not say so"]),
        ("UPDATE holes SET follows_seq = 2", ["frames 5 to 6 are missing"]),
        ("DELETE FROM frames WHERE seq = 9", ["the last frame is 8, its row says 9", "5 frames, its row says 6"]),
        ("DELETE FROM frames WHERE seq = 8", ["frames 8 to 8 are missing", "0 rejected, its row says 1"]),
        ("UPDATE frames SET keyframe = 7 WHERE seq = 2", ["frame 2 refers to keyframe 7, which is not there"]),
        ("UPDATE frames SET online_map_odom = {x00} WHERE seq = 2", ["frame 2: online_map_odom: pose of 1 bytes"]),
        ("UPDATE keyframes SET pose_map_lidar = {zeros} WHERE keyframe = 1", ["keyframe 1: pose that is no rigid"]),
        ("DELETE FROM clouds WHERE keyframe = 1", ["keyframe 1 has no cloud"]),
        ("UPDATE clouds SET cloud = {x00} WHERE keyframe = 0", ["keyframe 0: corrupt: keyframe cloud shorter"]),
        ("UPDATE factors SET payload = {x00} WHERE factor = 1", ["factor 1: "]),
        ("DELETE FROM factors WHERE factor = 0", ["factor 0 is missing"]),
        ("UPDATE factors SET kind = 'gnss' WHERE factor = 2", ["0 loops, its row says 1", "1 gnss factors, its row"]),
        ("UPDATE factors SET kind = 'gravity' WHERE factor = 1", ["2 keyframes, the graph has 1 poses"]),
        ("UPDATE sessions SET tracker = {x00}", ["tracker state: "]),
        ("UPDATE places SET keyframe = 5 WHERE keyframe = 1", ["place 5 belongs to no keyframe"]),
    ],
)
def test_damage_is_found_and_named(store: Store, harm: str, found: list[str]) -> None:
    with store.writing() as connection:
        if store.engine.dialect.name == "sqlite":
            connection.execute(text(harm.format(x00="x'00'", zeros="zeroblob(56)")))
        else:
            connection.execute(text(harm.format(x00="'\\x00'::bytea", zeros="decode(repeat('00', 56), 'hex')")))
    lines = list(findings(store, Seen()))
    for expected in found:
        assert any(line.startswith(f"r/1: {expected}") for line in lines), lines


@pytest.mark.usefixtures("session")
def test_a_bit_flipped_in_a_cloud_is_found_by_its_checksum(store: Store) -> None:
    flipped = bytearray(made_cloud())
    flipped[-1] ^= 1
    with store.writing() as connection:
        statement = text("UPDATE clouds SET cloud = :cloud WHERE keyframe = 0")
        connection.execute(statement, {"cloud": bytes(flipped)})
    assert [line.startswith("r/1: keyframe 0: corrupt") for line in findings(store, Seen())] == [True]


def test_no_bit_of_a_cloud_can_flip_and_change_what_it_says() -> None:
    cloud = made_cloud()
    said = [array.tobytes() for array in decode_cloud(cloud)]
    found = 0
    for bit in range(8 * 12, 8 * len(cloud)):  # behind our own header, which says how many points
        flipped = bytearray(cloud)
        flipped[bit // 8] ^= 1 << bit % 8
        try:
            assert [array.tobytes() for array in decode_cloud(bytes(flipped))] == said
        except DataError:
            found += 1
    assert found > 7 * (len(cloud) - 12)


def test_holes_of_before_the_version_that_notes_them_are_no_findings(store: Store) -> None:
    opened = store.open_session(OPENING)
    store.commit(opened.key, 1, replace(sound(), holes=[]))
    assert len(list(findings(store, Seen()))) == 1
    with store.writing() as connection:
        connection.execute(text("INSERT INTO meta VALUES ('since_2', '9e9')"))
    assert list(findings(store, Seen())) == []


def test_a_place_is_packed_as_long_as_it_says() -> None:
    index = PlaceIndex(PlaceSettings())
    index.add(POINTS_LIDAR)
    assert len(index.packed(0)) == 20 * 31 * 8 + 20 * 5 * 4
