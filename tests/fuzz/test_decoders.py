"""The short form of `make fuzz`: everything that is decoded, fed with what nobody should send."""

from __future__ import annotations

import numpy as np
import pytest

from splitslam.errors import DataError, InputError
from splitslam.robot import robot_from_yaml
from tests.fuzz.mutate import mutated
from tests.fuzz.runner import run
from tests.fuzz.storage import clouds
from tests.fuzz.targets import TARGETS
from tests.fuzz.wire import YAMLS

INPUTS = {
    "codec": 2000,
    "messages": 6000,
    "robot_files": 60,
    "forwarded": 10000,
    "uploads": 3000,
    "spool_files": 400,
    "clouds": 10000,
    "dense_clouds": 1500,
    "store_rows": 60,
    "packets": 4000,
    "point_clouds": 1200,
    "recordings": 300,
    "mip": 1000,
    "nmea": 600,
    "udp_packets": 60,
    "captures": 1500,
}


@pytest.mark.parametrize("name", TARGETS)
def test_whatever_arrives_is_taken_or_refused_in_little_time_and_memory(name: str) -> None:
    target = TARGETS[name]()
    target.takes(target.make(np.random.default_rng(0)))  # compiles
    try:
        outcome = run(target, lambda done: done / INPUTS[name], seed=1)
    finally:
        target.close()
    outcome.check()


def test_a_target_with_a_defect_is_not_taken_for_one_that_refuses() -> None:
    target = TARGETS["forwarded"]()
    careless = type(target)("careless", target.make, lambda data: data.decode("ascii"), target.refusals)
    with pytest.raises(UnicodeDecodeError):
        run(careless, lambda done: done / 10_000, seed=1)


def test_mutations_reach_every_byte_and_length() -> None:
    rng, seed = np.random.default_rng(0), bytes(range(32))
    made = [mutated([seed], rng) for _ in range(5000)]
    assert all(any(len(m) > i and m[i] != seed[i] for m in made) for i in range(32))
    assert {len(m) < 32 for m in made} == {True, False}
    assert any(len(m) > 64 for m in made)


@pytest.mark.parametrize("text", YAMLS[2:], ids=["lists", "more lists", "merges", "nested", "digits", "tags"])
def test_a_robot_file_that_would_fill_the_memory_is_refused_in_one_line(text: bytes) -> None:
    with pytest.raises(InputError, match=r"robot file.*: ") as refused:
        robot_from_yaml(text.decode())
    assert len(str(refused.value)) < 400
    assert "\n" not in str(refused.value)


def test_a_cloud_that_claims_to_be_large_is_refused_before_it_is_made_room_for() -> None:
    claim = (
        b"KC\x01\x00" + bytes(4) + (3).to_bytes(4, "little") + b"\x28\xb5\x2f\xfd\xe0" + (1 << 45).to_bytes(8, "little")
    )
    with pytest.raises(DataError, match="another length"):
        clouds().feed(claim + bytes(40))
