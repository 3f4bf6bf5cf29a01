"""Each kind of damage is found and named."""

from __future__ import annotations

from dataclasses import replace

import pytest
from sqlalchemy import text

from map_service.cloud import encode_cloud
from map_service.integrity import Seen, findings
from map_service.places import PlaceIndex
from map_service.settings import PlaceSettings
from map_service.store import Store
from tests.map_service.entries import OPENING, sound
from tests.map_service.fakes import POINTS_LIDAR


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


def test_a_bit_flipped_in_a_cloud_is_found_by_its_checksum(store: Store, session: int) -> None:
    damaged = bytearray(encode_cloud(POINTS_LIDAR[:0], POINTS_LIDAR, *[POINTS_LIDAR[:0, 0].astype("u1")] * 2))
    for position in range(20, len(damaged)):
        flipped = bytearray(damaged)
        flipped[position] ^= 1
        with store.writing() as connection:
            update = text("UPDATE clouds SET cloud = :cloud WHERE session = :key AND keyframe = 0")
            connection.execute(update, {"cloud": bytes(flipped), "key": session})
        assert any(line.startswith("r/1: keyframe 0: corrupt") for line in findings(store, Seen())), position


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
