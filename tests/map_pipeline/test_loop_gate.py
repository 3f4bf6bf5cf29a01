from __future__ import annotations

import json

import numpy as np
import pytest

from map_service.loop_gate import Chain, LoopGate
from map_service.loops import LoopResult
from map_service.settings import LoopGateSettings
from splitslam import se3

LAP = 100  # keyframes, a metre apart, before the way comes back to where it began


def chain(drift_m: float = 0.0, loops: list[tuple[int, int]] | None = None) -> Chain:
    """50 m out and back, then the same way again; the graph has the second lap `drift_m` to the side."""
    poses = []
    for k in range(2 * LAP):
        x = float(k % LAP) if k % LAP < LAP // 2 else float(LAP - k % LAP)
        poses.append(se3.compose(np.eye(3), np.array([x, drift_m if k >= LAP else 0.0, 0.0])))
    return Chain(poses, np.arange(2.0 * LAP), loops or [])


def loop(older: int, *, side_m: float = 0.0, yaw: float = 0.0, distinct: bool = True, reason: str = "") -> LoopResult:
    """Says that keyframe older + LAP lies `side_m` beside keyframe `older`: 0 is the truth."""
    T = se3.compose(se3.so3_exp(np.array([0, 0, yaw])), np.array([0.0, side_m, 0.0]))
    return LoopResult(older, older + LAP, T, np.eye(6) * 1e-4, True, reason, 0.9, 0.1, distinct)


def admitted(gate: LoopGate, results: list[LoopResult], seen: Chain) -> list[list[int]]:
    return [[a.loop.older for a in gate.take(result, seen)] for result in results]


def test_a_loop_that_corrects_the_usual_drift_enters_at_once():
    gate = LoopGate(LoopGateSettings())
    entered = gate.take(loop(10), chain(drift_m=1.0))  # usual after 100 m: 0.3 m + 1 %
    assert [a.loop.older for a in entered] == [10]
    assert entered[0].correction_m == pytest.approx(1.3)


def test_a_loop_that_no_drift_explains_is_refused_however_many_say_the_same():
    gate = LoopGate(LoopGateSettings())
    assert admitted(gate, [loop(k) for k in (5, 10, 15, 20, 25)], chain(drift_m=9.0)) == [[]] * 5
    assert gate.refused == {"implausible": 5}


def test_a_turn_that_no_drift_explains_is_refused_too():
    gate = LoopGate(LoopGateSettings())
    assert gate.take(loop(10, yaw=1.0), chain()) == []
    assert gate.refused == {"implausible": 1}


def test_surprising_loops_enter_together_once_enough_of_them_agree_over_a_long_enough_way():
    gate = LoopGate(LoopGateSettings())
    drifted = chain(drift_m=4.0)
    steps = admitted(gate, [loop(5), loop(9), loop(13), loop(18)], drifted)
    assert steps[:3] == [[], [], []]  # three agree by then, but over 8 m only
    assert sorted(steps[3]) == [5, 9, 13, 18]
    assert gate.waiting == []


def test_a_loop_that_contradicts_the_others_stays_outside():
    gate = LoopGate(LoopGateSettings())
    steps = admitted(gate, [loop(5), loop(9, side_m=2.5), loop(13), loop(18)], chain(drift_m=4.0))
    assert sorted(steps[3]) == [5, 13, 18]
    assert [w.older for w in gate.waiting] == [9]
    gate.close()
    assert gate.refused == {"unsupported": 1}


def test_loops_at_one_place_do_not_support_each_other():
    gate = LoopGate(LoopGateSettings())
    steps = admitted(gate, [loop(5), loop(6), loop(6), loop(5), loop(20)], chain(drift_m=4.0))
    assert all(step == [] for step in steps)


def test_where_places_repeat_themselves_no_number_of_loops_corrects_an_unusual_drift():
    gate = LoopGate(LoopGateSettings())
    gate.take(loop(4, distinct=False, reason="ambiguous"), chain(drift_m=4.0))
    steps = admitted(gate, [loop(k) for k in (5, 9, 13, 18, 22)], chain(drift_m=4.0))
    assert all(step == [] for step in steps)
    later = admitted(gate, [loop(k) for k in (36, 40, 44, 48)], chain(drift_m=4.0))
    assert sorted(later[3]) == [36, 40, 44, 48]  # more than 30 m after the doubt


def test_a_fit_that_leaves_a_direction_open_enters_only_where_the_graph_expected_it():
    gate = LoopGate(LoopGateSettings())
    assert gate.take(loop(10, distinct=False), chain(drift_m=1.0)) == []
    assert gate.refused == {"ambiguous": 1}
    assert len(gate.take(loop(10, distinct=False), chain(drift_m=0.4))) == 1


def test_the_way_between_two_keyframes_leads_through_the_loops_in_the_graph():
    assert chain().tied_m(10, 120) == 110.0
    assert chain(loops=[(15, 115)]).tied_m(10, 120) == 10.0
    assert chain(loops=[(15, 115), (40, 60)]).tied_m(30, 62) == 12.0


def test_once_a_loop_has_tied_two_laps_a_second_one_may_correct_little():
    drifted = chain(drift_m=1.0, loops=[(15, 115)])
    assert LoopGate(LoopGateSettings()).take(loop(12), drifted) == []
    assert len(LoopGate(LoopGateSettings()).take(loop(12), chain(drift_m=0.3, loops=[(15, 115)]))) == 1


def test_waiting_loops_enter_when_others_have_corrected_the_graph():
    gate = LoopGate(LoopGateSettings())
    assert gate.take(loop(5), chain(drift_m=4.0)) == []
    entered = gate.take(loop(9), chain(drift_m=0.5))
    assert sorted(a.loop.older for a in entered) == [5, 9]


def test_a_restarted_gate_goes_on_where_it_was():
    gate, again = LoopGate(LoopGateSettings()), LoopGate(LoopGateSettings())
    drifted = chain(drift_m=4.0)
    admitted(gate, [loop(2, reason="few_inliers"), loop(5), loop(9), loop(13)], drifted)
    again.load(json.loads(json.dumps(gate.dump())))
    assert again.dump() == gate.dump()
    assert [a.loop.older for a in again.take(loop(18), drifted)] == [a.loop.older for a in gate.take(loop(18), drifted)]
    assert again.waiting == []
