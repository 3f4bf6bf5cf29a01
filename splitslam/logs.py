"""Structured log lines on stderr, for people or for machines; docs/logs.md lists them.

A line is an event, a few constant words, and fields: `_log.warning("frame lost", extra=fields(run_id=..., seq=...))`.
Names of fields are the same on both sides, so one search finds a frame in both logs (splitslam/trace.py).
"""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

from splitslam.log_limit import LogLimit
from splitslam.trace import trace_id

_always: dict[str, Any] = {}


def say_always(**values: Any) -> None:
    """More fields of every line of this process, for machines only, once they are known."""
    _always.update(values)


def fields(**values: Any) -> dict[str, dict[str, Any]]:
    """For `extra=` of a logging call. session_id or run_id, and seq: the line then has the frame's trace id as well."""
    return {"fields": values}


def complete(values: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of a line with those that follow: a session is a robot's run, a frame of it has a trace id."""
    done = dict(values)
    if "session_id" in done:
        robot_id, _, run_id = str(done["session_id"]).rpartition("/")
        done.setdefault("robot_id", robot_id)
        done.setdefault("run_id", run_id)
    elif "run_id" in done and "robot_id" in done:
        done["session_id"] = f"{done['robot_id']}/{done['run_id']}"
    if "run_id" in done and "seq" in done and not done.get("trace_id"):
        done["trace_id"] = trace_id(str(done["run_id"]), int(done["seq"]))
    return done


class _JsonFormatter(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        line = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="microseconds"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "event": record.getMessage(),
            **complete({**_always, **getattr(record, "fields", {})}),
        }
        if record.exc_info:
            line["exception"] = self.formatException(record.exc_info)
        return json.dumps(line, default=str)


class _ConsoleFormatter(logging.Formatter):
    """What the process always says, and what follows from other fields but for the trace id, is left out."""

    def format(self, record: logging.LogRecord) -> str:
        time = datetime.fromtimestamp(record.created).strftime("%H:%M:%S.%f")[:-3]
        given = dict(getattr(record, "fields", {}))
        if "trace_id" in (done := complete(given)):
            given["trace_id"] = done["trace_id"]
        text = "".join(f" {key}={_word(value)}" for key, value in given.items())
        line = f"{time} {record.levelname.lower():<7} {record.getMessage()}{text}"
        return f"{line}\n{self.formatException(record.exc_info)}" if record.exc_info else line


def _word(value: Any) -> str:
    """One word, or in quotes: a line stays a line."""
    text = str(value)
    return text if text and not any(c.isspace() or c in '"=' for c in text) else json.dumps(text, ensure_ascii=False)


def configure_logs(style: str, level: str, **always: Any) -> None:
    """Send this process's log to stderr. style: "console" or "json"; level: "debug", "info", ...

    always: fields of every line of this process, for machines only, such as replica and worker.
    """
    _always.clear()
    say_always(**always)
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(_JsonFormatter() if style == "json" else _ConsoleFormatter())
    all_of_them = level == "debug"  # who asks for that wants every line
    logging.basicConfig(level=level.upper(), handlers=[handler if all_of_them else LogLimit(handler)], force=True)
    for noisy in ("numba", "asyncio", "sqlalchemy", "grpc"):  # their own debug lines are not ours to show
        logging.getLogger(noisy).setLevel(max(logging.WARNING, logging.getLevelName(level.upper())))
