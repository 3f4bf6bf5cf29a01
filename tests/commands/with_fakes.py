"""`splitslam ARGUMENTS` with stand-ins for both programs: `with_fakes.py EDGE_MODE MAP_MODE ARGUMENTS`."""

from __future__ import annotations

import sys

from splitslam import cli
from splitslam.run import orchestrate
from tests.commands import fakes

if __name__ == "__main__":
    edge, service, *arguments = sys.argv[1:]
    real = orchestrate.run_recording
    orchestrate.run_recording = lambda options, progress, *_: real(options, progress, fakes.programs(edge, service))
    sys.argv = ["splitslam", *arguments]
    cli.main()
