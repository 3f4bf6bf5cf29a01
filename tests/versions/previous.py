"""The release before this one, as its wheel: kept here, because a clone need not have the history to build it from.

It is `git archive REF` built by `pip wheel --no-deps`, 270 kB; `python -m tests.versions.previous` makes it again.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
from io import BytesIO
from pathlib import Path

from tests.conftest import ROOT
from tests.once import made_once

VERSION = "0.1.0"
REF = "bb715b8"
TREES = {  # `git rev-parse REF:PACKAGE`
    "splitslam": "65234956d2705ac77813ceef70edf9782673b0e4",
    "edge_agent": "7957b96eac6f9989e2d23a36c41a1e1b8f03d67d",
    "map_service": "69a683a4946a5a77a1971c31c4356e5f31dd7009",
}
WHEEL = Path(__file__).with_name(f"splitslam-{VERSION}-py3-none-any.whl")
_UNPACKED = ROOT / "build" / "previous" / VERSION  # kept: compiling its kernels takes 20 s


def folder() -> Path:
    """Where its packages are, to be put on sys.path."""
    return made_once(_UNPACKED, lambda folder: shutil.unpack_archive(WHEEL, folder, "zip"))


def command(program: str) -> tuple[str, ...]:
    """`edge_agent`, `map_service` or `splitslam.cli` of that release, with today's dependencies."""
    module = program if program == "splitslam.cli" else f"{program}.__main__"
    run = f"import sys; sys.path.insert(0, {str(folder())!r}); from {module} import main; main()"
    return (sys.executable, "-c", run)


def environment() -> dict[str, str]:
    """For its own child processes too."""
    return {**os.environ, "PYTHONPATH": str(folder())}


def build(wheel_dir: Path) -> Path:
    """The wheel out of the history. Raises CalledProcessError when it is not there."""
    archive = subprocess.run(("git", "archive", REF), cwd=ROOT, capture_output=True, check=True).stdout
    with tempfile.TemporaryDirectory() as source:
        with tarfile.open(fileobj=BytesIO(archive)) as tar:
            tar.extractall(source, filter="data")
        options = ("--quiet", "--no-deps", "--no-build-isolation", "--wheel-dir", str(wheel_dir))
        subprocess.run((sys.executable, "-m", "pip", "wheel", *options, source), check=True, capture_output=True)
    return wheel_dir / WHEEL.name


if __name__ == "__main__":
    print(build(WHEEL.parent))
