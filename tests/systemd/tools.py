"""Programs of Debian that tests here run."""

from __future__ import annotations

import os
import shutil
import subprocess
from functools import cache

from tests.missing import missing


@cache
def debian(program: str, package: str) -> str:
    """Path of `program`; `package` is installed where it is missing and we may.

    Else the test is skipped on a laptop and fails in CI.
    """
    if shutil.which(program) is None and os.geteuid() == 0 and shutil.which("apt-get"):
        apt = ["apt-get", "-qq", "-o", "DPkg::Lock::Timeout=240"]  # another worker may be at it
        for command in (["update"], ["install", "--yes", "--no-install-recommends", package]):
            subprocess.run([*apt, *command], capture_output=True, timeout=300)
    found = shutil.which(program)
    if found is None:
        missing(f"{program} is not installed (Debian: {package})")
    return found
