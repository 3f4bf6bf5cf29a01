"""Who places the base in the tree of frames: the agent, or another node. Two at once would tear the tree apart."""

from __future__ import annotations

import logging
import math
import time
from collections import deque

from edge_agent.ros.codec import TF, Codec
from edge_agent.ros.settings import RosSettings
from edge_agent.ros.tf_buffer import TfBuffer, transform_of
from edge_agent.sources.messages import stamp_ns
from splitslam.errors import DataError
from splitslam.logs import fields

_log = logging.getLogger(__name__)
_SILENT_S = 2.0  # so long after its last transform another node still owns the base
_REMEMBERED = 300  # transforms of ours that may still come back to us


class OdomOwner:
    """Listens to /tf. tree: what other nodes say there. undecodable: messages that could not be read."""

    def __init__(self, settings: RosSettings, codec: Codec) -> None:
        self._settings, self._codec = settings, codec
        self.tree = TfBuffer()
        self.undecodable = 0
        self._ours: deque[int] = deque(maxlen=_REMEMBERED)
        self._heard_s = -math.inf  # when another node has placed the base

    def sent(self, placed_ns: int) -> None:
        """We place the base at this time ourselves; to be said before it is sent."""
        self._ours.append(placed_ns)

    @property
    def is_us(self) -> bool:
        """The agent places the base: it shall, and nobody else does."""
        return self._settings.publish_odom_tf and not self.is_another

    @property
    def is_another(self) -> bool:
        """Another node places the base now, under whatever frame."""
        return time.monotonic() - self._heard_s < _SILENT_S

    def on_tf(self, raw: bytes) -> None:
        """A message of /tf, our own among them."""
        self._add(raw, fixed=False)

    def on_static(self, raw: bytes) -> None:
        """A message of /tf_static."""
        self._add(raw, fixed=True)

    def _add(self, raw: bytes, fixed: bool) -> None:
        try:
            message = self._codec.decode(raw, TF)
        except DataError:
            self.undecodable += 1
            return
        for stamped in message.transforms:
            placed_ns, child = stamp_ns(stamped.header), stamped.child_frame_id.lstrip("/")
            if child == self._settings.odom_frame:
                continue  # `map -> odom` is what we are here for
            if child == self._settings.base_frame:
                if not fixed and placed_ns in self._ours:
                    continue
                self._heard(stamped.header.frame_id, fixed)
            T = transform_of(stamped.transform)
            if T is None:
                self.undecodable += 1
            else:
                self.tree.add(stamped.header.frame_id, child, placed_ns, T, fixed)

    def _heard(self, parent: str, fixed: bool) -> None:
        if self._settings.publish_odom_tf and not self.is_another:
            said = fields(parent=parent, child=self._settings.base_frame)
            _log.warning("another node places the base: only map -> odom is published", extra=said)
        self._heard_s = math.inf if fixed else max(self._heard_s, time.monotonic())
