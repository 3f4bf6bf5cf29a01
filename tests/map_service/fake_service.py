"""`python -m tests.map_service.fake_service [serve --config] CONFIG.yaml`: the real service over the fake pipeline."""

from __future__ import annotations

import sys
from pathlib import Path

from map_service.config import ServiceConfig
from map_service.server import serve
from splitslam import config

if __name__ == "__main__":
    serve(config.load(ServiceConfig, Path(sys.argv[-1])), engine="tests.map_service.fakes:FakeEngine")
