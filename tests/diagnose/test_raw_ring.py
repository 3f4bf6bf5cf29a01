"""The ring keeps the last of what came, in bounded room, through restarts and full disks."""

from __future__ import annotations

import errno
import logging
import os
from pathlib import Path

import pytest

from edge_agent import raw_ring
from edge_agent.config import RawRingConfig
from edge_agent.raw_ring import RawRing, RawStream, read_ring
from edge_agent.sources.bag import Bag
from splitslam.diagnose.raw import write_raw
from splitslam.errors import InputError
from tests.logs.said import said

SCANS, IMU = RawStream("/points", "x/Points", "ros1"), RawStream("/imu", "x/Imu", "ros1")
MIB = 2**20
STEP_NS = 100_000_000


def settings(**values: float) -> RawRingConfig:
    return RawRingConfig.model_validate(values)


def fill(ring: RawRing, first: int, last: int, size: int = 1000) -> None:
    """Message k comes at k tenths of a second and says its number."""
    for k in range(first, last):
        ring.add(SCANS, k * STEP_NS, k.to_bytes(4) * (size // 4))
        ring.add(IMU, k * STEP_NS + 1, k.to_bytes(4))


def numbers(folder: Path, seconds: float = 1e6, stream: RawStream = SCANS) -> list[int]:
    return [int.from_bytes(raw[:4]) for found, _, raw in read_ring(folder, seconds) if found == stream]


def size_of(folder: Path) -> int:
    return sum(file.stat().st_size for file in folder.iterdir())


def test_what_is_read_is_what_came_last_while_the_agent_goes_on_writing(tmp_path: Path):
    ring = RawRing(tmp_path, settings())
    fill(ring, 0, 50)
    assert numbers(tmp_path) == numbers(tmp_path, stream=IMU) == list(range(50))
    assert numbers(tmp_path, seconds=1.0) == list(range(40, 50))


def test_the_room_is_bounded_and_the_oldest_goes_first(tmp_path: Path):
    ring = RawRing(tmp_path, settings(max_bytes=MIB, seconds=1e6))
    for k in range(0, 4000, 40):
        fill(ring, k, k + 40)
        assert size_of(tmp_path) <= MIB
    found = numbers(tmp_path)
    assert found == list(range(found[0], 4000))
    assert len(found) > 0.8 * MIB / 1100


def test_what_is_older_than_it_should_be_goes_though_there_is_room(tmp_path: Path):
    ring = RawRing(tmp_path, settings(max_bytes=MIB, seconds=10))
    fill(ring, 0, 300)
    found = numbers(tmp_path)
    assert found[-1] == 299
    assert 100 <= len(found) < 250


def test_a_restart_goes_on_and_a_torn_end_costs_only_what_is_torn(tmp_path: Path):
    fill(RawRing(tmp_path, settings()), 0, 10)
    (file,) = tmp_path.iterdir()
    os.truncate(file, file.stat().st_size - 3)
    fill(RawRing(tmp_path, settings()), 10, 20)
    assert numbers(tmp_path) == list(range(20))
    assert numbers(tmp_path, stream=IMU) == [k for k in range(20) if k != 9]


def test_another_recording_or_a_clock_that_went_back_begins_anew(tmp_path: Path):
    ring = RawRing(tmp_path, settings())
    fill(ring, 1000, 1010)
    fill(ring, 0, 5)
    assert numbers(tmp_path) == list(range(5))


def test_a_full_disk_is_said_once_costs_nothing_else_and_is_got_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
):
    ring = RawRing(tmp_path, settings())
    fill(ring, 0, 5)
    whole = os.writev
    with monkeypatch.context() as patch, caplog.at_level(logging.ERROR):

        def full(*_: object) -> int:
            raise OSError(errno.ENOSPC, "No space left on device")

        patch.setattr(os, "writev", full)
        patch.setattr(raw_ring, "_AGAIN_S", 0.0)
        fill(ring, 5, 300)
    assert said(caplog) == [("raw messages not kept", {"detail": "[Errno 28] No space left on device"})]
    assert os.writev is whole
    assert len(list(tmp_path.iterdir())) <= 64
    fill(ring, 300, 305)
    assert numbers(tmp_path)[-5:] == list(range(300, 305))


def test_a_folder_that_cannot_be_made_is_one_clear_line(tmp_path: Path):
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=r"^raw_ring\.dir .*/file/raw: expected a directory that can be written"):
        RawRing(tmp_path / "file" / "raw", settings())


def test_a_ros_2_source_becomes_a_ros_2_recording(shared_data: Path, tmp_path: Path):
    ring = RawRing(tmp_path / "ring", settings())
    bag = Bag(shared_data / "fixtures/velodyne/vlp16_dual_return_ros2bag")
    with bag:
        sent = [(topic, at_ns, repr(message)) for topic, at_ns, message in bag.messages(set(bag.topics()), ring.add)]
        topics = bag.topics()
    ring.close()
    part = write_raw(tmp_path / "ring", 60.0, tmp_path)
    assert part.path is not None
    again = Bag(part.path)
    with again:
        assert again.topics() == topics
        assert [(topic, at_ns, repr(message)) for topic, at_ns, message in again.messages(set(topics))] == sent
    assert sum(part.messages.values()) == len(sent) > 0
