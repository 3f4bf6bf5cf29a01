"""The dashboards that Grafana is given: as the code says, whole, and honest about what is not there."""

from __future__ import annotations

import json
import re
from itertools import combinations
from typing import Any

import pytest
import yaml

from deploy.grafana.boards import BOARDS
from deploy.grafana.boards.build import as_json
from deploy.grafana.boards.panel import COLUMNS
from edge_agent.metric_list import EDGE_METRICS
from map_service.metric_list import MAP_METRICS
from splitslam.metrics import BUILD_INFO
from splitslam.metrics.definition import Kind, Metric
from tests.conftest import ROOT
from tests.monitoring.alert_rules import metrics_of, rules

GRAFANA = ROOT / "deploy" / "grafana"
EACH_BOARD = pytest.mark.parametrize("name", BOARDS)
METRICS = (*EDGE_METRICS, *MAP_METRICS, BUILD_INFO)
UNITS = {"short", "s", "bytes", "Bps", "bps", "cps", "percentunit"}
SELECTOR = re.compile(r"(splitslam_[a-z0-9_]+)\{([^}]*)\}")


def board(name: str) -> dict[str, Any]:
    return json.loads((GRAFANA / "dashboards" / name).read_text())


def panels(name: str) -> list[dict[str, Any]]:
    return [panel for panel in board(name)["panels"] if panel["type"] != "row"]


def series_of(metric: Metric) -> set[str]:
    suffixes = ("_bucket", "_sum", "_count") if metric.kind == Kind.HISTOGRAM else ("",)
    return {f"{metric.shown}{suffix}" for suffix in suffixes}


def test_the_files_are_what_the_code_makes_and_no_other_lies_there() -> None:
    for name, made in BOARDS.items():
        assert (GRAFANA / "dashboards" / name).read_text() == as_json(made), "run: python -m deploy.grafana.boards"
    assert {path.name for path in (GRAFANA / "dashboards").iterdir()} == set(BOARDS)


@EACH_BOARD
def test_panels_lie_side_by_side_within_the_page_and_fill_their_rows(name: str) -> None:
    places = [panel["gridPos"] for panel in board(name)["panels"]]
    assert all(p["x"] >= 0 and p["x"] + p["w"] <= COLUMNS for p in places)
    for a, b in combinations(places, 2):
        beside = a["x"] + a["w"] <= b["x"] or b["x"] + b["w"] <= a["x"]
        assert beside or a["y"] + a["h"] <= b["y"] or b["y"] + b["h"] <= a["y"], (a, b)
    for y in {p["y"] for p in places}:
        assert sum(p["w"] for p in places if p["y"] == y) == COLUMNS, f"a hole in line {y}"


@EACH_BOARD
def test_every_panel_says_what_it_is_in_which_unit_and_has_its_source(name: str) -> None:
    source = yaml.safe_load((GRAFANA / "provisioning/datasources/prometheus.yaml").read_text())["datasources"][0]
    numbers = [panel["id"] for panel in board(name)["panels"]]
    assert len(set(numbers)) == len(numbers)
    for panel in panels(name):
        assert panel["title"]
        assert panel["description"]
        assert panel["datasource"]["uid"] == source["uid"]
        assert panel["targets"]
        if panel["type"] in ("timeseries", "stat"):
            assert panel["fieldConfig"]["defaults"]["unit"] in UNITS
        if panel["type"] == "timeseries":
            assert all(target["legendFormat"] for target in panel["targets"])


@EACH_BOARD
def test_no_query_hides_that_there_is_nothing(name: str) -> None:
    """`or vector(0)` draws a zero where the metric is gone, as after a rename."""
    for panel in panels(name):
        for target in panel["targets"]:
            assert not re.search(r"\bor\b|\bvector\b|\babsent", target["expr"]), target["expr"]


@EACH_BOARD
def test_variables_are_used_and_those_that_are_used_exist(name: str) -> None:
    queries = " ".join(target["expr"] for panel in panels(name) for target in panel["targets"])
    used = set(re.findall(r"\$(\w+)", queries)) - {"__rate_interval"}
    assert used == {variable["name"] for variable in board(name).get("templating", {}).get("list", [])}


@pytest.mark.parametrize("place", [*BOARDS, "alerts.yml"])
def test_only_metrics_labels_and_values_that_the_programs_have_are_asked_for(place: str) -> None:
    """Where a series cannot exist, a panel that a real run fills today is empty for one robot and nobody knows."""
    known = {name: metric for metric in METRICS for name in series_of(metric)}
    recorded = {rule.name for rule in rules() if not rule.alert} | {"up"}
    queries = (
        [rule.expr for rule in rules()]
        if place == "alerts.yml"
        else [query.expr for panel in BOARDS[place].panels for query in panel.queries]
    )
    for query in queries:
        assert metrics_of(query) - recorded <= set(known), query
        for name, selector in SELECTOR.findall(query):
            labels = {label.name: label for label in known[name].labels}
            for label, how, value in re.findall(r'(\w+)(=~|!~|!=|=)"([^"]*)"', selector):
                if label in ("robot", "instance", "job"):
                    continue
                assert label in labels, f"{query}: {name} has no label {label}"
                for pattern in value.split("|") if "~" in how else [re.escape(value)]:
                    possible = any(re.fullmatch(pattern, one) for one in labels[label].values)
                    assert possible, f"{query}: {name} never has {label} {pattern}"


def test_grafana_looks_for_the_files_where_they_are_mounted() -> None:
    (provider,) = yaml.safe_load((GRAFANA / "provisioning/dashboards/splitslam.yaml").read_text())["providers"]
    services = yaml.safe_load((ROOT / "docker-compose.yml").read_text())["services"]
    if "grafana" in services:
        mounted = [str(volume).split(":")[:2] for volume in services["grafana"]["volumes"]]
        assert ["./deploy/grafana/dashboards", provider["options"]["path"]] in mounted
    links = [
        panel for name in BOARDS for panel in re.findall(r"/d/([\w-]+)", (GRAFANA / "dashboards" / name).read_text())
    ]
    assert set(links) <= {made.uid for made in BOARDS.values()}
    assert links
