"""Alerts fire when they should and not before, and each has a section in the runbook that can be followed."""

from __future__ import annotations

import re
import subprocess

import pytest
import yaml

from deploy.grafana.boards import BOARDS
from tests.conftest import ROOT
from tests.docs import commands
from tests.monitoring.alert_rules import RULES, Rule, alerts, metrics_of, rules
from tests.monitoring.prometheus import binary

CASES = ROOT / "tests" / "monitoring" / "alerts_test.yml"
RUNBOOK = ROOT / "docs" / "runbook.md"
COMPOSE = yaml.safe_load((ROOT / "docker-compose.yml").read_text())
SECTION = re.compile(r"^## (\w+)\n(.*?)(?=^#|\Z)", re.MULTILINE | re.DOTALL)
UNITS = ("edge-agent", "edge-agent.service")
COMPOSE_DOES = ("ps", "logs", "restart", "up")
EACH_ALERT = pytest.mark.parametrize("alert", alerts(), ids=lambda alert: alert.name)


def promtool(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [binary("promtool"), *map(str, arguments)], cwd=CASES.parent, capture_output=True, text=True, timeout=60
    )


def sections() -> dict[str, str]:
    return dict(SECTION.findall(RUNBOOK.read_text()))


def others_problem(command: str) -> str | None:
    """What is wrong with a command of somebody else's program, as far as this repository knows."""
    words = [word for word in command.split() if not word.startswith("-")]
    match words:
        case ["docker", "compose", verb, *names]:
            unknown = [name for name in names if name not in COMPOSE["services"] and "=" not in name]
            return None if verb in COMPOSE_DOES and not unknown else command
        case ["systemctl", verb, *names]:
            return None if verb in ("status", "restart") and names and set(names) <= set(UNITS) else command
        case ["journalctl", *names]:
            return None if names and set(names) <= set(UNITS) else command
    return command


def test_prometheus_takes_the_configuration_and_the_rules() -> None:
    checked = promtool("check", "config", RULES.with_name("prometheus.yml"))
    assert checked.returncode == 0, checked.stdout + checked.stderr
    assert f"{len(rules())} rules found" in checked.stdout


def test_each_alert_fires_in_its_case_with_these_words_and_is_quiet_before() -> None:
    tested = promtool("test", "rules", CASES)
    assert tested.returncode == 0, tested.stdout + tested.stderr
    seen: dict[str, list[bool]] = {}
    for case in yaml.safe_load(CASES.read_text())["tests"]:
        for one in case["alert_rule_test"]:
            seen.setdefault(one["alertname"], []).append("exp_alerts" in one)
    assert {name: set(fires) for name, fires in seen.items()} == {rule.name: {False, True} for rule in alerts()}


@EACH_ALERT
def test_an_alert_says_how_bad_it_is_for_whom_and_where_to_read_on(alert: Rule) -> None:
    assert alert.severity in ("critical", "warning")
    assert alert.hold
    assert alert.summary
    assert alert.runbook == f"docs/runbook.md#{alert.name.lower()}"
    assert metrics_of(alert.expr)


def test_the_runbook_has_a_section_for_each_alert_and_no_other() -> None:
    assert sorted(sections()) == sorted(alert.name for alert in alerts())


@EACH_ALERT
def test_a_section_says_what_it_means_what_to_look_at_and_what_to_do(alert: Rule) -> None:
    text = sections()[alert.name]
    assert [part.split("**")[0] for part in re.split(r"^\*\*", text, flags=re.MULTILINE)[1:]] == ["Means", "Look", "Do"]
    named = set(re.findall(r"\b[A-Z][a-z]+[A-Z]\w+", text)) - {"LiDAR", "PostgreSQL"}
    assert named <= set(sections()), "other alerts that it sends the reader to"


def test_the_panels_that_the_runbook_names_are_on_the_dashboards() -> None:
    spans = {span for span in commands.SPAN.findall(RUNBOOK.read_text()) if span[0].isupper()}
    assert len(spans) > 10
    assert spans <= {panel.title for board in BOARDS.values() for panel in board.panels}


def test_every_command_in_the_runbook_can_be_typed() -> None:
    text = RUNBOOK.read_text()
    ours = commands.shown_in(text)
    others = [span for span in commands.SPAN.findall(text) if span.split()[0] in ("docker", "systemctl", "journalctl")]
    assert len(ours) > 5
    assert len(others) > 5
    problems = [commands.problem_with(command) for command in ours] + [others_problem(command) for command in others]
    assert not [problem for problem in problems if problem]


@pytest.mark.parametrize(
    "command", ["docker compose logs map-service", "systemctl status edge", "journalctl", "docker compose destroy"]
)
def test_a_command_of_another_program_that_names_what_is_not_here_is_found(command: str) -> None:
    assert others_problem(command)
    assert not others_problem("docker compose logs map_service")
