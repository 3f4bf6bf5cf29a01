"""Names of everybody in a fleet, as they stand in a certificate's URI (SPIFFE ids) and in the list of tokens."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal, Self, cast

Role = Literal["robot", "operator", "service", "envoy"]
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,127}")  # of robots and sites: map_service/hello.py
FLEET = re.compile(r"[a-z0-9][a-z0-9._-]{0,62}")
_ID = re.compile(
    rf"spiffe://(?P<fleet>{FLEET.pattern})/"
    rf"(?:(?:site/(?P<site>{NAME.pattern})/)?(?P<role>robot|operator)/(?P<name>{NAME.pattern})|(?P<part>service|envoy))"
)


@dataclass(frozen=True, slots=True)
class Identity:
    """One member of a fleet.

    spiffe://FLEET/site/SITE/robot/NAME
    spiffe://FLEET/site/SITE/operator/NAME, without site: of all sites
    spiffe://FLEET/service, spiffe://FLEET/envoy: what serves, one identity for all replicas
    """

    fleet: str
    role: Role
    name: str = ""
    site: str = ""

    def __post_init__(self) -> None:
        """Raises ValueError for what would not be read back as the same."""
        if self.role == "robot" and not self.site:
            raise ValueError("a robot belongs to a site")
        if not _ID.fullmatch(self.uri):
            raise ValueError(f"{self.uri!r} is not an identity of a fleet")

    @property
    def uri(self) -> str:
        if self.role in ("service", "envoy"):
            return f"spiffe://{self.fleet}/{self.role}"
        site = f"site/{self.site}/" if self.site else ""
        return f"spiffe://{self.fleet}/{site}{self.role}/{self.name}"

    @classmethod
    def parse(cls, uri: str) -> Self:
        """Raises ValueError for anything that is not one of the forms above."""
        match = _ID.fullmatch(uri)
        if match is None:
            raise ValueError(f"{uri[:200]!r} is not an identity of a fleet")
        return cls(match["fleet"], cast(Role, match["role"] or match["part"]), match["name"] or "", match["site"] or "")

    def __str__(self) -> str:
        return self.uri
