from __future__ import annotations

import hashlib
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splitslam import codec, se3
from splitslam.features import FeatureFrame, FeatureSet
from tests.codec.frames import COLUMNS, ELEVATIONS_RAD, feature_set, made_frame, motion
from tests.tolerances import CODEC_FIXED_BYTES, CODEC_MAX_M, CODEC_MEAN_M, CODEC_MOTION, CODEC_TIME_NS


def assert_same_features(sent: FeatureSet, got: FeatureSet, step_m: float, shades: bool) -> None:
    np.testing.assert_array_equal(got.ring, sent.ring)
    np.testing.assert_array_equal(got.column, sent.column)
    assert got.points_lidar.dtype == np.float32
    if len(sent):
        error = np.linalg.norm(got.points_lidar.astype(np.float64) - sent.points_lidar, axis=1)
        assert error.max() <= np.sqrt(3) * step_m / 2 + 1e-4  # half a step along each of three axes
        assert np.abs(got.t_offset_ns.astype(np.int64) - sent.t_offset_ns).max() <= CODEC_TIME_NS
        assert np.abs(got.intensity.astype(int) - (sent.intensity if shades else 0)).max() <= 9


def assert_same_frame(sent: FeatureFrame, got: FeatureFrame, step_m: float = codec.STEP_M) -> None:
    assert (got.seq, got.stamp_ns, got.dense) == (sent.seq, sent.stamp_ns, sent.dense)
    assert_same_features(sent.corners, got.corners, step_m, sent.dense)
    assert_same_features(sent.surfs, got.surfs, step_m, sent.dense)
    a, b = sent.motion, got.motion
    np.testing.assert_array_equal(b.knots.offsets_ns, a.knots.offsets_ns)
    np.testing.assert_array_equal(b.knots.rotation, a.knots.rotation)
    np.testing.assert_array_equal(b.knots.translation_m, a.knots.translation_m)
    moved = np.abs(se3.log(se3.inv(a.T_prev_lidar) @ b.T_prev_lidar))
    assert moved[:3].max() <= CODEC_MOTION["rotation_rad"]
    assert moved[3:].max() <= CODEC_MOTION["translation_m"]
    sigmas = np.append(np.sqrt(np.diag(b.covariance)), b.gravity_sigma_rad)
    sent_sigmas = np.append(np.sqrt(np.diag(a.covariance)), a.gravity_sigma_rad)
    np.testing.assert_allclose(sigmas, sent_sigmas, rtol=CODEC_MOTION["sigma"])
    np.testing.assert_allclose(b.velocity_lidar_mps, a.velocity_lidar_mps, atol=CODEC_MOTION["velocity_mps"])
    np.testing.assert_allclose(b.gravity_lidar, a.gravity_lidar, atol=CODEC_MOTION["gravity_rad"])
    assert b.velocity_known == a.velocity_known


def round_trip(frame: FeatureFrame, step_m: float = codec.STEP_M) -> FeatureFrame:
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
    sizes = [len(codec.encode(made_frame(), ELEVATIONS_RAD, COLUMNS, step)) for step in (0.001, 0.02, 0.1)]
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


@pytest.mark.parametrize(("corners", "surfs"), [(0, 0), (1, 0), (0, 1), (1, 1)])
@pytest.mark.parametrize("dense", [True, False])
def test_a_frame_of_hardly_a_point_comes_back_in_hardly_a_byte(corners: int, surfs: int, dense: bool):
    frame = made_frame(3, corners, surfs, dense)
    assert_same_frame(frame, round_trip(frame))
    assert len(codec.encode(frame, ELEVATIONS_RAD, COLUMNS)) < CODEC_FIXED_BYTES


def test_every_cell_of_a_128_ring_image_comes_back():
    elevations, columns = np.radians(np.linspace(-22, 22, 128)).astype(np.float32), 1024
    ring, column = np.divmod(np.arange(128 * columns), columns)
    rng = np.random.default_rng(0)
    azimuth = (column - columns // 2) * 2 * np.pi / columns
    e = elevations[ring].astype(np.float64)
    d = np.stack([np.cos(e) * np.cos(azimuth), np.cos(e) * np.sin(azimuth), np.sin(e)], axis=1)
    surfs = FeatureSet(
        points_lidar=(d * (10 + 3 * np.sin(9 * azimuth) + rng.normal(0, 0.02, len(ring)))[:, None]).astype(np.float32),
        ring=ring.astype(np.uint8),
        column=column.astype(np.uint16),
        t_offset_ns=(column * 97_656).astype(np.int32),
        intensity=rng.integers(0, 256, len(ring)).astype(np.uint8),
    )
    frame = replace(made_frame(1, 0, 0), surfs=surfs)
    payload = codec.encode(frame, elevations, columns)
    got = codec.decode(payload, frame.seq, frame.stamp_ns, True, elevations)
    assert_same_features(surfs, got.surfs, codec.STEP_M, True)


def test_rings_may_be_empty_one_or_256_and_in_any_order_of_elevation():
    rng = np.random.default_rng(5)
    for rings, used in ((1, [0]), (256, [0, 3, 255]), (40, [39]), (6, [1, 4, 5])):
        elevations = rng.uniform(-1.4, 1.4, rings).astype(np.float32)
        ring = np.sort(rng.choice(used, 50))
        column = np.concatenate([np.sort(rng.choice(300, int(n), replace=False)) for n in np.bincount(ring) if n])
        points = rng.normal(0, 20, (50, 3)).astype(np.float32)  # nowhere near their beams
        surfs = FeatureSet(
            points,
            ring.astype(np.uint8),
            column.astype(np.uint16),
            rng.integers(0, 10**8, 50).astype(np.int32),
            np.zeros(50, np.uint8),
        )
        frame = replace(made_frame(1, 0, 0), surfs=surfs)
        got = codec.decode(codec.encode(frame, elevations, 300), frame.seq, frame.stamp_ns, True, elevations)
        assert_same_features(surfs, got.surfs, codec.STEP_M, True)


def test_the_error_is_a_centimetre_on_average_and_less_than_three_at_most():
    frame = made_frame(surfs=4000)
    error = np.linalg.norm(round_trip(frame).surfs.points_lidar - frame.surfs.points_lidar, axis=1)
    assert error.mean() <= CODEC_MEAN_M
    assert error.max() <= CODEC_MAX_M


@pytest.mark.parametrize("few", [2, 3, 10, 50])
def test_a_few_points_anywhere_and_at_any_time_of_the_scan_are_encoded(few: int):
    """Two neighbours across the place where a scan begins and ends say that the sensor turns absurdly fast."""
    for seed in range(60):
        rng = np.random.default_rng(seed)
        frame = made_frame(seed, corners=few // 2, surfs=few - few // 2, dense=False)
        if seed % 2:
            any_time = {
                name: replace(points, t_offset_ns=rng.integers(0, 100_000_000, len(points)).astype(np.int32))
                for name, points in (("corners", frame.corners), ("surfs", frame.surfs))
            }
            frame = replace(frame, **any_time)
        payload = codec.encode(frame, ELEVATIONS_RAD, COLUMNS)
        decoded = codec.decode(payload, 7, frame.stamp_ns, False, ELEVATIONS_RAD)
        for mine, theirs in ((decoded.corners, frame.corners), (decoded.surfs, frame.surfs)):
            assert np.abs(mine.t_offset_ns.astype(np.int64) - theirs.t_offset_ns).max(initial=0) <= 50_000
