"""After a warm-up nothing of the service is left to compile: that would stop a session for a second, in its middle."""

from __future__ import annotations

import json
import subprocess
import sys

from tests.conftest import ROOT

# Names that begin with _ are called by other kernels of their file alone, and compiled with them.
LEFT = """
import importlib, json, pathlib
from numba.core.dispatcher import Dispatcher
from map_service.kernel_cache import fill
report = fill()
left = []
for path in sorted(pathlib.Path("map_service").glob("_*kernels.py")):
    module = importlib.import_module(f"map_service.{path.stem}")
    own = {name: value for name, value in vars(module).items() if isinstance(value, Dispatcher)}
    found = {name: value for name, value in own.items() if value.__module__ == module.__name__ and name[0] != "_"}
    left += [f"{path.stem}.{name}" for name, value in found.items() if not value.signatures]
from splitslam.registration._equation_kernels import deskew_again
of_a_keyframe = [str(signature[0]) for signature in deskew_again.signatures]
print(json.dumps({"left": left, "kernels": len(found), "of_a_keyframe": of_a_keyframe, **report.as_dict()}))
"""


def test_no_kernel_is_left_to_compile() -> None:
    done = subprocess.run((sys.executable, "-c", LEFT), cwd=ROOT, capture_output=True, text=True, timeout=400)
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    assert said["left"] == []
    assert said["kernels"] > 0
    assert any("float32" in points for points in said["of_a_keyframe"]), "a keyframe waits for the compiler"
