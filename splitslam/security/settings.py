"""The `tls` section of both programs' configuration."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, Self

from pydantic import Field, model_validator

from splitslam.config import Model
from splitslam.security.loopback import is_loopback


class ClientTls(Model):
    """How a robot or a tool proves who it is, and knows the service.

    cert, key: its own certificate and key. ca: the fleet's, which the service's certificate must be of.
    token: file with a token instead of a certificate, or besides. insecure: no TLS although the service is on another
    machine. All files are read anew for each connection: that is how they are rotated.
    """

    cert: Path | None = None
    key: Path | None = None
    ca: Path | None = None
    token: Path | None = None
    server_name: str | None = Field(default=None, description="name in the service's certificate, if not its host")
    insecure: bool = False

    @model_validator(mode="after")
    def _whole(self) -> Self:
        if (self.cert is None) != (self.key is None):
            raise ValueError("cert and key: expected both or neither")
        if self.cert is not None and self.ca is None:
            raise ValueError("ca: expected with cert: the service must prove who it is, too")
        if self.insecure and self.ca is not None:
            raise ValueError("insecure: expected false with ca")
        if self.insecure and self.token is not None:
            raise ValueError("insecure: expected false with token, which anybody on the way could read and use")
        return self

    def check(self, server: str) -> None:
        """Raises ValueError when `server` must not be talked to like this."""
        if self.ca is None and not self.insecure and not is_loopback(server):
            raise ValueError(
                f"server {server} is another machine: expected tls.ca with tls.cert and tls.key (or tls.token), "
                "or tls.insecure: true"
            )
        if self.ca is not None and self.cert is None and self.token is None:
            raise ValueError("tls: expected cert and key, or token: the service wants to know who calls")


class ServerTls(Model):
    """Who the service is and whom it believes (map_service/callers.py).

    cert, key, ca: files, read anew when they change. clients: `token` asks no client for a certificate. tokens: who has
    which (`splitslam certs token`). revoked: certificates that count no more (`splitslam certs revoke`).
    """

    cert: Path | None = None
    key: Path | None = None
    ca: Path | None = None
    clients: Literal["certificate", "token"] = "certificate"
    tokens: Path | None = None
    revoked: Path | None = None
    insecure: bool = Field(default=False, description="no TLS although other machines can connect")

    @model_validator(mode="after")
    def _whole(self) -> Self:
        given = [path is not None for path in (self.cert, self.key, self.ca)]
        if any(given) and not all(given):
            raise ValueError("cert, key and ca: expected all three or none")
        if self.insecure and any(given):
            raise ValueError("insecure: expected false with cert")
        if not any(given) and (self.tokens or self.revoked or self.clients != "certificate"):
            raise ValueError("tokens, revoked, clients: expected only with cert, key and ca")
        if self.clients == "token" and self.tokens is None:
            raise ValueError("tokens: expected with clients: token")
        return self

    @property
    def on(self) -> bool:
        return self.cert is not None

    def check(self, listen: str) -> None:
        """Raises ValueError when `listen` must not be listened on like this."""
        if not self.on and not self.insecure and not is_loopback(listen):
            raise ValueError(
                f"listen {listen}: other machines can connect: expected tls.cert, tls.key and tls.ca, "
                "or tls.insecure: true"
            )
