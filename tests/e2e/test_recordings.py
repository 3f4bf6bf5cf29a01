"""The bars of the recordings, through the product's own commands."""

from __future__ import annotations

import hashlib

import pytest

from tests import tolerances as bars
from tests.e2e.commands import Run, run


def sent_all_mapped_all(result: Run) -> None:
    scans = result.report["scans"]
    assert scans["dropped"] == 0
    assert scans["mapped"] >= scans["read"] - 1
    assert scans["sent"] == scans["mapped"]


def digests(result: Run) -> dict[str, str]:
    names = ("trajectory.tum", "online.tum", "odom.tum", "imu.tum")
    return {name: hashlib.sha256((result.out / name).read_bytes()).hexdigest() for name in names}


def test_yard1_meets_every_bar_and_a_second_run_is_identical(yard1, yard1_as_it_is, tmp_path):
    first = yard1_as_it_is
    sent_all_mapped_all(first)
    truth = yard1.with_suffix(".tum")
    assert first.evaluation(truth)["ate_m"] <= bars.YARD1_ATE_M
    assert first.evaluation(truth, "online.tum")["ate_m"] <= bars.YARD1_ONLINE_ATE_M
    assert first.evaluation(truth, "imu.tum")["ate_m"] <= bars.YARD1_ONLINE_ATE_M
    assert first.report["loops"] >= 1
    assert first.report["gnss_factors"] >= 1
    assert first.evaluation(truth)["rpe_1s_m"] <= bars.YARD1_RPE_1S_M
    uplink = first.report["uplink"]
    assert uplink["kbps"] <= bars.YARD1_UPLINK_KBPS
    assert uplink["ratio_to_raw"] >= bars.YARD1_RATIO_TO_RAW
    assert uplink["native_kbps"] / uplink["kbps"] >= bars.YARD1_RATIO_TO_NATIVE
    assert first.report["path_m"] == pytest.approx(96, abs=2)

    second = run(tmp_path / "second", yard1)
    assert digests(second) == digests(first)
    assert second.report["uplink"]["payload_sha256"] == first.report["uplink"]["payload_sha256"]


def test_yard1_without_gnss_meets_the_same_bars(yard1, tmp_path):
    result = run(tmp_path / "out", yard1, "--disable", "gnss")
    sent_all_mapped_all(result)
    truth = yard1.with_suffix(".tum")
    assert result.evaluation(truth)["ate_m"] <= bars.YARD1_ATE_M
    assert result.evaluation(truth, "online.tum")["ate_m"] <= bars.YARD1_ONLINE_ATE_M
    assert result.report["gnss_factors"] == 0
    assert result.report["loops"] >= 1


@pytest.mark.parametrize("kbps", sorted(bars.YARD1_BUDGET_ATE_M))
def test_yard1_within_a_budget_maps_every_scan(yard1, tmp_path, kbps):
    result = run(tmp_path / "out", yard1, "--max-kbps", str(kbps), "--disable", "loops,gnss")
    sent_all_mapped_all(result)
    uplink = result.report["uplink"]
    assert bars.BUDGET_UNDER * kbps <= uplink["kbps"] <= bars.BUDGET_OVER * kbps
    assert uplink["withheld_points"] > 0
    truth = yard1.with_suffix(".tum")
    assert result.evaluation(truth)["ate_m"] <= bars.YARD1_BUDGET_ATE_M[kbps]


def test_without_deskew_yard1_is_clearly_worse(yard1, yard1_as_it_is, tmp_path):
    """The negative control: what deskewing is for. Two scans in three would not show it: the whole drive is run."""
    skewed = run(tmp_path / "off", yard1, "--deskew", "off")
    truth = yard1.with_suffix(".tum")
    assert skewed.evaluation(truth)["ate_m"] > bars.DESKEW_OFF_WORSE_RATIO * yard1_as_it_is.evaluation(truth)["ate_m"]


@pytest.mark.alone
def test_yard1_by_the_clock_drops_nothing_and_keeps_up(yard1, tmp_path):
    result = run(tmp_path / "out", yard1, "--realtime")
    sent_all_mapped_all(result)
    assert result.report["wall_s"] <= result.report["recording_s"] + bars.REALTIME_SLACK_S
    assert result.evaluation(yard1.with_suffix(".tum"))["ate_m"] <= bars.YARD1_ATE_M


def test_kitti_16_rings_from_a_moving_start_with_a_10_hz_imu(shared_data, tmp_path):
    recording = shared_data / "kitti_0005" / "kitti_0005_ring16.bag"
    result = run(tmp_path / "out", recording, "--disable", "gnss")
    sent_all_mapped_all(result)
    evaluation = result.evaluation(recording.with_name("kitti_0005.pseudo.tum"))
    assert evaluation["ate_m"] <= bars.KITTI_RING16_ATE_M
    assert evaluation["rpe_1s_m"] <= bars.KITTI_RING16_RPE_1S_M
    assert result.report["uplink"]["kbps"] <= bars.KITTI_RING16_UPLINK_KBPS


def test_kitti_64_rings(shared_data, tmp_path):
    recording = shared_data / "kitti_0005" / "kitti_0005_ring64_4s.bag"
    result = run(tmp_path / "out", recording, "--disable", "gnss")
    sent_all_mapped_all(result)
    assert result.evaluation(recording.with_name("kitti_0005.pseudo.tum"))["ate_m"] <= bars.KITTI_RING64_ATE_M


@pytest.mark.parametrize("sensor", ["imu", "imu,gnss,loops"])
def test_kitti_without_an_imu(shared_data, tmp_path, sensor):
    recording = shared_data / "kitti_0005" / "kitti_0005_ring16.bag"
    result = run(tmp_path / "out", recording, "--disable", f"{sensor},gnss", "--max-scans", "60")
    sent_all_mapped_all(result)
    assert result.evaluation(recording.with_name("kitti_0005.pseudo.tum"))["ate_m"] <= bars.KITTI_RING16_ATE_M
