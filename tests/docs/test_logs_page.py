"""docs/logs.md lists the lines that the code can write."""

from __future__ import annotations

import ast

from docs import make_logs

MADE = """
def f():
    event = "slow" if late else "in time"
    said = {"bytes": 1}
    said |= {"ms": 2}
    said["reason"] = 3
    _log.log(level, event, extra=fields(run_id=run, **said))

def g():
    _log.exception("failed")
    other.warning("not ours")

def h(what):
    _log.info(f"{what} came")
"""


def test_the_page_is_as_the_code_has_it() -> None:
    page = make_logs.PAGE.path.read_text()
    assert page == make_logs.PAGE.filled(page), "stale: run python -m docs.make_logs"


def test_events_and_fields_are_read_from_the_calls() -> None:
    fields = ("run_id", "bytes", "ms", "reason")
    assert sorted(make_logs.lines_of(ast.parse(MADE))) == [
        make_logs.Line("failed", "error", (), True),
        make_logs.Line("in time", "debug to warning", fields, False),
        make_logs.Line("slow", "debug to warning", fields, False),
        make_logs.Line("{f'{what} came'}", "info", (), False),
    ]


def test_an_event_is_always_the_same_words() -> None:
    """What differs from line to line is in the fields, so that a search finds all of them."""
    rows = [row for row in make_logs.PAGE.path.read_text().splitlines() if row.startswith("| ")]
    assert not [row for row in rows if "%" in row or "{" in row]


def test_a_field_has_one_name_on_both_sides() -> None:
    """A session is session_id, a run run_id: what logs.complete knows."""
    page = make_logs.PAGE.path.read_text()
    rows = [row for row in page.splitlines() if row.startswith("| ")]
    for wrong in ("`session`", "`run`", "`robot`", "`site`", "`trace`"):
        assert not [row for row in rows if wrong in row]
