"""Starts a loop pool, has one job done, says so and waits to be killed."""

from __future__ import annotations

import json
import time

import numpy as np

from map_service.loop_pool import LoopPool
from map_service.loops import LoopJob
from map_service.settings import LoopSettings

if __name__ == "__main__":
    pool = LoopPool(1)
    up = np.array([0.0, 0.0, 1.0])
    made = np.random.default_rng(1).uniform(-5, 5, (2, 500, 3)).astype(np.float32)
    result = pool.submit(LoopJob(0, 1, made[0], made[1], np.eye(4), up, up, False, LoopSettings())).result()
    print(json.dumps({"accepted": result.accepted, "cpu_ns": pool.cpu_ns()}), flush=True)
    time.sleep(600)
