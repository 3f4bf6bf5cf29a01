"""The short drive of these tests: half a second still, then off, and the head turns at more than 100 deg/s."""

from __future__ import annotations

from dataclasses import replace

from splitslam.sim import DEMO
from splitslam.sim.spec import HeadTurn, Perturbations

SHORT = replace(
    DEMO,
    name="short",
    duration_s=3.0,
    path=replace(DEMO.path, stand_s=0.5, accel_s=0.8, head_turns=(HeadTurn(1.9, 70.0, 2.0),)),
    perturbations=Perturbations(),
)
