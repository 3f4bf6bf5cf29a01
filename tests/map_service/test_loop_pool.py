"""The processes that verify loops: what they load, and that they say what `verify` says here."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from map_service.loop_pool import LoopPool
from map_service.loops import LoopJob, verify
from map_service.settings import LoopSettings
from splitslam import se3
from tests.map_pipeline.naive import room

UP = np.array([0.0, 0.0, 1.0])


@pytest.mark.parametrize("module", ["map_service.__main__", "map_service.processes", "map_service.loops"])
def test_what_a_process_of_the_pool_imports_leaves_out_what_takes_long_to_load(module: str) -> None:
    heavy = ("pydantic", "typer", "yaml", "numba", "gtsam", "sqlalchemy", "grpc")
    look = f"import sys, {module}; print(*(name for name in {heavy!r} if name in sys.modules))"
    done = subprocess.run([sys.executable, "-c", look], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout.split()) == (0, []), done.stderr


def test_the_pool_finds_what_is_found_here() -> None:
    rng = np.random.default_rng(3)
    target = np.concatenate(room(rng, 4000, 0.01)).astype(np.float32)
    T = se3.exp(np.array([0.0, 0.0, 0.2, 0.3, -0.2, 0.0]))
    source = ((np.concatenate(room(rng, 4000, 0.01)) - T[:3, 3]) @ T[:3, :3]).astype(np.float32)
    job = LoopJob(0, 9, target, source, np.eye(4), UP, UP, False, LoopSettings())
    pool = LoopPool(1)
    try:
        found, here = pool.submit(job).result(60.0), verify(job)
    finally:
        pool.close()
    assert (found.reason, found.distinct) == (here.reason, here.distinct)
    np.testing.assert_array_equal(found.T_older_newer, here.T_older_newer)
    np.testing.assert_allclose(found.T_older_newer, T, atol=0.02)
