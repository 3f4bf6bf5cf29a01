"""A part of a recording, with its messages as they are."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rosbags.rosbag1 import Reader, Writer


def cut(bag: Path, out: Path, keep_s: Sequence[tuple[float, float]], until_s: float) -> Path:
    """Messages that were recorded in one of the spans, seconds from the first message on, up to `until_s`."""
    with Reader(bag) as reader, Writer(out) as writer:
        written = {
            c.id: writer.add_connection(c.topic, c.msgtype, msgdef=c.msgdef.data, md5sum=c.digest)
            for c in reader.connections
        }
        begin_ns = reader.start_time
        for connection, at_ns, raw in reader.messages(stop=begin_ns + int(until_s * 1e9)):
            at_s = (at_ns - begin_ns) * 1e-9
            if any(begin <= at_s < end for begin, end in keep_s):
                writer.write(written[connection.id], at_ns, raw)
    return out
