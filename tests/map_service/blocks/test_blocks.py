"""Scans in blocks say what they said, as exactly as they are to, and in few bytes."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from map_service.block_decoding import decode_block
from map_service.block_encoding import encode_block, first_seen
from map_service.fidelity import FULL, thinned
from map_service.scans import NO_KEYFRAME, Scans
from splitslam import se3
from splitslam.errors import DataError
from tests import tolerances
from tests.map_service.blocks.made_scans import circling, furthest, scans_along

WITHIN_M, WITHIN_RAD = 1e-3, math.radians(0.05)
THIN = thinned(WITHIN_M, WITHIN_RAD)


def through(scans: Scans, fidelity=FULL) -> tuple[Scans, int]:
    """As they are read again, and the size of the block."""
    anchors = first_seen(scans)
    data, left_out = encode_block(scans, anchors, fidelity)
    read = decode_block(data, anchors)
    assert read.thinned.sum() == left_out
    return read, len(data)


def with_rejections(scans: Scans) -> Scans:
    """Scans 4 and 5 are missing, 7 was rejected."""
    kept = scans.part(~np.isin(scans.seq, [4, 5]))
    lost = kept.seq == 7
    return replace(
        kept,
        keyframe=np.where(lost, NO_KEYFRAME, kept.keyframe),
        state=np.where(lost, 0, kept.state),
        rejected=np.where(lost, "corrupt", ""),
    )


def test_at_full_rate_every_number_is_there_and_poses_are_exact_to_a_step() -> None:
    scans = with_rejections(scans_along(circling(256)))
    read, _ = through(scans)
    for name in ("seq", "stamp_ns", "state", "keyframe", "rejected"):
        np.testing.assert_array_equal(getattr(read, name), getattr(scans, name))
    there = scans.mapped
    for name, steps in (("T_keyframe_lidar", 1), ("T_map_lidar", 3), ("T_map_odom", 1)):
        away_m, turned_rad = furthest(getattr(read, name)[there], getattr(scans, name)[there])
        assert away_m <= steps * FULL.position_m
        assert turned_rad <= steps * FULL.rotation_rad
    assert not read.thinned.any()


@pytest.mark.parametrize("speed_mps", [0.0, 1.0])
def test_thinned_poses_are_within_their_bounds_of_what_was_stored_first(speed_mps: float) -> None:
    scans = scans_along(circling(1000, speed_mps))
    read, _ = through(through(scans)[0], THIN)
    np.testing.assert_array_equal(read.seq, scans.seq)
    np.testing.assert_array_equal(read.keyframe, scans.keyframe)
    kept = ~read.thinned
    assert (read.stamp_ns[kept] == scans.stamp_ns[kept]).all()
    assert np.abs(read.stamp_ns - scans.stamp_ns).max() < 2e6
    assert kept.mean() < 0.1
    # where the robot was at a scan's own time, by the poses that are told
    way = np.array([_at(read, stamp_ns) for stamp_ns in scans.stamp_ns])
    away_m, turned_rad = furthest(way, scans.T_map_lidar)
    assert 0.2 * WITHIN_M < away_m <= WITHIN_M + tolerances.STAMP_OF_THINNED_S * speed_mps
    assert turned_rad <= WITHIN_RAD


def _at(scans: Scans, stamp_ns: int) -> np.ndarray:
    """T_map_keyframe of then, by the answers; so what was held of the answers does not count."""
    i = min(int(np.searchsorted(scans.stamp_ns, stamp_ns, side="right")), len(scans) - 1)
    a, b = max(i - 1, 0), i
    span = scans.stamp_ns[b] - scans.stamp_ns[a]
    return se3.interpolate(scans.T_map_lidar[a], scans.T_map_lidar[b], (stamp_ns - scans.stamp_ns[a]) / span)


def test_a_scan_costs_a_few_bytes_and_one_of_a_parked_robot_next_to_nothing() -> None:
    driving, parked = scans_along(circling(256)), scans_along(circling(4096, 0.0), every=5000)
    assert through(driving)[1] < tolerances.BLOCK_BYTES_A_SCAN * 256
    still = replace(parked, stamp_ns=parked.stamp_ns[0] + 100_000_000 * np.arange(4096))
    assert through(still, thinned(0.005, WITHIN_RAD))[1] < tolerances.PARKED_BLOCK_BYTES


def test_a_correction_in_the_middle_of_a_block_moves_the_answers_and_not_the_way() -> None:
    scans = scans_along(circling(100))
    jump = se3.exp(np.array([0.0, 0.0, 0.01, 0.5, -0.2, 0.0]))
    answered = scans.T_map_lidar.copy()
    answered[55:] = jump @ answered[55:]
    scans = replace(scans, T_map_lidar=answered)
    read, size = through(scans)
    assert furthest(read.T_map_lidar, answered)[0] <= 3 * FULL.position_m
    assert furthest(read.T_keyframe_lidar, scans.T_keyframe_lidar)[0] <= FULL.position_m
    assert size < through(scans_along(circling(100)))[1] + 200


def test_covariances_are_held_within_their_share_and_never_of_negative_variance() -> None:
    rng = np.random.default_rng(1)
    A = rng.normal(size=(200, 6, 6)) * [1e-4, 1e-4, 1e-5, 1e-2, 1e-3, 1e-3]
    scans = scans_along(circling(200))
    factor = np.linalg.cholesky(A.transpose(0, 2, 1) @ A)
    factor[3] = np.nan
    read, _ = through(replace(scans, factor=factor))
    assert np.isnan(read.factor[3]).all()
    known = np.arange(200) != 3
    sigmas, found = (np.linalg.norm(f[known], axis=2) for f in (factor, read.factor))
    np.testing.assert_allclose(found, sigmas, rtol=FULL.sigma * 1.1)
    covariances = [f @ f.T for f in read.factor[known]]
    assert min(np.linalg.eigvalsh(c / np.sqrt(np.outer(np.diag(c), np.diag(c))))[0] for c in covariances) > -1e-12


def test_a_block_of_rejected_scans_has_their_reasons() -> None:
    scans = scans_along(circling(5))
    scans = replace(scans, keyframe=np.full(5, NO_KEYFRAME), rejected=np.array(["time", "corrupt", "é", "a b", "x"]))
    read, _ = through(scans)
    assert read.rejected.tolist() == ["time", "corrupt", "é", "a b", "x"]
    np.testing.assert_array_equal(read.stamp_ns, scans.stamp_ns)


def test_damage_is_one_line_whatever_the_bit() -> None:
    scans = with_rejections(scans_along(circling(40)))
    anchors = first_seen(scans)
    data = encode_block(scans, anchors, THIN)[0]
    for bit in range(8 * len(data)):
        damaged = bytearray(data)
        damaged[bit // 8] ^= 1 << bit % 8
        with pytest.raises(DataError, match="corrupt"):
            decode_block(bytes(damaged), anchors)
    for size in range(len(data)):
        with pytest.raises(DataError, match="corrupt"):
            decode_block(data[:size], anchors)
    with pytest.raises(DataError, match="keyframe 0 has no anchor"):
        decode_block(data, {})


def test_a_pose_that_is_nowhere_goes_into_no_block() -> None:
    scans = scans_along(circling(5))
    scans.T_map_lidar[2, 0, 3] = 1e11
    with pytest.raises(DataError, match="nowhere"):
        encode_block(scans, first_seen(scans), FULL)
