"""Whatever arrives, the decoder answers with a frame or with its own error, quickly and in little memory."""

from __future__ import annotations

import tracemalloc
from collections import Counter

import numpy as np
import pytest

from splitslam import codec
from splitslam.codec import DecodeError
from splitslam.errors import DataError
from splitslam.features import FeatureFrame
from tests.codec.frames import COLUMNS, ELEVATIONS_RAD, made_frame
from tests.codec.mutations import KINDS, MAX_BYTES, decode, outcomes, payloads, sealed

FIELDS = ("points_lidar", "ring", "column", "t_offset_ns", "intensity")
MUTATIONS = 20_000


def payload() -> bytes:
    return codec.encode(made_frame(), ELEVATIONS_RAD, COLUMNS)


def test_every_truncation_is_refused():
    for data in payloads():
        for n in [*range(min(200, len(data))), *range(200, len(data), 7), len(data) - 1]:
            with pytest.raises(DecodeError):
                decode(data[:n])


def test_every_mutation_is_refused():
    rng = np.random.default_rng(0)
    for data in payloads():
        for _ in range(1000):
            mutated = bytearray(data)
            for _ in range(rng.integers(1, 4)):
                mutated[rng.integers(len(data))] ^= int(rng.integers(1, 256))
            with pytest.raises(DecodeError):
                decode(bytes(mutated))


def test_mutations_with_a_right_checksum_give_a_frame_or_the_decoders_own_error():
    for data in payloads():
        decode(data)  # the first call compiles: not what the time is about
    seen = Counter((kind, refused) for kind, _, refused in outcomes(MUTATIONS, seed=1))
    for kind in KINDS:
        assert seen[kind, True] > 100


def test_mutations_are_decoded_in_little_memory():
    decode(payload())
    tracemalloc.start()
    for _ in outcomes(1000, seed=2):
        pass
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < MAX_BYTES


def test_bytes_after_the_end_are_refused_even_with_a_right_checksum():
    for data in payloads()[1:]:
        with pytest.raises(DecodeError, match="end"):
            decode(sealed(data[:-4] + bytes(9)))


def test_a_frame_of_the_largest_size_stays_within_the_memory_bound():
    """131,072 points: what the decoder allocates at most."""
    n = codec.MAX_POINTS
    elevations = np.radians(np.linspace(-20, 20, 128)).astype(np.float32)
    cells = np.arange(n)
    frame = made_frame(corners=0, surfs=1)
    full = type(frame.surfs)(
        points_lidar=np.tile(np.array([[10.0, 0, 0]], np.float32), (n, 1)),
        ring=(cells // 2048).astype(np.uint8),
        column=(cells % 2048).astype(np.uint16),
        t_offset_ns=(cells % 2048 * 48_828).astype(np.int32),
        intensity=np.zeros(n, np.uint8),
    )
    data = codec.encode(FeatureFrame(1, 0, True, frame.motion, frame.corners, full), elevations, 2048)
    tracemalloc.start()
    decoded = codec.decode(data, 1, 0, True, elevations)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(decoded.surfs) == n
    assert peak < MAX_BYTES  # the frame itself and the integers it came from


def test_a_frame_that_is_too_large_drops_that_scan():
    frame = made_frame(corners=0, surfs=1)
    surfs = type(frame.surfs)(*(np.repeat(getattr(frame.surfs, f), codec.MAX_POINTS + 1, axis=0) for f in FIELDS))
    with pytest.raises(DataError, match="too_many_features"):
        codec.encode(FeatureFrame(1, 0, True, frame.motion, frame.corners, surfs), ELEVATIONS_RAD, COLUMNS)


@pytest.mark.parametrize("version", [0, 3, 9, 255])
def test_a_version_that_is_not_ours_is_named(version: int):
    data = bytearray(payload())
    data[0] = version
    with pytest.raises(DecodeError, match=f"version {version}, expected 1 to 2") as error:
        decode(bytes(data))
    assert error.value.reason == "version"


def test_a_frame_of_another_sensor_is_refused():
    for data in payloads():
        with pytest.raises(DecodeError, match="16 rings"):
            codec.decode(data, 1, 0, True, ELEVATIONS_RAD[:8])
