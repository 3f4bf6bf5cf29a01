"""Series that are there from the start, labels that cannot grow, gauges that go with their robot."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest
from prometheus_client import CollectorRegistry, generate_latest

from edge_agent.metric_list import BREAKS, DROP_REASONS
from edge_agent.metrics import EdgeMetrics
from map_service.channel import Beat, RobotStanding
from map_service.config import MetricsConfig, ServiceConfig
from map_service.metrics import ServiceMetrics
from map_service.robot_gauges import RobotGauges, RobotSeen
from map_service.robot_metric_list import ROBOT_METRICS
from splitslam.metrics import OTHER, Family, Label, collect
from splitslam.metrics.definition import counter
from tests.conftest import ROOT

MADE = counter(
    "splitslam_made", "made", "made", Label("reason", ("nan", "empty"), open=True), Label("side", ("a", "b"))
)


def standing(robot: str, run: str = "run", stamp_ns: int = 1, scans: int = 7) -> RobotSeen:
    return RobotSeen(RobotStanding(f"{robot}/{run}", 1, 2, scans, stamp_ns, 0.0, 3, 4, 0.1, 0.01), 2, 5.0)


def value(registry: CollectorRegistry, name: str, **labels: str) -> float | None:
    return registry.get_sample_value(name, labels)


def test_every_series_is_there_with_zero_before_anything_happens() -> None:
    registry = CollectorRegistry()
    family = Family(MADE, registry)
    assert set(family.values()) == {(r, s) for r in ("nan", "empty", OTHER) for s in "ab"}
    assert set(family.values().values()) == {0.0}
    assert value(registry, "splitslam_made_total", reason="nan", side="b") == 0


def test_a_value_that_is_not_listed_is_other_where_a_label_is_open_and_an_error_where_it_is_not() -> None:
    family = Family(MADE, CollectorRegistry())
    for reason in ("from a newer program", "and another", "nan"):
        family.inc(reason, "a")
    assert {key: n for key, n in family.values().items() if n} == {(OTHER, "a"): 2, ("nan", "a"): 1}
    with pytest.raises(KeyError):
        family.inc("nan", "c")


def test_what_others_count_has_zeros_too_and_no_more_labels_than_listed() -> None:
    registry, counts = CollectorRegistry(), {"nan": 3, "robot 1 says": 1, "robot 2 says": 1}
    metric = counter("splitslam_made", "made", "made", Label("reason", ("nan", "empty"), open=True))
    collect(metric, registry, lambda: counts)
    assert [value(registry, "splitslam_made_total", reason=r) for r in ("nan", "empty", OTHER)] == [3, 0, 2]
    assert generate_latest(registry).count(b"\nsplitslam_made_total{") == 3


def test_reasons_of_a_hostile_service_do_not_make_series() -> None:
    metrics = EdgeMetrics()
    before = len(generate_latest(metrics.registry).splitlines())
    for k in range(1000):
        metrics.drop(f"rejected_{k}")
        metrics.received(f"kind {k}", 10)
        metrics.reconnects.inc(f"cause {k}")
    assert len(generate_latest(metrics.registry).splitlines()) == before
    assert value(metrics.registry, "splitslam_edge_dropped_total", reason=OTHER) == 1000


def literals(folder: str, called: str) -> Iterator[str]:
    """First arguments of calls of `called` in the code, where they are written out."""
    for file in sorted((ROOT / folder).rglob("*.py")):
        for node in ast.walk(ast.parse(Path(file).read_text())):
            if isinstance(node, ast.Call) and node.args and isinstance(first := node.args[0], ast.Constant):
                name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
                if name == called and isinstance(first.value, str):
                    yield first.value


def test_every_reason_in_the_code_of_the_edge_has_a_series_of_its_own() -> None:
    reasons = {*literals("edge_agent", "DataError"), *literals("edge_agent", "drop"), "too_many_features"}
    assert len(reasons) > 12
    assert reasons <= set(DROP_REASONS)
    causes = set(literals("edge_agent", "Ending"))
    assert len(causes) > 5
    assert causes <= set(BREAKS)


def test_robots_beyond_the_limit_are_counted_and_those_shown_stay() -> None:
    registry = CollectorRegistry()
    gauges = RobotGauges(2, registry)
    gauges.update(0, [standing("b"), standing("c")])
    shown = ["b", "c"]
    for robots in (["a", "b", "c", "d"], ["c", "d", "b"]):
        gauges.update(0, [standing(robot) for robot in robots])
        assert [robot for robot in "abcd" if value(registry, "splitslam_map_robot_scans", robot=robot) == 7] == shown
        assert value(registry, "splitslam_map_robots_not_shown") == len(robots) - 2
    gauges.update(0, [standing("d")])
    assert value(registry, "splitslam_map_robot_scans", robot="b") is None
    assert value(registry, "splitslam_map_robot_scans", robot="d") == 7
    assert value(registry, "splitslam_map_robots_not_shown") == 0


def test_of_two_runs_of_one_robot_the_one_with_the_newest_scan_is_shown() -> None:
    registry = CollectorRegistry()
    gauges = RobotGauges(10, registry)
    gauges.update(0, [standing("a", "new", stamp_ns=20, scans=5)])
    gauges.update(1, [standing("a", "of before", stamp_ns=10, scans=900)])
    assert value(registry, "splitslam_map_robot_scans", robot="a") == 5


def test_what_a_worker_held_goes_with_it() -> None:
    config = ServiceConfig(workers=2, metrics=MetricsConfig(per_robot=True))
    metrics = ServiceMetrics(config)
    assert metrics.robots is not None
    robots = [standing("a").standing]
    beat = Beat({}, [], 0.0, {}, {"tracking": 1}, [], robots, 9, 40, 12.5, 10**8)
    for worker in (0, 1):
        metrics.absorb(worker, beat, unanswered=3, delay_s=0.5)
        metrics.robots.update(worker, [standing(f"robot {worker}")])
    registry = metrics.registry
    assert value(registry, "splitslam_map_undurable_frames") == 80
    assert value(registry, "splitslam_map_oldest_frame_seconds") == 0.5
    metrics.forget_worker(0)
    assert value(registry, "splitslam_map_undurable_frames") == 40
    assert value(registry, "splitslam_map_sessions", state="tracking") == 1
    assert value(registry, "splitslam_map_worker_resident_memory_bytes", worker="0") == 0
    assert value(registry, "splitslam_map_worker_cpu_seconds_total", worker="0") == 12.5  # a counter never goes back
    assert value(registry, "splitslam_map_robot_scans", robot="robot 0") is None
    assert value(registry, "splitslam_map_robot_scans", robot="robot 1") == 7


def test_without_the_switch_there_are_no_gauges_by_robot() -> None:
    page = generate_latest(ServiceMetrics(ServiceConfig(workers=1)).registry).decode()
    assert not [metric.name for metric in ROBOT_METRICS if metric.name in page]
