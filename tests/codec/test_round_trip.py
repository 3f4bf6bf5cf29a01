from __future__ import annotations

import hashlib
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splitslam import codec
from splitslam.features import FeatureFrame, FeatureSet
from tests.codec.frames import COLUMNS, ELEVATIONS_RAD, feature_set, made_frame, motion
from tests.tolerances import CODEC_TIME_NS


def assert_same_features(sent: FeatureSet, got: FeatureSet, step_m: float) -> None:
    np.testing.assert_array_equal(got.ring, sent.ring)
    np.testing.assert_array_equal(got.column, sent.column)
    assert got.points_lidar.dtype == np.float32
    if len(sent):
        error = np.linalg.norm(got.points_lidar.astype(np.float64) - sent.points_lidar, axis=1)
        assert error.max() <= np.sqrt(3) * step_m / 2 + 1e-4  # half a step along each of three axes
        assert np.abs(got.t_offset_ns.astype(np.int64) - sent.t_offset_ns).max() <= CODEC_TIME_NS
        assert np.abs(got.intensity.astype(int) - sent.intensity).max() <= 9


def assert_same_frame(sent: FeatureFrame, got: FeatureFrame, step_m: float = 0.01) -> None:
    assert (got.seq, got.stamp_ns, got.dense) == (sent.seq, sent.stamp_ns, sent.dense)
    assert_same_features(sent.corners, got.corners, step_m)
    assert_same_features(sent.surfs, got.surfs, step_m)
    a, b = sent.motion, got.motion
    np.testing.assert_array_equal(b.knots.offsets_ns, a.knots.offsets_ns)
    np.testing.assert_array_equal(b.knots.rotation, a.knots.rotation)
    np.testing.assert_array_equal(b.knots.translation_m, a.knots.translation_m)
    np.testing.assert_allclose(b.T_prev_lidar, a.T_prev_lidar, atol=1e-6)
    np.testing.assert_allclose(np.diag(b.covariance), np.diag(a.covariance), rtol=2e-3)
    np.testing.assert_allclose(b.velocity_lidar_mps, a.velocity_lidar_mps, atol=1e-6)
    np.testing.assert_allclose(b.gravity_lidar, a.gravity_lidar, atol=1e-6)
    assert b.gravity_sigma_rad == pytest.approx(a.gravity_sigma_rad, rel=1e-3)
    assert b.velocity_known == a.velocity_known


def round_trip(frame: FeatureFrame, step_m: float = 0.01) -> FeatureFrame:
    payload = codec.encode(frame, ELEVATIONS_RAD, COLUMNS, step_m)
    return codec.decode(payload, frame.seq, frame.stamp_ns, frame.dense, ELEVATIONS_RAD)


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    corners=st.integers(0, 60),
    surfs=st.integers(0, 200),
    clockwise=st.booleans(),
    spread_m=st.sampled_from([0.0, 0.05, 3.0]),
    step_m=st.sampled_from([0.001, 0.005, 0.01, 0.03]),
    rate_hz=st.sampled_from([10, 100, 200, 500]),
    velocity_known=st.booleans(),
)
def test_any_frame_comes_back_within_half_a_step(
    seed: int,
    corners: int,
    surfs: int,
    clockwise: bool,
    spread_m: float,
    step_m: float,
    rate_hz: float,
    velocity_known: bool,
):
    rng = np.random.default_rng(seed)
    frame = FeatureFrame(
        seed + 1,
        seed * 10**9,
        clockwise,
        replace(motion(rate_hz), velocity_known=velocity_known),
        feature_set(rng, corners, clockwise, spread_m),
        feature_set(rng, surfs, clockwise, spread_m),
    )
    assert_same_frame(frame, round_trip(frame, step_m), step_m)


def test_times_that_do_not_follow_the_columns_come_back_all_the_same():
    """Not a spinning sensor, or a scan of more than one turn: it costs bytes, never correctness."""
    frame = made_frame()
    rng = np.random.default_rng(1)
    surfs = replace(frame.surfs, t_offset_ns=rng.integers(0, 100_000_000, len(frame.surfs)).astype(np.int32))
    frame = replace(frame, surfs=surfs)
    assert_same_frame(frame, round_trip(frame))


def test_a_point_far_off_its_beam_comes_back():
    frame = made_frame()
    points = frame.surfs.points_lidar.copy()
    points[::50] = -points[::50]
    points[7] = (0, 0, 0)
    points[9] = (5000, -70, 3)
    frame = replace(frame, surfs=replace(frame.surfs, points_lidar=points))
    assert_same_frame(frame, round_trip(frame))


def test_encoding_a_decoded_frame_again_moves_no_point_by_more_than_a_step():
    once = round_trip(made_frame())
    assert_same_frame(once, round_trip(once))


def test_the_same_frame_gives_the_same_bytes_in_any_process():
    here = codec.encode(made_frame(), ELEVATIONS_RAD, COLUMNS)
    assert codec.encode(made_frame(), ELEVATIONS_RAD, COLUMNS) == here
    program = (
        "import hashlib; from splitslam import codec; from tests.codec.frames import *; "
        "print(hashlib.sha256(codec.encode(made_frame(), ELEVATIONS_RAD, COLUMNS)).hexdigest())"
    )
    there = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True).stdout
    assert there.strip() == hashlib.sha256(here).hexdigest()


def test_the_step_is_a_trade_of_bytes_for_error():
    sizes = [len(codec.encode(made_frame(), ELEVATIONS_RAD, COLUMNS, step)) for step in (0.001, 0.01, 0.1)]
    assert sizes[0] > sizes[1] > sizes[2]


def broken(**fields: np.ndarray) -> FeatureFrame:
    frame = made_frame()
    return replace(frame, surfs=replace(frame.surfs, **fields))


@pytest.mark.parametrize(
    ("frame", "text"),
    [
        (broken(ring=made_frame().surfs.ring[::-1].copy()), "not sorted"),
        (broken(ring=made_frame().surfs.ring + np.uint8(1)), "outside"),
        (broken(column=made_frame().surfs.column // 4 * 4 + 1700), "sorted|outside"),
        (broken(points_lidar=np.full_like(made_frame().surfs.points_lidar, np.nan)), "finite"),
        (broken(points_lidar=np.full_like(made_frame().surfs.points_lidar, 1e6)), "too far"),
    ],
)
def test_a_frame_that_breaks_the_contract_is_the_callers_error(frame: FeatureFrame, text: str):
    with pytest.raises(ValueError, match=text):
        codec.encode(frame, ELEVATIONS_RAD, COLUMNS)
