"""Payloads as they must not be: what tests and `make fuzz` feed the decoder."""

from __future__ import annotations

import argparse
import struct
import sys
import time
import tracemalloc
import zlib
from collections import Counter
from collections.abc import Iterator

import numpy as np

from splitslam import codec
from splitslam.codec import DecodeError
from splitslam.features import FeatureFrame
from tests.codec.frames import COLUMNS, ELEVATIONS_RAD, made_frame

MAX_BYTES = 16 << 20
MAX_SECONDS = 5.0
KINDS = ("bytes", "bits", "random", "cut", "inserted", "spliced")


def decode(data: bytes) -> FeatureFrame:
    return codec.decode(data, 1, 0, True, ELEVATIONS_RAD)


def sealed(body: bytes) -> bytes:
    """With the right checksum, so that the checks behind it are met."""
    return body + struct.pack("<I", zlib.crc32(body))


def payloads() -> list[bytes]:
    """Of both versions, from no points to a few hundred; the golden frame stands for version 1."""
    from tests.codec.test_version1 import PAYLOAD

    frames = [made_frame(1, 0, 0), made_frame(2, 1, 0), made_frame(3, 20, 100, dense=False), made_frame(4)]
    return [PAYLOAD, *(codec.encode(frame, ELEVATIONS_RAD, COLUMNS) for frame in frames)]


def mutated(payload: bytes, other: bytes, kind: str, rng: np.random.Generator) -> bytes:
    """A body without its checksum; the version stays one that is known."""
    body = bytearray(payload[:-4])
    at = int(rng.integers(1, len(body)))
    match kind:
        case "bytes":
            for _ in range(rng.integers(1, 4)):
                body[rng.integers(1, len(body))] = int(rng.integers(256))
        case "bits":
            # more often near the front, where what all points share is
            place = 1 + int((len(body) - 1) * rng.random() ** 3)
            body[min(place, len(body) - 1)] ^= 1 << int(rng.integers(8))
        case "random":
            body[1:] = rng.integers(0, 256, rng.integers(0, 3000)).astype(np.uint8).tobytes()
        case "cut":
            del body[at:]
        case "inserted":
            body[at:at] = rng.integers(0, 256, rng.integers(1, 50)).astype(np.uint8).tobytes()
        case "spliced":
            body[at:] = other[int(rng.integers(1, len(other))) : -4]
    return bytes(body)


def check(frame: FeatureFrame, data: bytes) -> None:
    """What holds of every frame that is not refused."""
    assert np.isfinite(frame.corners.points_lidar).all(), data.hex()
    assert np.isfinite(frame.surfs.points_lidar).all(), data.hex()
    assert np.isfinite(frame.motion.T_prev_lidar).all(), data.hex()
    assert np.all(np.diff(frame.motion.knots.offsets_ns) > 0), data.hex()
    assert len(frame.surfs) == 0 or frame.surfs.ring.max() < len(ELEVATIONS_RAD), data.hex()
    assert len(frame.surfs) + len(frame.corners) <= codec.MAX_POINTS, data.hex()


def outcomes(count: int, seed: int) -> Iterator[tuple[str, bytes, bool]]:
    """(kind, what was decoded, refused) of `count` payloads; AssertionError for an answer that is neither."""
    rng, whole = np.random.default_rng(seed), payloads()
    for n in range(count):
        kind, (a, b) = KINDS[n % len(KINDS)], rng.integers(len(whole), size=2)
        data = sealed(mutated(whole[a], whole[b], kind, rng))
        before = time.perf_counter()
        try:
            frame = decode(data)
        except DecodeError:
            refused = True
        else:
            refused = False
            check(frame, data)
        assert time.perf_counter() - before < MAX_SECONDS, data.hex()
        yield kind, data, refused


def main() -> None:
    parser = argparse.ArgumentParser(description="mutated codec payloads: the decoder must answer each")
    parser.add_argument("--count", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    for payload in payloads():
        decode(payload)  # compiles
    seen: Counter[tuple[str, bool]] = Counter()
    peak, started = 0, time.monotonic()
    for n, (kind, _, refused) in enumerate(outcomes(arguments.count, arguments.seed), 1):
        seen[kind, refused] += 1
        if n % 100_000 == 1:  # memory, now and then: tracing everything is ten times slower
            tracemalloc.start()
        if n % 100_000 == 1_000:
            peak = max(peak, tracemalloc.get_traced_memory()[1])
            tracemalloc.stop()
            print(f"{n} of {arguments.count}, {time.monotonic() - started:.0f} s", file=sys.stderr, flush=True)
    assert peak < MAX_BYTES, peak
    for kind in KINDS:
        print(f"{kind:9} refused {seen[kind, True]:7}, decoded {seen[kind, False]:7}")
    print(f"at most {peak / 2**20:.1f} MiB at a time, of the payloads that were traced")


if __name__ == "__main__":
    main()
