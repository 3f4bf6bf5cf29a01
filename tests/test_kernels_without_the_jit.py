"""The kernels' own tests pass as plain Python too: what numba compiles is what the source says."""

from __future__ import annotations

import os
import re
import subprocess
import sys

from tests.conftest import ROOT

# A kernel's own tests import the kernel module itself.
IMPORTS_KERNELS = re.compile(r"^\s*(?:from|import) (?:.*|.*\([^)]*)\b_\w*kernels\b", re.MULTILINE)
# These name columns of a kernel, and run whole pipelines: minutes without the JIT, and not what it is about. The last
# is about what is compiled.
OTHERS = {
    "tests/map_pipeline/test_old_ground_again.py",
    "tests/view/test_seen.py",
    "tests/map_service/test_kernel_cache.py",
}
MODULES = sorted(
    name
    for path in (ROOT / "tests").rglob("test_*.py")
    if (name := str(path.relative_to(ROOT))) not in OTHERS and IMPORTS_KERNELS.search(path.read_text())
)


def test_the_kernels_have_tests_of_their_own() -> None:
    kernels = sorted(
        p for part in ("splitslam", "edge_agent", "map_service") for p in (ROOT / part).rglob("_*kernels.py")
    )
    tested = "\n".join((ROOT / module).read_text() for module in MODULES)
    untested = []
    for path in kernels:
        package = ".".join(path.relative_to(ROOT).parent.parts)
        if not re.search(rf"from {package} import (?:.*|\([^)]*)\b{path.stem}\b|{package}\.{path.stem}\b", tested):
            untested.append(str(path.relative_to(ROOT)))
    assert not untested


def test_the_kernels_tests_pass_without_the_jit() -> None:
    # The voxel hash wraps on purpose, which numpy scalars warn about and compiled code does not.
    command = [sys.executable, "-m", "pytest", "-q", "-n", "0", "-p", "no:cacheprovider", *MODULES]
    command += ["-W", "ignore:overflow encountered in scalar multiply:RuntimeWarning"]
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run(command, env=environment, cwd=ROOT, capture_output=True, text=True, timeout=450)
    assert done.returncode == 0, done.stdout[-3000:]
