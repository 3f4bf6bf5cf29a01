"""Frames of version 1, as stores and older agents have them, still decode."""

from __future__ import annotations

import struct
import tracemalloc

import numpy as np
import pytest
import zstandard

from splitslam import codec
from splitslam.codec import DecodeError, version1
from splitslam.features import FeatureFrame
from tests.codec.frames import COLUMNS, ELEVATIONS_RAD, feature_set, motion
from tests.codec.mutations import MAX_BYTES, decode, sealed

# What version 1's encoder, at steps of 1 cm, made of sent().
PAYLOAD = bytes.fromhex(
    "01011000080703000c0000001027000000000000310000000ad7233c0ad7a3bccdcc4c3ee266033e9366bc3c338198bc6666"
    "a63fcdccccbd0ad7a33c000000009a99193fcdcc4cbf1914cb1518171f213e230049ae232a00000011000000110000001100"
    "000011000000110000001100000000002901000400000204000202040000000400020000629c00477f003877004b8c00146a"
    "00085e00004f0000610000030a0a0d0c0f1f0e120d1602000061000058615653585c603e5009485c00006100007971687e78"
    "757e737278746c0000610000414d1b4a5f4b5a524e41455a00006100001a2914444c2e4949004c1952000061000053645151"
    "6d6e59695c49546a7828c13640738244a65e07aaa09882ba3995534ec41860346c355e9b9189b85b4dfed2ed08747744592d"
    "f1f61c1f0609ae410cc4ab"
)


def sent() -> FeatureFrame:
    rng = np.random.default_rng(1)
    corners = feature_set(rng, 3)
    return FeatureFrame(7, 1_700_000_000_123_456_789, True, motion(10.0), corners, feature_set(rng, 9))


def test_a_frame_of_version_1_still_decodes():
    frame, got = sent(), decode(PAYLOAD)
    for a, b in ((frame.corners, got.corners), (frame.surfs, got.surfs)):
        np.testing.assert_array_equal(b.ring, a.ring)
        np.testing.assert_array_equal(b.column, a.column)
        assert np.linalg.norm(b.points_lidar - a.points_lidar, axis=1).max() <= np.sqrt(3) * 0.005 + 1e-4
        assert np.abs(b.t_offset_ns.astype(np.int64) - a.t_offset_ns).max() <= 50_000
        assert np.abs(b.intensity.astype(int) - a.intensity).max() <= 9
    np.testing.assert_array_equal(got.motion.knots.offsets_ns, frame.motion.knots.offsets_ns)
    np.testing.assert_allclose(got.motion.knots.rotation, frame.motion.knots.rotation, atol=6e-6)
    np.testing.assert_allclose(got.motion.T_prev_lidar, frame.motion.T_prev_lidar, atol=1e-6)
    np.testing.assert_allclose(got.motion.velocity_lidar_mps, [1.3, -0.1, 0.02], atol=1e-6)
    assert got.motion.velocity_known


def test_a_frame_of_version_1_may_be_written_again_in_version_2():
    got = decode(PAYLOAD)
    again = codec.decode(codec.encode(got, ELEVATIONS_RAD, COLUMNS), 7, got.stamp_ns, True, ELEVATIONS_RAD)
    np.testing.assert_array_equal(again.surfs.column, got.surfs.column)
    assert np.abs(again.surfs.points_lidar - got.surfs.points_lidar).max() < 0.02


@pytest.mark.parametrize("bomb", [False, True])
def test_a_plane_that_claims_or_holds_gigabytes_is_refused_in_little_memory(bomb: bool):
    fixed = version1._FIXED
    lengths = list(struct.unpack_from("<7I", PAYLOAD, fixed - 28))
    parameters = zstandard.ZstdCompressionParameters.from_level(
        3, format=zstandard.FORMAT_ZSTD1_MAGICLESS, write_content_size=True
    )
    plane = b"\xe0" + struct.pack("<Q", 1 << 40) + b"\x01\x00\x00"  # one segment, content size 1 TiB
    if bomb:
        plane = zstandard.ZstdCompressor(compression_params=parameters).compress(bytes(100_000_000))
    body = PAYLOAD[: fixed - 28] + struct.pack("<7I", len(plane), *lengths[1:])
    body += plane + PAYLOAD[fixed + lengths[0] : -4]
    tracemalloc.start()
    with pytest.raises(DecodeError):
        decode(sealed(body))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < MAX_BYTES
