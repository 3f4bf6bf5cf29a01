"""What a check says: one finding is one clear line."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from enum import StrEnum


class Severity(StrEnum):
    """PROBLEM: to be mended before a run. NOTE: worth knowing, or what could not be tested."""

    PROBLEM = "problem"
    NOTE = "note"


@dataclass(frozen=True, slots=True)
class Finding:
    """where: key of the robot file or topic. what: what was found, with numbers. expected: what should be there."""

    where: str
    what: str
    expected: str
    severity: Severity = Severity.PROBLEM

    @property
    def line(self) -> str:
        """One line for people."""
        return f"{self.where}: {self.what}; expected {self.expected}" if self.expected else f"{self.where}: {self.what}"

    def as_dict(self) -> dict[str, str]:
        """JSON-ready."""
        return asdict(self)


def note(where: str, what: str, expected: str = "") -> Finding:
    """A finding that is no problem."""
    return Finding(where, what, expected, Severity.NOTE)


def problems(findings: Iterable[Finding]) -> list[Finding]:
    """Those that have to be mended."""
    return [finding for finding in findings if finding.severity is Severity.PROBLEM]
