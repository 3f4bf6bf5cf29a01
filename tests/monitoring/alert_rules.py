"""deploy/prometheus/alerts.yml, read."""

from __future__ import annotations

import re
from dataclasses import dataclass

import yaml

from tests.conftest import ROOT

RULES = ROOT / "deploy" / "prometheus" / "alerts.yml"
_METRIC = re.compile(r"\b(?:up|splitslam_[a-z0-9_]+|[a-z]+:splitslam_[a-z0-9_]+:[a-z0-9_]+)\b(?!=)")


@dataclass(frozen=True, slots=True)
class Rule:
    """name: of the alert or of the recorded series."""

    name: str
    expr: str
    alert: bool
    hold: str
    severity: str
    summary: str
    runbook: str


def rules() -> list[Rule]:
    """All of them, in order."""
    found = []
    for group in yaml.safe_load(RULES.read_text())["groups"]:
        for rule in group["rules"]:
            says = rule.get("annotations", {})
            found.append(
                Rule(
                    rule.get("alert") or rule["record"],
                    rule["expr"],
                    "alert" in rule,
                    rule.get("for", ""),
                    rule.get("labels", {}).get("severity", ""),
                    says.get("summary", ""),
                    says.get("runbook", ""),
                )
            )
    return found


def alerts() -> list[Rule]:
    """Those that wake somebody up."""
    return [rule for rule in rules() if rule.alert]


def metrics_of(expr: str) -> set[str]:
    """The series that an expression asks for, recorded ones included."""
    without_labels = re.sub(r"\{[^}]*\}|\b(?:by|on|ignoring|without)\s*\([^)]*\)", " ", expr)
    return set(_METRIC.findall(without_labels))
