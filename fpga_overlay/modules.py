"""The modules of `rtl/` as files: each in one of its name."""

from __future__ import annotations

import re
from pathlib import Path

RTL = Path(__file__).resolve().parent / "rtl"


def sources(top: str, rtl: Path = RTL) -> list[Path]:
    """The files of `top` and of all modules below it, sorted by name. KeyError if there is no such module."""
    files = {path.stem: path for path in rtl.glob("*.sv")}
    found: dict[str, Path] = {}
    waiting = [top]
    while waiting:
        name = waiting.pop()
        if name not in found:
            found[name] = files[name]
            words = set(re.findall(r"\w+", files[name].read_text()))
            waiting += sorted(words & files.keys() - found.keys())
    return [found[name] for name in sorted(found)]
