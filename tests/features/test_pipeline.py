from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from edge_agent.dense import DensePolicy
from edge_agent.settings import DenseSettings
from splitslam import codec, se3
from splitslam.errors import DataError
from splitslam.features import Motion
from splitslam.scan import Scan, ScanPacket
from tests.deskew.motions import far_points
from tests.features.made_scan import ELEVATIONS_RAD, KnownMotion, made_scan, make_pipeline
from tests.tolerances import CODEC_DENSE_VLP16_BITS


def first(scan: Scan, n: int) -> Scan:
    return replace(
        scan,
        points_lidar=scan.points_lidar[:n],
        t_offset_ns=scan.t_offset_ns[:n],
        ring=scan.ring[:n],
        intensity=scan.intensity[:n],
    )


def test_a_scan_becomes_a_frame_that_the_service_can_decode():
    pipeline = make_pipeline(KnownMotion())
    frame = pipeline.process(ScanPacket(made_scan()))
    decoded = codec.decode(frame.payload, frame.seq, frame.stamp_ns, frame.dense, ELEVATIONS_RAD)
    assert (decoded.seq, decoded.dense) == (1, True)
    assert (len(decoded.corners), len(decoded.surfs)) == (frame.corners, frame.surfs)
    assert len(decoded.surfs) > 2000
    assert {"deskew", "features", "encode", "total"} <= frame.stage_cpu_ms.keys()
    assert frame.stage_wall_ms["total"] >= frame.stage_wall_ms["encode"] > 0


def test_dense_frames_of_a_room_take_at_most_16_bits_a_point():
    pipeline = make_pipeline(KnownMotion())
    frame = pipeline.process(ScanPacket(made_scan()))
    assert frame.dense
    assert 8 * len(frame.payload) / (frame.corners + frame.surfs) <= CODEC_DENSE_VLP16_BITS


def test_the_decoded_points_are_the_deskewed_ones_and_off_sends_them_as_seen():
    """The negative control: with the deskew off the room comes out bent."""
    off_plane = {}
    for name in ("cpu", "reference", "off"):
        moving = KnownMotion(turn_radps=2.3)
        scan = made_scan()
        # skew the scan by the inverse motion, so that the deskew must give the room back
        knots = moving.motion_over(scan.stamp_ns, scan.end_ns).knots
        poses = [se3.compose(se3.so3_exp(w), t) for w, t in zip(knots.rotation, knots.translation_m, strict=True)]
        nearest = np.clip(np.searchsorted(knots.offsets_ns, scan.t_offset_ns), 0, len(poses) - 1)
        inverse = np.stack([se3.inv(T) for T in poses])[nearest]
        seen = np.einsum("nij,nj->ni", inverse[:, :3, :3], scan.points_lidar) + inverse[:, :3, 3]
        pipeline = make_pipeline(moving, deskew=name)
        frame = pipeline.process(ScanPacket(replace(scan, points_lidar=seen.astype(np.float32))))
        p = codec.decode(frame.payload, 1, 0, True, ELEVATIONS_RAD).surfs.points_lidar
        planes = np.stack([12 - p[:, 0], p[:, 0] + 9, 7 - p[:, 1], p[:, 1] + 14, p[:, 2] + 1.5, 6 - p[:, 2]])
        off_plane[name] = float(np.median(np.abs(planes).min(axis=0)))
    assert off_plane["cpu"] < 0.03  # range noise is 2 cm
    assert abs(off_plane["cpu"] - off_plane["reference"]) < 0.002
    assert off_plane["off"] > 5 * off_plane["cpu"]


def test_bad_scans_are_dropped_before_they_reach_the_imu_node_and_use_no_seq():
    imu = KnownMotion()
    pipeline = make_pipeline(imu)
    for n, reason in ((0, "empty"), (99, "few_points")):
        with pytest.raises(DataError) as error:
            pipeline.process(ScanPacket(first(made_scan(), n)))
        assert error.value.reason == reason
    assert imu.asked == 0
    assert pipeline.process(ScanPacket(made_scan())).seq == 1


@pytest.mark.parametrize("part", ["knots", "T_prev_lidar"])
@pytest.mark.parametrize("translation_m", [np.nan, 1e9])
def test_a_motion_beyond_all_bounds_costs_its_scan_and_nothing_else(translation_m: float, part: str):
    imu = KnownMotion()
    pipeline = make_pipeline(imu)
    usual = imu.motion_over

    def lost(start_ns: int, end_ns: int) -> Motion:
        motion = usual(start_ns, end_ns)
        knots = replace(motion.knots, translation_m=np.full_like(motion.knots.translation_m, translation_m))
        far = se3.compose(np.eye(3), np.full(3, translation_m))
        return replace(motion, **({"knots": knots} if part == "knots" else {"T_prev_lidar": far}))

    imu.motion_over = lost
    with pytest.raises(DataError) as error:
        pipeline.process(ScanPacket(made_scan()))
    assert error.value.reason == "motion"
    imu.motion_over = usual
    assert pipeline.process(ScanPacket(made_scan(1))).seq == 1


