"""The command `splitslam`. What a command needs is imported inside it: `--help` must not wait for numba or gtsam."""

from splitslam.cli.program import app, main

__all__ = ["app", "main"]
