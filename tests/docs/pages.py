"""The documents, and the shell lines that they show."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass

from tests.conftest import ROOT

DOCUMENTS = sorted(
    path.relative_to(ROOT)
    for pattern in ("*.md", "docs/*.md", "*/README.md", "deploy/**/*.md")
    for path in ROOT.glob(pattern)
    if not any(part.startswith(".") for part in path.relative_to(ROOT).parts)
)
SHELL = ("", "sh", "bash", "console")  # a block without a language is one: what else it may be has to be said
OTHER = ("text", "yaml", "python", "json")
_FENCE = re.compile(r"^ *```(\S*)\s*$")
_HEADING = re.compile(r"^#+ (.+)$")
_PROMPT = re.compile(r"^\s*(?:\$ )?")


@dataclass(frozen=True, slots=True)
class ShellLine:
    """One command of a fenced block. heading: the last one above it. text: without prompt, comment and backslashes."""

    page: str
    heading: str
    number: int
    text: str


def shell_lines(page: str, text: str) -> Iterator[ShellLine]:
    """In order. Raises ValueError for a block of an unknown language or one that does not end."""
    heading, language, begun, carried = "", None, 0, ""
    for number, line in enumerate(text.splitlines(), 1):
        if fence := _FENCE.match(line):
            begun, language = number, None if language is not None else fence[1]
            if language not in (None, *SHELL, *OTHER):
                raise ValueError(
                    f"{page}:{number}: {language}: expected one of {', '.join(filter(None, SHELL + OTHER))}"
                )
        elif language is None:
            heading = found[1] if (found := _HEADING.match(line)) else heading
        elif language in SHELL:
            carried = " ".join(filter(None, (carried.strip(), _PROMPT.sub("", line, count=1))))
            if carried.endswith("\\"):
                carried = carried[:-1]
                continue
            if shlex.split(carried, comments=True):
                yield ShellLine(page, heading, number, carried.strip())
            carried = ""
    if language is not None:
        raise ValueError(f"{page}:{begun}: the block does not end")


def all_shell_lines() -> list[ShellLine]:
    """Of every document."""
    return [line for page in DOCUMENTS for line in shell_lines(str(page), (ROOT / page).read_text())]
