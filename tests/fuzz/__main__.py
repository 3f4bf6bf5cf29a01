"""`make fuzz`: each target for its share of the time, in a process of its own; the state machine; a real service.

A process that dies, hangs or grows is a defect: its last input is kept, and its seed repeats all of them. One run of
the codec is with every access of its kernels checked (NUMBA_BOUNDSCHECK).
"""

from __future__ import annotations

import argparse
import faulthandler
import json
import logging
import os
import subprocess
import sys
import tempfile
import time
import warnings
from dataclasses import asdict
from pathlib import Path
from typing import Any

HANG_S = 60.0
CHECKED, MACHINE, SERVICE = "codec_checked", "streams", "service"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("out/fuzz"))
    parser.add_argument("--only", help="one of them, in this process")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    if arguments.only:
        print(json.dumps(_one(arguments.only, arguments.seconds, arguments.seed, arguments.out)))
        return
    sys.exit(_all(arguments.seconds, arguments.seed, arguments.out))


def _all(seconds: float, seed: int, out: Path) -> int:
    """Number of those that failed."""
    from tests.fuzz.targets import TARGETS

    names = [*TARGETS, CHECKED, MACHINE, SERVICE]
    share_s = seconds / (len(names) + 2)  # the state machine and the service have two
    failed = 0
    for name in names:
        own_s = share_s * (2 if name in (MACHINE, SERVICE) else 1)
        command = (sys.executable, "-m", "tests.fuzz", "--only", name, "--seconds", f"{own_s:.1f}")
        done = subprocess.run(
            (*command, "--seed", str(seed), "--out", str(out)),
            env=_environment(name, out),
            stdout=subprocess.PIPE,
            text=True,
        )
        print(f"{name:14} {done.stdout.strip() or f'FAILED with {done.returncode}, see {out}/{name}.last'}", flush=True)
        failed += done.returncode != 0
    print("no defect found" if not failed else f"{failed} of {len(names)} with a defect")
    return failed


def _environment(name: str, out: Path) -> dict[str, str]:
    if name != CHECKED:
        return dict(os.environ)
    cache = out.absolute() / "checked-kernels"  # compiled code of its own
    return {**os.environ, "NUMBA_BOUNDSCHECK": "1", "NUMBA_CACHE_DIR": str(cache)}


def _one(name: str, seconds: float, seed: int, out: Path) -> dict[str, Any]:
    logging.disable(logging.CRITICAL)
    warnings.simplefilter("error")
    if name == MACHINE:
        return _machine(seconds, seed)
    if name == SERVICE:
        return _service(seconds, seed)
    from tests.fuzz.runner import run
    from tests.fuzz.target import Target
    from tests.fuzz.targets import TARGETS

    target = TARGETS["codec" if name == CHECKED else name]()

    def watched(given: Any) -> None:
        faulthandler.dump_traceback_later(HANG_S, exit=True)
        target.feed(given)
        faulthandler.cancel_dump_traceback_later()

    import numpy as np

    watched_target = Target(target.name, target.make, watched, target.refusals)
    watched_target.takes(target.make(np.random.default_rng(0)))  # compiles
    start_s = time.monotonic()
    try:
        outcome = run(watched_target, lambda _: (time.monotonic() - start_s) / seconds, seed, out / f"{name}.last")
    finally:
        target.close()
    outcome.check()
    (out / f"{name}.last").unlink()
    return _rounded(asdict(outcome))


def _machine(seconds: float, seed: int) -> dict[str, Any]:
    import hypothesis
    from hypothesis.stateful import run_state_machine_as_test

    from tests.fuzz.runner import MAX_GROWTH_BYTES, WARM, rss_bytes
    from tests.fuzz.stream_machine import StreamMachine

    settings = hypothesis.settings(
        max_examples=50,
        stateful_step_count=60,
        deadline=None,
        database=None,
        suppress_health_check=list(hypothesis.HealthCheck),
    )
    start_s, sequences, warm_bytes = time.monotonic(), 0, None
    while (spent := (time.monotonic() - start_s) / seconds) < 1.0:
        if warm_bytes is None and spent > WARM:
            warm_bytes = rss_bytes()
        StreamMachine.TestCase.settings = settings
        hypothesis.seed(seed * 100_000 + sequences)(StreamMachine.TestCase.runTest)
        run_state_machine_as_test(StreamMachine, settings=settings)
        sequences += settings.max_examples
    growth_bytes = rss_bytes() - (warm_bytes or rss_bytes())
    assert growth_bytes < MAX_GROWTH_BYTES, growth_bytes
    return _rounded({"name": MACHINE, "sequences": sequences, "steps": 60 * sequences, "growth_bytes": growth_bytes})


def _service(seconds: float, seed: int) -> dict[str, Any]:
    from tests.fuzz.runner import MAX_GROWTH_BYTES, WARM
    from tests.fuzz.service import FuzzedService, rss_bytes

    with tempfile.TemporaryDirectory() as folder:
        service = FuzzedService(Path(folder))
        try:
            service.play(WARM * seconds, seed)
            warm_bytes = rss_bytes(service.replica.pid)
            service.play((1 - WARM) * seconds, seed + 1)
            growth_bytes = rss_bytes(service.replica.pid) - warm_bytes
            counts = service.counts()
            service.replica.check_alive()
        finally:
            service.close()
    assert not any(counts.values()), counts
    assert growth_bytes < 2 * MAX_GROWTH_BYTES, growth_bytes  # four processes
    return {"name": SERVICE, **dict(service.seen), "growth_mib": round(growth_bytes / 2**20, 1)}


def _rounded(values: dict[str, Any]) -> dict[str, Any]:
    """Bytes as MiB, seconds as ms."""
    shown: dict[str, Any] = {}
    for key, value in values.items():
        if key.endswith("_bytes"):
            shown[key.removesuffix("bytes") + "mib"] = round(value / 2**20, 1)
        elif key.endswith("_s"):
            shown[key.removesuffix("_s") + "_ms"] = round(value * 1e3, 1)
        else:
            shown[key] = value
    return shown


if __name__ == "__main__":
    main()
