"""One topic as it is heard: from writers that send again what is lost, and from those that do not.

A reliable reader is matched with reliable writers alone, a best-effort one with all (DDS 1.4, 2.2.3, table of policies:
RELIABILITY, requested against offered). So there is a reliable reader from the start; when a writer turns up that it
cannot hear, however late, a best-effort one comes besides, which leaves the reliable writers to the first.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

from cyclonedds.core import InstanceState, Listener, ReadCondition, SampleState, ViewState
from cyclonedds.domain import DomainParticipant
from cyclonedds.internal import InvalidSample
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from edge_agent.ros.graph import Delivery, Receive
from splitslam.logs import fields

_log = logging.getLogger(__name__)
TAKE = 256  # samples at a time
_UNREAD = SampleState.NotRead | ViewState.Any | InstanceState.Any


class Subscription:
    """`take` and `widened` belong to the graph's thread; what is lost is told from one of the middleware's."""

    def __init__(
        self,
        participant: DomainParticipant,
        topic: Topic,
        delivery: Delivery,
        receive: Receive,
        lost: Callable[[int], None],
    ) -> None:
        self._participant, self._topic, self._delivery = participant, topic, delivery
        self._receive, self._lost = receive, lost
        self._unheard = False  # somebody publishes whom the reliable reader cannot hear
        self._reliable_writers: dict[int, bool] = {}
        self._best_effort: tuple[DataReader, ReadCondition] | None = None
        self._reliable = self._open(reliable=True)

    @property
    def condition(self) -> ReadCondition:
        """Of messages of reliable writers."""
        return self._reliable[1]

    def widened(self) -> ReadCondition | None:
        """The condition of the best-effort reader, when it has become necessary since the last call."""
        if not self._unheard or self._best_effort is not None or not self._delivery.sensor:
            return None
        name = "/" + self._topic.name.partition("/")[2]
        _log.info("best effort: what is lost on the way is not sent again", extra=fields(topic=name))
        self._best_effort = self._open(reliable=False)
        return self._best_effort[1]

    def take(self) -> None:
        """Hands on what has come."""
        reader, condition = self._reliable
        while condition.triggered:
            for sample in reader.take(TAKE):
                if not isinstance(sample, InvalidSample):  # a writer has gone
                    self._receive(sample.raw)
        if self._best_effort is None:
            return
        reader, condition = self._best_effort
        while condition.triggered:
            for sample in reader.take(TAKE):
                if not isinstance(sample, InvalidSample) and not self._is_reliable(reader, sample):
                    self._receive(sample.raw)

    def _is_reliable(self, reader: DataReader, sample: Any) -> bool:
        """Its writer sends to the other reader as well."""
        writer = sample.sample_info.publication_handle
        if writer not in self._reliable_writers:
            found = reader.get_matched_publication_data(writer)
            if found is None:  # gone already; what comes twice is told by its stamp
                return False
            self._reliable_writers[writer] = isinstance(found.qos[Policy.Reliability], Policy.Reliability.Reliable)
        return self._reliable_writers[writer]

    def _open(self, reliable: bool) -> tuple[DataReader, ReadCondition]:
        listener = Listener(
            on_sample_lost=lambda _, status: self._lost(status.total_count_change),
            on_requested_incompatible_qos=lambda *_: self._on_unheard(),
        )
        reader = DataReader(self._participant, self._topic, qos_of(self._delivery, reliable), listener)
        return reader, ReadCondition(reader, _UNREAD)

    def _on_unheard(self) -> None:
        self._unheard = True


def qos_of(delivery: Delivery, reliable: bool) -> Qos:
    """As DDS has it; ROS 2's own defaults besides."""
    kind = Policy.Reliability.Reliable(duration(milliseconds=100)) if reliable else Policy.Reliability.BestEffort
    return Qos(
        kind,
        Policy.Durability.TransientLocal if delivery.latched else Policy.Durability.Volatile,
        Policy.History.KeepLast(delivery.keep),
        Policy.DurabilityService(duration(seconds=0), Policy.History.KeepLast(delivery.keep), -1, -1, -1),
        Policy.DataRepresentation(use_cdrv0_representation=True),
    )
