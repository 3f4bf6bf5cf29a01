"""A made world with a robot in it: recordings with an exact truth, for the demo and the accuracy tables."""

from splitslam.sim.recorder import SimRecording, simulate
from splitslam.sim.spec import DEMO, DriveSpec

__all__ = ["DEMO", "DriveSpec", "SimRecording", "simulate"]
