from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fpga_overlay.cosim import build
from fpga_overlay.cosim.verilated import CoreError, VerilatedTop
from splitslam.errors import InputError

LOOPBACK = Path(__file__).with_name("loopback.sv")


def beats(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 2**32, (count, 4), np.uint32)


@pytest.fixture(scope="module")
def loopback() -> VerilatedTop:
    return VerilatedTop(16, 1024, "loopback", [LOOPBACK])


def test_a_packet_comes_back_one_clock_later(loopback: VerilatedTop) -> None:
    sent = beats(1000)
    back, cycles = loopback.run(sent)
    np.testing.assert_array_equal(back, sent)
    assert cycles == 1001


@pytest.mark.parametrize("idle", [0.0, 0.5])
@pytest.mark.parametrize("stall", [0.0, 0.9])
def test_pauses_of_either_side_lose_nothing_and_take_time(loopback: VerilatedTop, idle: float, stall: float) -> None:
    packets = [beats(n, n) for n in (1, 2, 300)]
    back, cycles = loopback.run_many(packets, idle, stall, seed=7)
    for sent, got in zip(packets, back, strict=True):
        np.testing.assert_array_equal(got, sent)
    slowest = max(idle, stall)
    assert cycles == pytest.approx(303 / (1 - slowest), rel=0.25, abs=5)


def test_the_pattern_of_pauses_follows_the_seed(loopback: VerilatedTop) -> None:
    sent = beats(200)
    took = [loopback.run(sent, 0.3, 0.3, seed)[1] for seed in (1, 1, 2)]
    assert took[0] == took[1] != took[2]


def test_a_core_that_never_answers_is_an_error_and_not_a_hang(loopback: VerilatedTop) -> None:
    swallowed = beats(10)
    swallowed[-1] = 2**32 - 1
    with pytest.raises(CoreError, match="hung after 500 clocks: 10 of 10 beats taken, 9 given"):
        loopback.run(swallowed, max_cycles=500)
    loopback.reset()
    np.testing.assert_array_equal(loopback.run(beats(3))[0], beats(3))


def test_a_core_that_changes_a_waiting_beat_is_an_error(loopback: VerilatedTop) -> None:
    fickle = np.full((50, 4), 2**32 - 1, np.uint32)
    fickle[:, 0] -= 1
    np.testing.assert_array_equal(loopback.run(fickle)[0], fickle)  # never waits, so never changes
    with pytest.raises(CoreError, match="before it was taken"):
        loopback.run(fickle, stall=0.5)
    loopback.reset()


def test_a_build_is_made_once_and_again_when_its_source_changes(tmp_path: Path, loopback: VerilatedTop) -> None:
    first = build.library("loopback", {"RINGS": 16, "COLUMNS": 1024}, [LOOPBACK])
    stamp = first.stat().st_mtime_ns
    assert build.library("loopback", {"RINGS": 16, "COLUMNS": 1024}, [LOOPBACK]).stat().st_mtime_ns == stamp
    broken = tmp_path / "loopback.sv"
    broken.write_text(LOOPBACK.read_text().replace("endmodule", ""))
    with pytest.raises(InputError, match=r"loopback\.sv:"):
        build.library("loopback", {"RINGS": 16, "COLUMNS": 1024}, [broken])
