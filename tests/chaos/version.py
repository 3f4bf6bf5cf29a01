"""A second version of the package beside this one, for rolling upgrades."""

from __future__ import annotations

import io
import subprocess
import sys
import tarfile
from pathlib import Path

from tests.conftest import ROOT

OTHER = "0.0.0+other"


def other_version(folder: Path, ref: str | None) -> tuple[str, ...]:
    """The command of a map service from git's `ref`; None: what is committed now, under another version number."""
    archive = subprocess.run(
        ("git", "archive", ref or "HEAD", "splitslam", "map_service", "edge_agent"),
        cwd=ROOT,
        capture_output=True,
        check=True,
    ).stdout
    with tarfile.open(fileobj=io.BytesIO(archive)) as tar:
        tar.extractall(folder, filter="data")
    if ref is None:
        (folder / "splitslam" / "__init__.py").write_text(f'"""Another version."""\n\n__version__ = "{OTHER}"\n')
    run = f"import sys; sys.path.insert(0, {str(folder)!r}); from map_service.__main__ import main; main()"
    return (sys.executable, "-c", run)
