"""Wheels in a tunnel without anything to see along it: a made drive through both pipelines, with them and without."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from map_service.types import State
from splitslam.sim import simulate
from splitslam.sim.drives import DRIVES
from splitslam.sim.spec import Perturbations, WheelSpec
from tests import tolerances as bars
from tests.e2e.replay import Replayed, replay

SECONDS = 30.0  # of which it is blind for 13


@pytest.fixture(scope="module")
def tunnel(tmp_path_factory) -> Path:
    """A bag with wheel odometry, 1 % off, that slips by 30 % of the speed for 1.5 s in every 10 s."""
    spec = replace(
        DRIVES["corridor"],
        duration_s=SECONDS,
        wheels=WheelSpec(),
        perturbations=Perturbations(wheel_slip=0.3),
    )
    return simulate(spec, tmp_path_factory.mktemp("tunnel")).bag_path


def blind_scans(result: Replayed) -> int:
    return sum(state is State.DEGENERATE for state in result.states)


def test_in_a_tunnel_the_wheels_carry_the_pose_although_they_slip(tunnel):
    truth = tunnel.with_suffix(".tum")
    aided, alone = (replay(tunnel, disable=("loops", *off)) for off in ((), ("wheels",)))
    assert min(blind_scans(aided), blind_scans(alone)) > 80
    error_m = aided.evaluation(truth).end_m
    assert error_m < 0.5 * alone.evaluation(truth).end_m
    path_m = float(np.linalg.norm(np.diff([T[:3, 3] for T in aided.T_map_lidar], axis=0), axis=1).sum())
    assert error_m < bars.TUNNEL_DRIFT_SHARE * path_m
    wheels, unaided = aided.outcome.node.wheels_report, alone.outcome.node.wheels_report
    assert wheels is not None
    assert unaided is not None
    assert (wheels["factors"] or 0) > 200
    assert 25 <= (wheels["slips"] or 0) <= 55  # 4.5 s slip, of which the first tenth of a second may pass
    assert aided.jumps["odom_max_m"] < bars.ODOM_STEP_M
    assert unaided["factors"] == 0
