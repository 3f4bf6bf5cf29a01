"""Whatever arrives, the decoder answers with a frame or with its own error, quickly and in little memory."""

from __future__ import annotations

import struct
import time
import tracemalloc
import zlib

import numpy as np
import pytest
import zstandard

from splitslam import codec
from splitslam.codec import DecodeError
from splitslam.errors import DataError
from splitslam.features import FeatureFrame
from tests.codec.frames import COLUMNS, ELEVATIONS_RAD, made_frame

MAX_BYTES = 16 << 20
FIELDS = ("points_lidar", "ring", "column", "t_offset_ns", "intensity")


def payload() -> bytes:
    return codec.encode(made_frame(), ELEVATIONS_RAD, COLUMNS)


def decode(data: bytes) -> FeatureFrame:
    return codec.decode(data, 1, 0, True, ELEVATIONS_RAD)


def sealed(body: bytes) -> bytes:
    """With the right checksum, so that the checks behind it are met."""
    return body + struct.pack("<I", zlib.crc32(body))


def test_every_truncation_is_refused():
    data = payload()
    for n in [*range(200), *range(200, len(data), 7), len(data) - 1]:
        with pytest.raises(DecodeError):
            decode(data[:n])


def test_every_mutation_is_refused():
    data = payload()
    rng = np.random.default_rng(0)
    for _ in range(3000):
        mutated = bytearray(data)
        for _ in range(rng.integers(1, 4)):
            mutated[rng.integers(len(data))] ^= int(rng.integers(1, 256))
        with pytest.raises(DecodeError):
            decode(bytes(mutated))


@pytest.mark.parametrize("part", ["header", "anywhere", "random", "cut", "inserted"])
def test_a_mutation_with_a_right_checksum_gives_a_frame_or_the_decoders_own_error(part: str):
    decode(payload())  # the first call compiles: not what the time below is about
    data = payload()[:-4]
    rng = np.random.default_rng(len(part))
    refused = 0
    tracemalloc.start()
    for _ in range(600):
        body = bytearray(data)
        match part:
            case "header" | "anywhere":
                end = 120 if part == "header" else len(body)
                for _ in range(rng.integers(1, 4)):
                    body[rng.integers(1, end)] = int(rng.integers(256))
            case "random":
                body = bytearray(rng.integers(0, 256, rng.integers(1, 2000)).astype(np.uint8).tobytes())
                body[0] = codec.CODEC_VERSION
            case "cut":
                del body[int(rng.integers(1, len(body))) :]
            case "inserted":
                at = int(rng.integers(1, len(body)))
                body[at:at] = rng.integers(0, 256, rng.integers(1, 50)).astype(np.uint8).tobytes()
        before = time.perf_counter()
        try:
            frame = decode(sealed(bytes(body)))
        except DecodeError:
            refused += 1
        else:
            assert np.isfinite(frame.surfs.points_lidar).all()
            assert np.isfinite(frame.motion.T_prev_lidar).all()
            assert len(frame.surfs.ring) == 0 or frame.surfs.ring.max() < len(ELEVATIONS_RAD)
        assert time.perf_counter() - before < 5.0
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < MAX_BYTES
    assert refused > 50


def test_a_plane_that_claims_or_holds_gigabytes_is_refused_in_little_memory():
    data = payload()
    fixed = codec._FIXED
    lengths = list(struct.unpack_from("<7I", data, fixed - 28))
    claim = b"\xe0" + struct.pack("<Q", 1 << 40)  # one segment, content size 1 TiB
    bomb = zstandard.ZstdCompressor(
        compression_params=zstandard.ZstdCompressionParameters.from_level(
            3, format=zstandard.FORMAT_ZSTD1_MAGICLESS, write_content_size=True
        )
    ).compress(bytes(100_000_000))
    for plane in (claim + b"\x01\x00\x00", bomb):
        planes = data[fixed : fixed + sum(lengths)]
        rest = data[fixed + sum(lengths) : -4]
        body = data[: fixed - 28] + struct.pack("<7I", len(plane), *lengths[1:])
        body += plane + planes[lengths[0] :] + rest
        tracemalloc.start()
        with pytest.raises(DecodeError):
            decode(sealed(body))
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < MAX_BYTES


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
    assert peak < MAX_BYTES  # the frame itself and the planes it came from


def test_a_frame_that_is_too_large_drops_that_scan():
    frame = made_frame(corners=0, surfs=1)
    surfs = type(frame.surfs)(*(np.repeat(getattr(frame.surfs, f), codec.MAX_POINTS + 1, axis=0) for f in FIELDS))
    with pytest.raises(DataError, match="too_many_features"):
        codec.encode(FeatureFrame(1, 0, True, frame.motion, frame.corners, surfs), ELEVATIONS_RAD, COLUMNS)


def test_a_version_that_is_not_ours_is_named():
    data = bytearray(payload())
    data[0] = 9
    with pytest.raises(DecodeError, match="version 9") as error:
        decode(bytes(data))
    assert error.value.reason == "version"


def test_a_frame_of_another_sensor_is_refused():
    with pytest.raises(DecodeError, match="16 rings"):
        codec.decode(payload(), 1, 0, True, ELEVATIONS_RAD[:8])
