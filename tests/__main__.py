"""`make test`: all there is to test, side by side, so that what one test waits for is time for another.

Tests marked `alone` are by the clock: they run one after the other, and all else makes way for them (nice).
A signal ends everything that was started; the exit code is then 128 and its number.
"""

from __future__ import annotations

import argparse
import shutil
import signal
import sys
import tempfile
from contextlib import ExitStack
from types import FrameType

from tests.conftest import ROOT
from tests.parts import Parts

_PYTEST = (sys.executable, "-m", "pytest")
# Of a fresh clone every process would compile the same, tests by the clock among them.
_KERNELS = ((sys.executable, "-m", "edge_agent", "warm-up"), (sys.executable, "-m", "map_service", "warm-up"))
_MAKING_WAY = ("nice", "-n", "10")


def the_alone() -> tuple[str, ...]:
    """Files with tests that want the processor whenever they ask for it."""
    files = sorted((ROOT / "tests").rglob("test_*.py"))
    return tuple(str(file.relative_to(ROOT)) for file in files if "mark.alone" in file.read_text())


def main() -> int:
    """What the largest part says is shown as it comes, then what the others have said; 0 if all are well."""
    options = argparse.ArgumentParser(prog="python -m tests", description=__doc__)
    options.add_argument("--workers", type=int, default=2, help="processes that share the tests that are not alone")
    workers = str(options.parse_args().workers)
    together = (*_MAKING_WAY, *_PYTEST, "-n", workers, "--dist", "worksteal", "-m", "not alone")
    beside = (
        (*_PYTEST, "-m", "alone", *the_alone()),
        (*_MAKING_WAY, "make", "--no-print-directory", "fpga-test", "WORKERS=1"),
    )
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:  # nohup
            signal.signal(number, _end)
    with ExitStack() as cleanup:
        outs = [cleanup.enter_context(tempfile.TemporaryFile("w+")) for _ in beside]
        parts = cleanup.enter_context(Parts(ROOT))
        for compiling in [parts.start(command) for command in _KERNELS]:
            compiling.wait()
        running = [parts.start(together), *map(parts.start, beside, outs)]
        codes = [part.wait() for part in running]
        for out in outs:
            out.seek(0)
            shutil.copyfileobj(out, sys.stdout)
    return int(any(codes))


def _end(number: int, _: FrameType | None) -> None:
    sys.exit(128 + number)


if __name__ == "__main__":
    sys.exit(main())
