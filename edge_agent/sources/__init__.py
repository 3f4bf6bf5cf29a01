"""Where sensor data comes from: recordings, and the sequencer that joins scans with the IMU."""

from __future__ import annotations

from edge_agent.sources.recording import Event, Recording, open_recording
from edge_agent.sources.sequencer import Sequencer

__all__ = ["Event", "Recording", "Sequencer", "open_recording"]
