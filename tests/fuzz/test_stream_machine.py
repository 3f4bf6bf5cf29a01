"""No sequence of messages makes a session forget, map twice, or answer what it did not do."""

from __future__ import annotations

from hypothesis import HealthCheck, Phase, settings
from hypothesis.stateful import run_state_machine_as_test

from tests.fuzz.stream_machine import StreamMachine

SHORT = settings(
    max_examples=30,
    stateful_step_count=50,
    deadline=None,
    derandomize=True,
    phases=(Phase.generate,),  # a failure shows its sequence as it is; `make fuzz` makes it short
    suppress_health_check=(HealthCheck.too_slow, HealthCheck.data_too_large),
)


def test_any_sequence_of_messages_leaves_every_frame_mapped_once_or_answered_why_not() -> None:
    run_state_machine_as_test(StreamMachine, settings=SHORT)
