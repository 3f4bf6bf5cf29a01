"""Rate control against a made uplink: frames whose size follows their points, dense ones now and then."""

from __future__ import annotations

import tracemalloc
from dataclasses import dataclass

import numpy as np
import pytest

from edge_agent.rate import RateControl, RateSettings

SCAN_NS = 100_000_000
OVERHEAD = RateSettings().frame_overhead_bytes


@dataclass
class Run:
    """What a run sent, by frame: stamps, bytes all in, points withheld; and the scans left out."""

    stamps_ns: np.ndarray
    sizes: np.ndarray
    withheld: np.ndarray
    left_out: int
    points: np.ndarray

    def windows(self, length_s: float = 5.0) -> np.ndarray:
        """Bytes of every window that begins with a frame, whole ones only."""
        starts = self.stamps_ns[self.stamps_ns <= self.stamps_ns[-1] - length_s * 1e9]
        ends = np.searchsorted(self.stamps_ns, starts + int(length_s * 1e9))
        total = np.concatenate([[0], np.cumsum(self.sizes)])
        return total[ends] - total[np.searchsorted(self.stamps_ns, starts)]


def drive(
    control: RateControl, scans: int, dense_every: int, bits: float = 15.0, start: int = 0, known: bool = True
) -> Run:
    """scans at 10 Hz; a point costs `bits` +- 20 %, a frame 160 bytes besides, 60 without points; a dense one has 5,000
    points, and is put off when there is no room."""
    rng = np.random.default_rng(start)
    rows, left_out, due = [], 0, False
    for k in range(start, start + scans):
        stamp_ns, due = k * SCAN_NS, due or k % dense_every == 0
        dense = due
        if not control.admits(stamp_ns):
            left_out += 1
            continue
        wanted = int(5000 * rng.uniform(0.8, 1.2)) if dense else 400
        points = control.points(stamp_ns, dense, wanted, known)
        if dense and not points:
            dense, wanted = False, 400
            points = 0 if known else control.points(stamp_ns, dense, wanted, known)
        due = due and not dense
        while True:
            payload = int((160 if points else 60) + points * bits * rng.uniform(0.8, 1.2) / 8)
            if control.fits(stamp_ns, payload) or points <= control.settings.fewest_points:
                break
            points = int(0.8 * points)
        control.sent(stamp_ns, dense, points, wanted, payload)
        rows.append((stamp_ns, payload + OVERHEAD, wanted - points, points))
    stamps_ns, sizes, withheld, carried = np.array(rows, np.int64).T
    return Run(stamps_ns, sizes, withheld, left_out, carried)


def test_without_a_limit_nothing_is_withheld():
    run = drive(RateControl(RateSettings()), 300, 10)
    assert run.withheld.sum() == run.left_out == 0


@pytest.mark.parametrize("kbps", [60, 70, 120, 250])
@pytest.mark.parametrize("dense_every", [3, 10, 50])
@pytest.mark.parametrize("known", [True, False])
def test_every_window_keeps_the_budget_and_uses_it_while_points_are_withheld(kbps: int, dense_every: int, known: bool):
    run = drive(RateControl(RateSettings(), kbps), 600, dense_every, known=known)
    budget = kbps * 125 * 5
    windows = run.windows()
    assert windows.max() <= 1.10 * budget
    assert run.left_out == 0
    withheld = np.array([run.withheld[k : k + 50].any() for k in range(len(windows))])
    settled = np.arange(len(windows)) > 50
    assert np.all(windows[withheld & settled] >= 0.7 * budget)
    if kbps <= 70:
        assert withheld.sum() > 500


def test_a_generous_budget_withholds_nothing():
    run = drive(RateControl(RateSettings(), 2000), 300, 10)
    assert run.withheld.sum() == 0


def test_points_go_before_frames_and_frames_only_when_nothing_fits():
    assert drive(RateControl(RateSettings(), 50), 300, 10).left_out == 0
    starved = drive(RateControl(RateSettings(), 8), 300, 10)
    assert starved.left_out > 100
    assert starved.windows().max() <= 1.10 * 8 * 125 * 5


def test_a_limit_that_falls_takes_effect_at_once_without_a_silence_and_one_that_rises_is_used():
    control = RateControl(RateSettings(), 300)
    drive(control, 200, 10)
    control.limit_kbps = 70
    low = drive(control, 200, 10, start=200)
    assert low.left_out == 0
    assert low.windows().max() <= 1.10 * 70 * 125 * 5
    control.limit_kbps = None
    assert drive(control, 100, 10, start=400).withheld.sum() == 0


def test_while_old_frames_wait_new_ones_leave_them_room():
    control = RateControl(RateSettings(), 100)
    control.backlog = True
    run = drive(control, 300, 10)
    assert run.windows().max() <= 0.75 * 100 * 125 * 5


@pytest.mark.parametrize(("known", "least"), [(True, 400), (False, 200)])
def test_no_frame_carries_fewer_points_than_are_worth_it(known: bool, least: int):
    """A handful registers nothing: they are saved up while the motion alone carries the pose."""
    run = drive(RateControl(RateSettings(), 60), 600, 10, known=known)
    assert run.points[run.points > 0].min() >= least
    assert np.count_nonzero(run.points == 0) > 100


def test_a_dense_frame_that_finds_no_room_is_put_off_and_not_thinned_to_nothing():
    run = drive(RateControl(RateSettings(), 60), 600, 3)
    dense = run.points[run.points > 400]
    assert len(dense) > 20
    assert dense.min() >= RateSettings().fewest_dense_points


def test_the_map_begins_with_whole_frames_however_tight_the_budget():
    """Thinned ones map nothing that later scans could be placed by, and the robot is lost."""
    control = RateControl(RateSettings(), 80)
    carried = []
    for k in range(6):
        points = control.points(k * SCAN_NS, True, 5000)
        control.sent(k * SCAN_NS, True, points, 5000, 160 + 6000 * points // 5000)
        carried.append(points)
    assert carried[:2] == [5000] * 2
    assert max(carried[2:]) < 2500


def test_what_else_went_over_the_link_leaves_less_of_the_window_and_costs_no_frame():
    alone, beside = RateControl(RateSettings(), 200), RateControl(RateSettings(), 200)
    others = 60_000
    for control in (alone, beside):
        drive(control, 100, 100, bits=8.0)  # far below the budget
    beside.also_sent(others)
    dense = drive(alone, 60, 4, start=100), drive(beside, 60, 4, start=100)
    first = [int(run.sizes[run.stamps_ns < 149 * SCAN_NS].sum()) for run in dense]
    assert first[0] + others > 200 * 125 * 5
    assert first[1] + others <= 200 * 125 * 5
    assert dense[1].left_out == 0


def test_without_a_budget_nothing_is_remembered_for_longer_than_a_window():
    control = RateControl(RateSettings())
    drive(control, 200, 10)
    tracemalloc.start()
    try:
        for k in range(200, 5200):
            control.sent(k * SCAN_NS, False, 400, 400, 900)
        assert tracemalloc.get_traced_memory()[0] < 50_000, "70 bytes a frame are 60 MB a day"
    finally:
        tracemalloc.stop()
