"""Who may do what: robots their own sessions, operators those of their site. Nobody else anything.

| caller | EdgeService, DenseService | Get, Trajectory, StreamMap, PoseGraph, PoseService, WatchScans | List | Delete |
|---|---|---|---|---|
| robot | as itself, at its site | its own sessions | | |
| operator of a site | | of the site | of the site | of the site |
| operator of all sites | | yes | yes | yes |
| anybody, without TLS | yes | yes | yes | yes |
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any
from urllib.parse import unquote

from map_service.callers import Caller, DeniedError
from map_service.following import Scope
from splitslam.wire import session_pb2 as pb

ROUTE_KEY = "splitslam-route-key"
NO_SITE = "-"  # of sessions that name none; no site is called so


def check_robot(caller: Caller, hello: pb.Hello, metadata: Iterable[tuple[str, Any]]) -> None:
    """Whether the caller may open this session; fills in the site. Raises DeniedError."""
    who = caller.identity
    if who is None:
        return
    if who.role != "robot":
        raise DeniedError("not_a_robot", f"{who}: expected a robot")
    if hello.robot_id != who.name:
        raise DeniedError("other_robot", f"hello.robot_id {hello.robot_id[:80]!r}: expected {who.name!r}, who calls")
    if hello.site_id and hello.site_id != who.site:
        raise DeniedError("other_site", f"hello.site_id {hello.site_id[:80]!r}: expected {who.site!r} or nothing")
    for key, value in metadata:
        if key == ROUTE_KEY and unquote(str(value)).partition("/")[0] != who.name:
            raise DeniedError("route_key", f"{ROUTE_KEY}: expected to begin with {who.name}/")
    hello.site_id = who.site


def check_operator(caller: Caller, site_id: str) -> str:
    """The site whose sessions may be listed when `site_id` ("": all) is asked for. Raises DeniedError."""
    who = caller.identity
    if who is None:
        return site_id
    if who.role != "operator":
        raise DeniedError("not_an_operator", f"{who}: expected an operator")
    if who.site and site_id not in ("", who.site):
        raise DeniedError("other_site", f"site {site_id[:80]!r}: {who} is of another")
    return site_id or who.site


def check_follower(caller: Caller, scope: Scope) -> Scope:
    """The sessions of a scope that the caller may follow. Raises DeniedError for a robot or site that it may not.

    Sessions that are named are each asked about as any reader's.
    """
    who = caller.identity
    if who is None or who.role != "robot":
        return Scope(scope.session_ids, scope.robot_ids, check_operator(caller, scope.site_id))
    if scope.site_id not in ("", who.site):
        raise DeniedError("other_site", f"site {scope.site_id[:80]!r}: {who} is of another")
    for robot_id in scope.robot_ids:
        check_reader(caller, robot_id, None)
    return Scope(scope.session_ids, frozenset({who.name}), scope.site_id)


def check_reader(caller: Caller, robot_id: str, site_id: str | None) -> None:
    """Whether the caller may read a session of that robot and site (None: not known yet). Raises DeniedError."""
    who = caller.identity
    if who is not None and who.role == "robot":
        if who.name != robot_id:
            raise DeniedError("other_robot", f"{who}: expected a session of its own")
        return
    check_operator(caller, site_id or "")


def check_watcher(caller: Caller, robot_id: str, site_id: str) -> tuple[str, str | None]:
    """Whom of those asked for the caller may watch: a robot ("": all) and a site (None: all). Raises DeniedError."""
    who = caller.identity
    if who is not None and who.role == "robot":
        if robot_id not in ("", who.name):
            raise DeniedError("other_robot", f"{who}: expected a session of its own")
        return who.name, None
    return robot_id, check_operator(caller, site_id) or None
