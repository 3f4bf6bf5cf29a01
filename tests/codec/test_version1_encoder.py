"""Frames for services of 0.1.0: what the encoder of version 1 writes is what its decoder has always read."""

from __future__ import annotations

import numpy as np
import pytest

from splitslam import codec
from splitslam.codec import DecodeError, _version1_encoder_kernels, _version1_kernels, version1, version1_encoder
from splitslam.codec.beams import directions_of, table_of
from tests import tolerances as bars
from tests.codec.frames import COLUMNS, ELEVATIONS_RAD, feature_set, made_frame, motion
from tests.codec.mutations import decode
from tests.codec.test_version1 import PAYLOAD, sent


def test_the_frame_is_that_of_the_release_that_wrote_version_1() -> None:
    """Not to the byte: the columns' rate is a fit, and is fitted better today."""
    now = decode(version1_encoder.encode(sent(), ELEVATIONS_RAD, COLUMNS))
    then = decode(PAYLOAD)
    for a, b in ((now.corners, then.corners), (now.surfs, then.surfs)):
        np.testing.assert_array_equal(a.column, b.column)
        np.testing.assert_allclose(a.points_lidar, b.points_lidar, atol=5e-4)
    np.testing.assert_allclose(now.motion.knots.rotation, then.motion.knots.rotation, atol=1e-5)  # two steps


def naive_split(values: list[int], signed: bool) -> tuple[list[int], list[int]]:
    """(symbols, raw bits): the exponent with three bits of mantissa, and what is below them."""
    symbols, bits = [], []
    for value in values:
        u = (2 * value if value >= 0 else -2 * value - 1) if signed else value
        if u < 64:
            symbols.append(u)
            continue
        low = u.bit_length() - 4
        symbols.append(64 + 8 * (u.bit_length() - 7) + (u >> low) - 8)
        bits += [u >> k & 1 for k in range(low)]
    return symbols, bits


@pytest.mark.parametrize("signed", [False, True])
def test_values_split_as_written_down_and_join_again(signed: bool) -> None:
    rng = np.random.default_rng(2)
    values = np.concatenate([np.arange(200), rng.integers(0, 1 << 28, 50)]) * (
        rng.choice([-1, 1], 250) if signed else 1
    )
    symbols, raw = np.empty(250, np.uint8), np.zeros(2000, np.uint8)
    end = _version1_encoder_kernels.split(values, signed, symbols, raw, 0)
    expected, bits = naive_split(values.tolist(), signed)
    assert symbols.tolist() == expected
    assert np.unpackbits(raw, bitorder="little")[:end].tolist() == bits
    again = np.empty(250, np.int64)
    assert _version1_kernels.join(symbols, signed, raw, 0, again) == end
    np.testing.assert_array_equal(again, values)
    assert _version1_encoder_kernels.split(np.array([1 << 31]), signed, symbols, raw, 0) == -1


def test_residuals_and_points_are_each_others_inverse_and_what_is_not_finite_is_told() -> None:
    features = feature_set(np.random.default_rng(3), 40)
    table, directions = table_of(motion().knots, 400_000), directions_of(COLUMNS, ELEVATIONS_RAD, 10_000)
    residuals = np.empty((_version1_encoder_kernels.ROWS, 40), np.int32)
    seen = (features.points_lidar, features.ring, features.column, features.t_offset_ns)
    assert _version1_encoder_kernels.to_residuals(*seen, 14_000_000, table, directions, residuals)
    points, column, times = np.empty((40, 3), np.float32), np.empty(40, np.uint16), np.empty(40, np.int32)
    assert _version1_kernels.from_residuals(
        residuals, features.ring, 14_000_000, table, directions, points, column, times
    )
    np.testing.assert_array_equal(column, features.column)
    assert np.abs(times.astype(np.int64) - features.t_offset_ns).max() <= bars.CODEC_TIME_NS
    assert np.linalg.norm(points - features.points_lidar, axis=1).max() <= np.sqrt(3) * 0.005 + 1e-4
    features.points_lidar[7, 1] = np.nan
    assert not _version1_encoder_kernels.to_residuals(*seen, 14_000_000, table, directions, residuals)


@pytest.mark.parametrize("dense", [True, False])
def test_a_frame_of_today_is_the_same_frame_for_a_service_of_before(dense: bool) -> None:
    frame = made_frame(4, dense=dense)
    payload = codec.encode(frame, ELEVATIONS_RAD, COLUMNS)
    again = codec.recode(payload, 1, ELEVATIONS_RAD, COLUMNS)
    assert again[0] == version1.VERSION
    arguments = (frame.seq, frame.stamp_ns, dense, ELEVATIONS_RAD)
    new, old = codec.decode(payload, *arguments), version1.decode(again, *arguments)
    for a, b in ((new.corners, old.corners), (new.surfs, old.surfs)):
        np.testing.assert_array_equal(a.ring, b.ring)
        np.testing.assert_array_equal(a.column, b.column)
        np.testing.assert_array_equal(a.intensity, b.intensity)
        assert np.linalg.norm(a.points_lidar - b.points_lidar, axis=1).max() <= bars.RECODED_M
        assert np.abs(a.t_offset_ns.astype(np.int64) - b.t_offset_ns).max() <= bars.CODEC_TIME_NS
    np.testing.assert_allclose(old.motion.T_prev_lidar, new.motion.T_prev_lidar, atol=1e-6)
    np.testing.assert_allclose(old.motion.covariance, new.motion.covariance, rtol=2e-3)


def test_no_other_version_is_written_and_nothing_is_made_of_rubbish() -> None:
    payload = codec.encode(made_frame(), ELEVATIONS_RAD, COLUMNS)
    with pytest.raises(DecodeError, match="version 0 is not written"):
        codec.recode(payload, 0, ELEVATIONS_RAD, COLUMNS)
    with pytest.raises(DecodeError, match="checksum"):
        codec.recode(payload[:-1], 1, ELEVATIONS_RAD, COLUMNS)
