"""Where sensor data comes from: recordings, live sensors, and the sequencer that joins scans with the IMU."""

from __future__ import annotations

from edge_agent.sources.recording import Recording, open_recording
from edge_agent.sources.sequencer import Sequencer
from edge_agent.sources.source import Counts, Event, Source, TimedEvent, open_source

__all__ = ["Counts", "Event", "Recording", "Sequencer", "Source", "TimedEvent", "open_recording", "open_source"]
