"""The made drive of the chaos runs, and what both pipelines make of it when nobody disturbs them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from splitslam.chaos.agent import Drive
from splitslam.sim import DEMO, simulate
from splitslam.stack.reel import record
from tests.chaos.field import Material
from tests.chaos.invariants import Undisturbed


def make(folder: Path, seconds: float) -> Material:
    """The demo's drive, cut short or with a further lap."""
    made = simulate(replace(DEMO, duration_s=seconds), folder)
    drive = Drive(made.bag_path, made.robot_path, made.truth_path)
    return Material(drive, Undisturbed.of(record(drive.recording, drive.robot), drive.truth))
