"""No sequence of messages makes a session forget, map twice, or answer what it did not do."""

from __future__ import annotations

from hypothesis import HealthCheck, settings
from hypothesis.stateful import run_state_machine_as_test

from tests.fuzz.stream_machine import StreamMachine

SHORT = settings(
    max_examples=40, stateful_step_count=50, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck)
)


def test_any_sequence_of_messages_leaves_every_frame_mapped_once_or_answered_why_not() -> None:
    run_state_machine_as_test(StreamMachine, settings=SHORT)
