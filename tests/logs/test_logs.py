"""Log lines: fields that name a frame alike on both sides, floods that are counted, lines that stay lines."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from splitslam import logs
from splitslam.log_limit import BURST, LogLimit
from splitslam.logs import complete, fields
from splitslam.trace import trace_id

RUN = "0f8fad5b-d9cb-469f-a165-70867728950e"


class Clock:
    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


class Lines(logging.Handler):
    """Collects what passes."""

    def __init__(self) -> None:
        super().__init__()
        self.records: list[logging.LogRecord] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.records.append(record)

    @property
    def repeated(self) -> list[int | None]:
        return [getattr(record, "fields", {}).get("repeated") for record in self.records]


def record(event: str, level: int = logging.WARNING, **values: Any) -> logging.LogRecord:
    made = logging.LogRecord("edge_agent.x", level, __file__, 1, event, (), None)
    made.fields = values
    return made


def test_a_session_says_robot_and_run_and_a_frame_of_it_its_trace_id() -> None:
    of_the_service = complete({"session_id": f"rover-7/{RUN}", "seq": 300})
    of_the_robot = complete({"robot_id": "rover-7", "run_id": RUN, "seq": 300})
    assert of_the_service == of_the_robot
    assert of_the_robot["trace_id"] == trace_id(RUN, 300) == "0f8fad5b0000012c"
    assert of_the_robot["session_id"] == f"rover-7/{RUN}"


def test_a_trace_id_that_the_agent_gave_is_kept() -> None:
    assert complete({"run_id": RUN, "seq": 1, "trace_id": "its own"})["trace_id"] == "its own"
    assert complete({"run_id": RUN, "seq": 1, "trace_id": ""})["trace_id"] == trace_id(RUN, 1)


@pytest.fixture
def stderr(capsys: pytest.CaptureFixture[str]) -> Iterator[Callable[[], list[str]]]:
    """The lines that a process which configures its logs writes; the test's own handlers are as before afterwards."""
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level
    root.handlers.clear()  # or the next configuration closes them
    yield lambda: capsys.readouterr().err.splitlines()
    root.handlers[0].close()
    root.handlers[:] = handlers
    root.setLevel(level)


@pytest.mark.parametrize("style", ["json", "console"])
def test_a_line_stays_one_line_whatever_a_robot_says(style: str, stderr: Callable[[], list[str]]) -> None:
    logs.configure_logs(style, "info", replica="10.0.0.1:50051")
    logging.getLogger("map_service.x").warning("refused", extra=fields(run_id=RUN, seq=2, detail='a"\nlevel=error b'))
    (line,) = stderr()
    assert trace_id(RUN, 2) in line
    if style == "json":
        parsed = json.loads(line)
        assert parsed["detail"] == 'a"\nlevel=error b'
        assert parsed["replica"] == "10.0.0.1:50051"
    else:
        assert r'detail="a\"\nlevel=error b"' in line


def test_a_flood_of_one_event_is_counted_and_said_once_when_the_window_is_over() -> None:
    clock, out = Clock(), Lines()
    limit = LogLimit(out, burst=3, window_s=10.0, clock_s=clock)
    for seq in range(500):
        limit.handle(record("frame lost", seq=seq))
    assert out.repeated == [None] * 3
    limit.handle(record("stream broke"))  # another event is not held back by the flood
    assert [r.msg for r in out.records[3:]] == ["stream broke"]
    clock.now_s += 10.0
    limit.handle(record("stream broke"))
    assert out.repeated == [None] * 4 + [497, None]
    assert getattr(out.records[4], "fields")["seq"] == 499  # noqa: B009
    limit.close()


def test_what_is_counted_when_the_program_ends_is_said() -> None:
    out = Lines()
    limit = LogLimit(out, burst=1, clock_s=Clock())
    for _ in range(7):
        limit.handle(record("spool failed"))
    limit.close()
    assert out.repeated == [None, 6]


def test_a_flood_that_just_stops_is_said_without_another_line() -> None:
    out = Lines()
    limit = LogLimit(out, burst=1, window_s=0.05)
    for _ in range(3):
        limit.handle(record("frame lost"))
    timer = limit._timer
    assert timer is not None
    timer.join(30.0)
    assert out.repeated == [None, 2]
    limit.close()


@pytest.mark.parametrize(("level", "printed"), [("debug", 50), ("info", BURST)])
def test_a_flood_is_printed_to_whom_asks_for_debug_lines_and_to_nobody_else(
    level: str, printed: int, stderr: Callable[[], list[str]]
) -> None:
    logs.configure_logs("json", level)
    for seq in range(50):
        logging.getLogger("map_service.x").info("frame slow", extra=fields(run_id=RUN, seq=seq))
    assert len(stderr()) == printed
