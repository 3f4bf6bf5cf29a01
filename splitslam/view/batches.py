"""How what is logged is put together before it goes out: few large pieces load faster, small ones are seen sooner."""

from __future__ import annotations

from datetime import timedelta

import rerun as rr

APPLICATION = "splitslam"


def recording_stream(live: bool) -> rr.RecordingStream:
    """live: somebody looks on while it is logged. Else a piece is of five seconds, or four megabytes."""
    if live:
        return rr.RecordingStream(APPLICATION)
    config = rr.ChunkBatcherConfig(flush_tick=timedelta(seconds=5), flush_num_bytes=4 << 20)
    return rr.RecordingStream(APPLICATION, batcher_config=config)