def test_points_that_fall_out_of_the_image_are_counted():
    scan = made_scan()
    ring = scan.ring.copy()
    ring[:50] = 16
    pipeline = make_pipeline(KnownMotion())
    pipeline.process(ScanPacket(replace(scan, ring=ring)))
    assert pipeline.dropped_points["ring"] == 50
    assert pipeline.dropped_points["duplicate"] > 0


def test_the_same_scans_give_the_same_bytes():
    runs = []
    for _ in range(2):
        pipeline = make_pipeline(KnownMotion())
        runs.append([pipeline.process(ScanPacket(made_scan(seed))).payload for seed in (0, 1, 2, 3)])
    assert runs[0] == runs[1]


def test_a_frame_does_not_depend_on_the_frames_before_it():
    """Buffers are reused: nothing of the last scan may be left in them."""
    fresh = make_pipeline(KnownMotion()).process(ScanPacket(made_scan(1)))
    used = make_pipeline(KnownMotion())
    used.process(ScanPacket(made_scan(0)))
    used.process(ScanPacket(first(made_scan(2), 5000)))
    assert used.process(ScanPacket(made_scan(1))).payload == fresh.payload


def test_a_full_128_by_2048_image_goes_through():
    elevations = np.radians(np.linspace(-22.5, 22.5, 128)).astype(np.float32)
    scan = made_scan(elevations_rad=elevations, firings=1808)
    pipeline = make_pipeline(KnownMotion(), elevations, columns=2048)
    frame = pipeline.process(ScanPacket(scan))
    assert len(codec.decode(frame.payload, 1, 0, True, elevations).surfs) > 10_000


def test_points_in_any_order_and_direction_are_handled():
    """Not a spinning sensor at all: the codec gets larger, never wrong."""
    points, t = far_points(20_000, 20.0)
    scan = Scan(0, 100_000_000, points, t, (np.arange(20_000) % 16).astype(np.uint8), np.zeros(20_000, np.uint8))
    frame = make_pipeline(KnownMotion()).process(ScanPacket(scan))
    decoded = codec.decode(frame.payload, 1, 0, True, ELEVATIONS_RAD)
    assert len(decoded.surfs) + len(decoded.corners) == frame.corners + frame.surfs


def steps(policy: DensePolicy, T: np.ndarray, n: int) -> list[bool]:
    return [policy.decide(T) for _ in range(n)]


def test_frames_are_dense_at_first_and_then_each_metre_or_fifth_of_a_radian():
    forward, turn = np.eye(4), se3.compose(se3.so3_exp(np.array([0, 0, 0.0501])), np.zeros(3))
    forward[0, 3] = 0.251
    policy = DensePolicy(DenseSettings(first_frames=2))
    assert steps(policy, np.eye(4), 10) == [True, True] + [False] * 8
    assert steps(policy, forward, 8) == [False, False, False, True] * 2
    assert steps(policy, turn, 8) == [False, False, False, True] * 2


def test_a_dense_frame_that_the_service_asks_for_is_the_next_one():
    policy = DensePolicy(DenseSettings(first_frames=1))
    assert steps(policy, np.eye(4), 2) == [True, False]
    policy.wanted = True
    assert steps(policy, np.eye(4), 2) == [True, False]


def test_a_robot_that_does_not_know_where_down_is_sends_more_points():
    class Blind(KnownMotion):
        def motion_over(self, start_ns: int, end_ns: int):
            return replace(super().motion_over(start_ns, end_ns), gravity_sigma_rad=0.5)

    sizes = []
    for motion in (KnownMotion(), Blind()):
        pipeline = make_pipeline(motion)
        pipeline.dense = DensePolicy(DenseSettings(distance_m=1e3, angle_rad=1e3))
        frames = [pipeline.process(ScanPacket(made_scan(seed))) for seed in range(5)]
        assert not frames[-1].dense
        sizes.append(frames[-1].corners + frames[-1].surfs)
    assert sizes[1] > 1.5 * sizes[0]


def test_at_a_tight_budget_frames_carry_the_motion_alone_and_then_enough_points_to_register():
    imu = KnownMotion(turn_radps=0.0, speed_mps=1.0)
    pipeline = make_pipeline(imu)
    pipeline.rate.limit_kbps = 60
    frames = []
    for k in range(60):
        scan = made_scan(k % 3)
        moved = replace(scan, stamp_ns=scan.stamp_ns + k * 100_000_000, end_ns=scan.end_ns + k * 100_000_000)
        frame = pipeline.process(ScanPacket(moved))
        frames.append(codec.decode(frame.payload, frame.seq, frame.stamp_ns, frame.dense, ELEVATIONS_RAD))
        points = frame.corners + frame.surfs
        assert points == 0 or points >= pipeline.rate.settings.fewest_points
        if points == 0:
            assert not frame.dense
            assert len(frame.payload) < 80
    sent = np.array([len(f.corners) + len(f.surfs) for f in frames])
    alone = np.flatnonzero(sent == 0)
    assert 20 < len(alone) < 50
    np.testing.assert_allclose(frames[alone[0]].motion.T_prev_lidar, se3.exp(0.1 * imu.twist), atol=2e-4)
