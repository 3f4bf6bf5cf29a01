"""A made world with a robot in it: recordings with an exact truth, for the demo and the accuracy tables."""

from splitslam.sim.drives import DRIVES
from splitslam.sim.faults import ALL_MIDDLE, SWEEP
from splitslam.sim.recorder import SimRecording, simulate
from splitslam.sim.spec import DEMO, DriveSpec

__all__ = ["ALL_MIDDLE", "DEMO", "DRIVES", "SWEEP", "DriveSpec", "SimRecording", "simulate"]
