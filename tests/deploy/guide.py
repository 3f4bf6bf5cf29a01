"""docs/server.md as a script: its command blocks, by heading."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

from tests.conftest import ROOT

PAGE = ROOT / "docs" / "server.md"
_BLOCK = re.compile(r"^```\n(.*?)^```", re.MULTILINE | re.DOTALL)


def commands(heading: str) -> str:
    """All blocks without a language under `## heading`, in order."""
    sections = re.split(r"^## ", PAGE.read_text(), flags=re.MULTILINE)
    (section,) = [text for text in sections if text.splitlines()[0] == heading]
    return "".join(_BLOCK.findall(section))


def type_in(script: str, folder: Path) -> None:
    """bash, in `folder`, up to the first line that fails. `sudo` does nothing for whoever is not root."""
    tools = folder / "tools"
    tools.mkdir(exist_ok=True)
    sudo = tools / "sudo"
    sudo.write_text('#!/bin/sh\n[ "$(id -u)" = 0 ] || exit 0\nexec "$@"\n')
    sudo.chmod(0o755)
    path = os.pathsep.join([str(tools), str(Path(sys.executable).parent), os.environ["PATH"]])
    environment = {key: value for key, value in os.environ.items() if not key.startswith("SPLITSLAM_")}
    done = subprocess.run(
        ("bash", "-euxo", "pipefail", "-c", script),
        cwd=folder, env={**environment, "PATH": path}, capture_output=True, text=True, timeout=100,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
