"""Generates splitslam/wire from proto/, or with --check says where the committed code differs.

Run by the interpreter of .venv-proto (`make proto`, `make check`), which has grpcio-tools 1.64.
"""

from __future__ import annotations

import argparse
import re
import sys
import tempfile
from importlib.resources import files
from pathlib import Path

from grpc_tools import protoc  # pyright: ignore[reportMissingImports]

PROTO = Path(__file__).resolve().parent
WIRE = PROTO.parent / "splitslam" / "wire"
# protoc's imports follow the proto path; ours live in splitslam/wire.
IMPORT = re.compile(r"^from splitslam\.v1 import", re.MULTILINE)


def generate(target: Path) -> list[Path]:
    """Writes the rewritten modules into `target` and returns them, sorted by name."""
    sources = sorted(str(path.relative_to(PROTO)) for path in PROTO.glob("splitslam/v1/*.proto"))
    with tempfile.TemporaryDirectory() as scratch:
        outputs = [f"--{kind}_out={scratch}" for kind in ("python", "pyi", "grpc_python")]
        includes = [f"-I{PROTO}", f"-I{files('grpc_tools') / '_proto'}"]
        if protoc.main(["protoc", *includes, *outputs, *sources]) != 0:
            sys.exit("protoc failed")
        written = []
        for made in sorted(Path(scratch, "splitslam", "v1").iterdir()):
            path = target / made.name
            path.write_text(IMPORT.sub("from splitslam.wire import", made.read_text()))
            written.append(path)
    return written


def differences() -> list[str]:
    """Names of the committed modules that are missing, superfluous or not what protoc makes."""
    with tempfile.TemporaryDirectory() as scratch:
        fresh = {path.name: path.read_text() for path in generate(Path(scratch))}
    committed = {path.name: path.read_text() for path in WIRE.glob("*_pb2*.py*")}
    return sorted(name for name in fresh.keys() | committed.keys() if fresh.get(name) != committed.get(name))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing; exit 1 when the committed code differs")
    if not parser.parse_args().check:
        generate(WIRE)
    elif drift := differences():
        sys.exit(f"splitslam/wire is not what proto/ says (run `make proto`): {', '.join(drift)}")


if __name__ == "__main__":
    main()
