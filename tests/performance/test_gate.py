"""No kernel is much slower, or called much more often, than when bounds.json was written."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.performance.capture import Call, copied, kernel_calls
from tests.performance.gate import NEEDS_A_BOUND, TOLERATED, Bound, Verdict, judge, load_bounds, ratio
from tests.performance.reference import Reference

ANEW = "make bounds"
BOUNDS = load_bounds()
# What a scan goes through, by where its kernels are.
COVERED = {
    "projection": "edge_agent.features._projection_kernels.",
    "deskew": "edge_agent.deskew._kernels.",
    "features": "edge_agent.features._thinning_kernels.",
    "encoding": "splitslam.codec.",
    "decoding": "decode:splitslam.codec.",
    "registration": "splitslam.registration._descent_kernels.",
    "IMU": "edge_agent.imu._kernels.",
}


@pytest.fixture(scope="module")
def calls(shared_data: Path) -> dict[str, Call]:
    found = kernel_calls(shared_data / "yard1/yard1.bag", shared_data / "yard1/yard1.yaml")
    return {call.name: call for call in found}


@pytest.fixture(scope="module")
def reference() -> Reference:
    return Reference()


@pytest.mark.parametrize("name", BOUNDS)
def test_a_kernel_is_as_fast_as_when_its_bound_was_taken(name: str, calls: dict[str, Call], reference: Reference):
    assert name in calls, f"{name} is not called any more: {ANEW}"
    verdict = judge(calls[name], reference, BOUNDS[name])
    assert not verdict.red, f"{verdict}; {TOLERATED:g} times are tolerated. If it must be so: {ANEW}"


def test_every_kernel_that_takes_much_of_the_time_has_a_bound(calls: dict[str, Call]):
    without = [name for name, call in calls.items() if call.share > NEEDS_A_BOUND and name not in BOUNDS]
    assert not without, f"no bound: {', '.join(without)}: {ANEW}"


@pytest.mark.parametrize("part", COVERED)
def test_every_part_of_a_scans_way_has_a_bound(part: str):
    assert any(name.startswith(COVERED[part]) for name in BOUNDS)


def test_a_kernel_that_does_its_work_twice_is_red(calls: dict[str, Call], reference: Reference):
    call = next(call for call in calls.values() if call.name.startswith(COVERED["projection"]))
    bound = Bound(ratio(call, reference), call.per_scan)

    def twice(*arguments: Any) -> None:
        call.kernel(*copied(arguments))
        call.kernel(*arguments)

    assert judge(replace(call, kernel=twice), reference, bound).red
    assert not judge(call, reference, bound).red


def test_a_kernel_that_is_called_twice_as_often_is_red():
    assert Verdict("match", 1.0, 16.0, Bound(1.0, 8.0)).red
    assert not Verdict("match", 1.0, 9.0, Bound(1.0, 8.0)).red


def test_a_copied_argument_is_of_the_same_type_to_a_kernel():
    frozen = np.arange(4.0)
    frozen.flags.writeable = False
    array, number, (inner,) = copied((frozen, 3, (np.zeros(2, np.int32),)))
    assert not array.flags.writeable
    assert array is not frozen
    assert (number, inner.dtype) == (3, np.int32)
