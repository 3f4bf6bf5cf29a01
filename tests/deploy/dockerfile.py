"""A Dockerfile as its tests read it: instructions, with their continued lines joined."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path


class Dockerfile:
    """`instructions`: (NAME, rest) in order, comments left out; those after the last FROM are the image's own."""

    def __init__(self, path: Path) -> None:
        self.path = path
        text = "\n".join(line for line in path.read_text().splitlines() if not line.lstrip().startswith("#"))
        lines = re.sub(r"\\\n\s*", " ", text).splitlines()
        self.instructions = [tuple(line.split(maxsplit=1)) for line in lines if line.strip()]
        last = max(i for i, (name, _) in enumerate(self.instructions) if name == "FROM")
        self.final = self.instructions[last + 1 :]

    def all(self, name: str) -> list[str]:
        """Of the image itself."""
        return [rest for found, rest in self.final if found == name]

    def command(self, name: str) -> list[str]:
        """ENTRYPOINT or CMD, or the command of HEALTHCHECK."""
        (rest,) = self.all(name)
        return json.loads(rest[rest.index("[") :])

    def environment(self, stage: str | None = None) -> dict[str, str]:
        """ENV of the image itself, or of the stage of that name."""
        found: dict[str, str] = {}
        within = None
        for name, rest in self.instructions:
            within = rest.rpartition(" AS ")[2] if name == "FROM" else within
            if name == "ENV" and (within == stage if stage else (name, rest) in self.final):
                found |= dict(word.split("=", 1) for word in shlex.split(rest))
        return found

    def copied(self) -> list[str]:
        """What is taken from the checkout, in any stage."""
        words = [rest.split() for name, rest in self.instructions if name == "COPY" and "--from=" not in rest]
        return [word for line in words for word in line[:-1] if not word.startswith("--")]
