"""`splitslam certs ...`: certificates and tokens of a fleet. Set-up step by step: docs/security.md."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from splitslam.errors import InputError

if TYPE_CHECKING:
    from splitslam.security.authority import Authority, Issued
    from splitslam.security.identity import Identity, Role

Folder = Annotated[Path, typer.Option("--folder", metavar="DIR", help="The fleet's authority.")]
Days = Annotated[float, typer.Option("--days", min=0.0, help="How long it is valid.")]
Hosts = Annotated[list[str], typer.Option("--host", metavar="NAME", help="Name or address that clients connect to.")]
Site = Annotated[str, typer.Option("--site", metavar="SITE", help="The site.")]
Force = Annotated[bool, typer.Option("--force", help="Replace one that is valid; that one is not revoked by it.")]
FOLDER = Path("certs")

certs = typer.Typer(help="A private certificate authority for a fleet.", no_args_is_help=True)


@certs.command()
def init(
    fleet: Annotated[str, typer.Option(metavar="FLEET", help="Name of the fleet, such as farm.example.")],
    folder: Folder = FOLDER,
    days: Days = 3650,
) -> None:
    """Make the authority. Whoever has its ca.key can be anybody: keep the folder off the network."""
    from splitslam.security.authority import Authority

    authority = Authority.make(folder, fleet, days)
    print(f"{folder}: authority of fleet {authority.fleet}")


@certs.command()
def robot(name: str, site: Site, folder: Folder = FOLDER, days: Days = 365, force: Force = False) -> None:
    """For a robot: it may open sessions as NAME, at its site."""
    _issue(folder, "robot", days, force, name=name, site=site)


@certs.command()
def operator(
    name: str,
    site: Annotated[str, typer.Option("--site", metavar="SITE", help="Of one site; without, of all.")] = "",
    folder: Folder = FOLDER,
    days: Days = 90,
    force: Force = False,
) -> None:
    """For a person or a tool: list, read and delete sessions."""
    _issue(folder, "operator", days, force, name=name, site=site)


@certs.command()
def service(host: Hosts, folder: Folder = FOLDER, days: Days = 365, force: Force = False) -> None:
    """For the map services, one for all replicas."""
    _issue(folder, "service", days, force, hosts=host)


@certs.command()
def envoy(host: Hosts, folder: Folder = FOLDER, days: Days = 365, force: Force = False) -> None:
    """For the proxy: what it says of who called is believed."""
    _issue(folder, "envoy", days, force, hosts=host)


@certs.command()
def token(
    name: str,
    site: Annotated[str, typer.Option("--site", metavar="SITE", help="The site; an operator's may be left out.")] = "",
    is_operator: Annotated[bool, typer.Option("--operator", help="Of an operator instead of a robot.")] = False,
    folder: Folder = FOLDER,
) -> None:
    """Print a new token, once; its hash goes into tokens.yaml. The one of before counts no more."""
    authority = _authority(folder)
    print(authority.token(_identity(authority, "operator" if is_operator else "robot", name, site)))


@certs.command()
def renew(
    files: Annotated[list[Path] | None, typer.Argument(metavar="FILE.pem...", help="Default: all that is due.")] = None,
    within: Annotated[float, typer.Option(metavar="DAYS", help="Due is what expires within so many.")] = 30,
    days: Annotated[float | None, typer.Option(min=0.0, help="Valid for; default: as long as before.")] = None,
    folder: Folder = FOLDER,
) -> None:
    """New certificates with new keys for the same identities; programs take them up by themselves."""
    authority = _authority(folder)
    if files:
        due = [authority.read(path) for path in files]
    else:
        latest = datetime.now(UTC) + timedelta(days=within)
        due = [issued for issued in authority.issued() if issued.identity is not None and issued.expires < latest]
    for issued in due:
        _say(authority.renew(issued, days))
    if not due:
        print(f"nothing expires within {within:g} days")


@certs.command()
def revoke(file: Annotated[Path, typer.Argument(metavar="FILE.pem")], folder: Folder = FOLDER) -> None:
    """Write a certificate into revoked.txt: services that read it take it no more."""
    authority = _authority(folder)
    issued = authority.read(file)
    if issued.identity is None:
        raise InputError(f"{file}: expected not the authority")
    authority.revoke(issued)
    print(f"{issued.identity}: {issued.fingerprint} revoked")


@certs.command()
def show(
    folder: Folder = FOLDER,
    within: Annotated[float, typer.Option(metavar="DAYS", help="Exit code 1 when one expires within so many.")] = 14,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object each line.")] = False,
) -> None:
    """What there is and when it expires."""
    latest = datetime.now(UTC) + timedelta(days=within)
    late = False
    for issued in _authority(folder).issued():
        late |= issued.expires < latest
        if as_json:
            who = None if issued.identity is None else issued.identity.uri
            line = {"file": str(issued.path), "identity": who, "expires": issued.expires.isoformat()}
            print(json.dumps(line | {"sha256": issued.fingerprint}))
        else:
            _say(issued)
    if late:
        raise typer.Exit(1)


def _authority(folder: Path) -> Authority:
    from splitslam.security.authority import Authority

    return Authority(folder)


def _identity(authority: Authority, role: Role, name: str = "", site: str = "") -> Identity:
    from splitslam.security.identity import NAME, Identity

    for option, value in (("NAME", name), ("--site", site)):
        if value and not NAME.fullmatch(value):
            raise InputError(f"{option} {value!r}: expected 1 to 128 letters, digits, . _ -, a letter or digit first")
    try:
        return Identity(authority.fleet, role, name, site)
    except ValueError as error:
        raise InputError(str(error)) from None


def _issue(
    folder: Path, role: Role, days: float, force: bool, name: str = "", site: str = "", hosts: list[str] | None = None
) -> None:
    authority = _authority(folder)
    identity = _identity(authority, role, name, site)
    if not force and (there := authority.valid(identity)) is not None:
        raise InputError(
            f"{there.path}: is there already, valid until {there.expires:%Y-%m-%d}"
            f" (`splitslam certs renew {there.path}` renews it, --force replaces it)"
        )
    _say(authority.issue(identity, days, hosts or []))


def _say(issued: Issued) -> None:
    left = issued.expires - datetime.now(UTC)
    who = "authority" if issued.identity is None else issued.identity.uri
    print(f"{issued.path}  {who}  expires {issued.expires:%Y-%m-%d}, in {left.total_seconds() / 86400:.0f} days")
