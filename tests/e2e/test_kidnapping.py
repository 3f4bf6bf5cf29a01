"""A made drive: the sensor is put 5 m back, unfelt by the IMU and blind for one scan. Through both pipelines."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from map_service.types import State
from splitslam import se3
from splitslam.sim import simulate
from splitslam.sim.drives import DRIVES
from splitslam.sim.spec import Perturbations
from splitslam.tum import read_tum
from tests import tolerances as bars
from tests.e2e.replay import Replayed, replay

AT_S = 8.05
KIDNAP_M = 5.0
UNTRUSTED = (State.DEGENERATE, State.LOCALISING, State.LOST)


@pytest.fixture(scope="module", params=["street", "campus"])
def kidnapped(request, tmp_path_factory) -> tuple[Path, Replayed]:
    faults = Perturbations(kidnap_m=KIDNAP_M, kidnap_at_s=(AT_S,))
    spec = replace(DRIVES[request.param], duration_s=AT_S + 3.0, perturbations=faults)
    bag = simulate(spec, tmp_path_factory.mktemp(request.param)).bag_path
    return bag, replay(bag, disable=("loops", "gnss"))


def errors_m(bag: Path, result: Replayed) -> np.ndarray:
    """Online positions against the truth, from the first pose on."""
    truth, stamps_ns = read_tum(bag.with_suffix(".tum")), np.array(result.stamps_ns)
    rows = np.searchsorted(truth.stamps_ns, stamps_ns - 1_000_000)
    T_true = [se3.from_quat(truth.positions_m[i], truth.quats_xyzw[i]) for i in rows]
    T_true_map = T_true[0] @ se3.inv(result.T_map_lidar[0])
    pairs = zip(T_true, result.T_map_lidar, strict=True)
    return np.array([np.linalg.norm((T_true_map @ T)[:3, 3] - G[:3, 3]) for G, T in pairs])


def test_it_is_lost_within_a_second_and_never_confidently_wrong(kidnapped):
    bag, result = kidnapped
    after_s = (np.array(result.stamps_ns) - result.stamps_ns[0]) * 1e-9 - AT_S
    states, wrong = np.array(result.states), errors_m(bag, result) > bars.KIDNAP_FOUND_M
    assert State.LOST not in states[after_s < 0]
    assert State.LOST in states[(after_s > 0) & (after_s < 1.0)]
    assert wrong.any()
    for i in np.flatnonzero(wrong):
        assert states[i] in UNTRUSTED
        assert np.sqrt(np.linalg.eigvalsh(result.covariances[i][3:, 3:])[-1]) > 0.5 * KIDNAP_M


def test_it_is_found_again_and_odom_has_not_noticed(kidnapped):
    bag, result = kidnapped
    assert result.states[-1] is State.TRACKING
    assert errors_m(bag, result)[-1] < bars.KIDNAP_FOUND_M
    assert result.pipeline.statistics()["corrections"]["relocalise"] == 1  # type: ignore[union-attr]
    assert result.jumps["odom_max_m"] < bars.ODOM_STEP_M
    assert result.jumps["odom_max_deg"] < bars.ODOM_STEP_DEG
