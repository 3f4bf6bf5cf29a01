"""Pages whose tables are made from the code: what stands between two marks is replaced, the rest is written by hand."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parent.parent


@dataclass(frozen=True, slots=True)
class MadePage:
    """docs/NAME.md, made by `python -m docs.make_NAME`. tables: what makes each, by the name in its marks."""

    name: str
    tables: Mapping[str, Callable[[], str]]

    @property
    def path(self) -> Path:
        return ROOT / "docs" / f"{self.name}.md"

    @property
    def command(self) -> str:
        return f"python -m docs.make_{self.name}"

    def filled(self, text: str) -> str:
        """The page with its tables made anew. Raises ValueError when it has not the marks of one."""
        for table, make in self.tables.items():
            begin, end = f"<!-- {table}: made by `{self.command}` -->", f"<!-- end of {table} -->"
            before, _, rest = text.partition(begin)
            _, found, after = rest.partition(end)
            if not found:
                raise ValueError(f"{self.path}: expected the lines {begin!r} and {end!r}")
            text = f"{before}{begin}\n{make()}\n{end}{after}"
        return text

    def main(self, doc: str | None) -> None:
        """The command: writes the page, or with --check only says whether it is as the code has it."""
        parser = argparse.ArgumentParser(description=doc)
        parser.add_argument("--check", action="store_true", help="only say whether the page is as the code has it")
        text = self.path.read_text()
        made = self.filled(text)
        if parser.parse_args().check:
            sys.exit(0 if made == text else f"{self.path}: not as the code has it; run {self.command}")
        self.path.write_text(made)
