"""Who is let in, who is not, and that each refusal is counted under its own reason: real proxy, real service."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import pytest

from splitslam.errors import InputError
from splitslam.security.authority import Authority
from splitslam.security.identity import Identity
from splitslam.stack.process import wait_until
from tests.edge_agent.test_uplink import PATIENT, uplink_to
from tests.map_service.harness import new_run
from tests.security.fleet import FLEET, Client, Fleet, fleet_of, rise_of, rises

NORTH, SOUTH = "north", "south"
FORGED = ("x-forwarded-client-cert", f"Hash={'0' * 64};URI=spiffe://{FLEET}/site/{NORTH}/robot/rover-2")


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    with fleet_of(tmp_path_factory.mktemp("fleet")) as running:
        yield running


@pytest.fixture(scope="module")
def stored(fleet: Fleet) -> str:
    """A session of rover-2, north."""
    run_id = new_run()
    assert (
        Client(fleet.envoy.address, fleet.tls(fleet.certificate("robot", "rover-2", NORTH))).drive("rover-2", run_id)
        == ""
    )
    return f"rover-2/{run_id}"


def robot(fleet: Fleet, *metadata: tuple[str, str], name: str = "rover-1", address: str = "") -> Client:
    issued = fleet.certificate("robot", name, NORTH)
    return Client(address or fleet.envoy.address, fleet.tls(issued), metadata)


def operator(fleet: Fleet, site: str = "", name: str = "") -> Client:
    issued = fleet.certificate("operator", name or f"of-{site or 'all'}", site)
    return Client(fleet.envoy.address, fleet.tls(issued))


def stranger(fleet: Fleet) -> Client:
    """Of an authority of its own that calls itself like ours."""
    folder = fleet.folder / "strangers"
    authority = Authority(folder) if folder.exists() else Authority.make(folder, FLEET, 5)
    issued = authority.issue(Identity(FLEET, "robot", "rover-1", NORTH), 5)
    return Client(fleet.envoy.address, fleet.tls(issued))


def expired(fleet: Fleet) -> Client:
    issued = fleet.authority.issue(Identity(FLEET, "robot", "rover-old", NORTH), -0.0001)
    return Client(fleet.envoy.address, fleet.tls(issued))


def revoked(fleet: Fleet) -> Client:
    issued = fleet.certificate("robot", "rover-stolen", NORTH)
    fleet.authority.revoke(issued)
    return Client(fleet.envoy.address, fleet.tls(issued))


def with_token(fleet: Fleet, token: str, name: str = "", address: str = "") -> Client:
    issued = fleet.certificate("robot", name, NORTH) if name else None
    return Client(address or fleet.token_envoy.address, fleet.tls(issued, token))


def token_of(fleet: Fleet, name: str) -> str:
    return fleet.authority.token(Identity(FLEET, "robot", name, NORTH))


def replaced_token(fleet: Fleet) -> str:
    old = token_of(fleet, "rover-t3")
    token_of(fleet, "rover-t3")
    return old


def as_proxy(fleet: Fleet, *metadata: tuple[str, str]) -> Client:
    """With the proxy's own key, straight to the service."""
    issued = fleet.authority.read(fleet.authority.folder / "envoy.pem")
    return Client(fleet.replica.address, fleet.tls(issued), metadata)


def as_proxy_itself(fleet: Fleet) -> Client:
    """With the proxy's own key, by way of the proxy."""
    return Client(fleet.envoy.address, fleet.tls(fleet.authority.read(fleet.authority.folder / "envoy.pem")))


def as_service(fleet: Fleet) -> Client:
    issued = fleet.authority.read(fleet.authority.folder / "service.pem")
    return Client(fleet.envoy.address, fleet.tls(issued))


@dataclass(frozen=True)
class Row:
    """`attempt` is refused, and the counter `reason` rises, no other."""

    what: str
    reason: str
    attempt: Callable[[Fleet, str], str]


ROWS = [
    # the proxy ends these at the handshake
    Row("no certificate", "envoy no_certificate", lambda f, s: Client(f.envoy.address, f.tls()).drive("rover-1")),
    Row("wrong authority", "envoy unknown_authority", lambda f, s: stranger(f).drive("rover-1")),
    Row("expired", "envoy expired", lambda f, s: expired(f).drive("rover-old")),
    Row("a service's certificate", "envoy wrong_purpose", lambda f, s: as_service(f).drive("rover-1")),
    # the service
    Row("revoked", "revoked", lambda f, s: revoked(f).drive("rover-stolen")),
    Row("another robot's id", "other_robot", lambda f, s: robot(f).drive("rover-2")),
    Row("another robot's session", "other_robot", lambda f, s: robot(f).drive("rover-2", s.partition("/")[2])),
    Row(
        "another robot's route key",
        "route_key",
        lambda f, s: robot(f, ("splitslam-route-key", f"{s}#0")).drive("rover-1"),
    ),
    Row("another site", "other_site", lambda f, s: robot(f).drive("rover-1", site_id=SOUTH)),
    Row("operator as robot", "not_a_robot", lambda f, s: operator(f, NORTH, "rover-1").drive("rover-1")),
    Row("another robot's scan", "other_robot", lambda f, s: robot(f).upload("rover-2", s.partition("/")[2])),
    Row("another site's scan", "other_site", lambda f, s: robot(f).upload("rover-1", site_id=SOUTH)),
    Row("operator sends scans", "not_a_robot", lambda f, s: operator(f, NORTH, "rover-1").upload("rover-1")),
    Row("the proxy sends scans", "not_a_robot", lambda f, s: as_proxy_itself(f).upload("rover-1")),
    Row("robot lists", "not_an_operator", lambda f, s: robot(f).sessions()[1]),
    Row("robot deletes its own", "not_an_operator", lambda f, s: robot(f, name="rover-2").delete(s)),
    Row("robot reads another's", "other_robot", lambda f, s: robot(f).get(s)),
    Row("robot reads another's way", "other_robot", lambda f, s: robot(f).trajectory(s)),
    Row("robot reads another's map", "other_robot", lambda f, s: robot(f).stream_map(s)),
    Row("robot follows another's", "other_robot", lambda f, s: robot(f).watch_poses(session_ids=[s])[1]),
    Row("robot follows another", "other_robot", lambda f, s: robot(f).watch_poses(robot_ids=["rover-2"])[1]),
    Row("robot follows another site", "other_site", lambda f, s: robot(f).events(site_id=SOUTH)[1]),
    Row("robot hears of another's", "other_robot", lambda f, s: robot(f).events(session_ids=[s])[1]),
    Row("robot asks where another was", "other_robot", lambda f, s: robot(f).pose_at(s)),
    Row("robot reads another's surroundings", "other_robot", lambda f, s: robot(f).local_map(s)),
    Row("other operator follows", "other_site", lambda f, s: operator(f, SOUTH).watch_poses(session_ids=[s])[1]),
    Row("other operator follows the site", "other_site", lambda f, s: operator(f, SOUTH).watch_poses(site_id=NORTH)[1]),
    Row("other operator hears of it", "other_site", lambda f, s: operator(f, SOUTH).events(session_ids=[s])[1]),
    Row("other operator asks where", "other_site", lambda f, s: operator(f, SOUTH).pose_at(s)),
    Row("other operator's surroundings", "other_site", lambda f, s: operator(f, SOUTH).local_map(s)),
    Row("the proxy follows", "not_an_operator", lambda f, s: as_proxy_itself(f).watch_poses()[1]),
    Row("other operator lists", "other_site", lambda f, s: operator(f, SOUTH).sessions(NORTH)[1]),
    Row("other operator reads", "other_site", lambda f, s: operator(f, SOUTH).get(s)),
    Row("other operator reads map", "other_site", lambda f, s: operator(f, SOUTH).stream_map(s)),
    Row("other operator deletes", "other_site", lambda f, s: operator(f, SOUTH).delete(s)),
    Row("forged XFCC to the proxy", "forged_xfcc", lambda f, s: robot(f, FORGED).drive("rover-2")),
    Row("forged XFCC, own id", "forged_xfcc", lambda f, s: robot(f, FORGED).drive("rover-1")),
    Row(
        "forged XFCC, straight",
        "forged_xfcc",
        lambda f, s: robot(f, FORGED, address=f.replica.address).drive("rover-2"),
    ),
    Row(
        "another fleet",
        "other_fleet",
        lambda f, s: Client(f.envoy.address, f.tls(f.certificate("robot", "x", "y", "z"))).drive("x"),
    ),
    Row("proxy says nothing", "no_identity", lambda f, s: as_proxy(f).drive("rover-1")),
    Row("proxy says nonsense", "bad_xfcc", lambda f, s: as_proxy(f, (FORGED[0], "URI=x")).drive("rover-1")),
    Row(
        "proxy says two", "bad_xfcc", lambda f, s: as_proxy(f, (FORGED[0], f"{FORGED[1]},{FORGED[1]}")).drive("rover-2")
    ),
    # tokens
    Row("neither", "no_identity", lambda f, s: Client(f.token_envoy.address, f.tls()).drive("rover-1")),
    Row("a token of nobody", "bad_token", lambda f, s: with_token(f, "x" * 43).drive("rover-1")),
    Row("a token that was replaced", "bad_token", lambda f, s: with_token(f, replaced_token(f)).drive("rover-t3")),
    Row("another's token", "other_robot", lambda f, s: with_token(f, token_of(f, "rover-t1")).drive("rover-2")),
    Row("a token as operator", "not_an_operator", lambda f, s: with_token(f, token_of(f, "rover-t1")).sessions()[1]),
    Row(
        "a token and another's certificate",
        "identity_conflict",
        lambda f, s: with_token(f, token_of(f, "rover-t1"), "rover-1").drive("rover-1"),
    ),
    Row("forged XFCC with a token", "forged_xfcc", lambda f, s: forged_with_token(f)),
]


def forged_with_token(fleet: Fleet) -> str:
    tls = fleet.tls(None, token_of(fleet, "rover-t1"))
    return Client(fleet.token_envoy.address, tls, (FORGED,)).drive("rover-2")


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.what)
def test_is_refused_and_counted_under_its_own_reason(row: Row, fleet: Fleet, stored: str) -> None:
    before = fleet.counters()
    assert row.attempt(fleet, stored) != "", "it was served"
    assert rise_of(fleet, before, row.reason) == {row.reason}


@pytest.mark.parametrize("who", ["no certificate", "wrong authority", "expired"])
def test_the_service_itself_ends_the_handshakes_that_the_proxy_would(who: str, fleet: Fleet) -> None:
    clients = {
        "no certificate": Client("", fleet.tls()),
        "wrong authority": stranger(fleet),
        "expired": expired(fleet),
    }
    client = clients[who]
    client._address = fleet.replica.address
    name = "splitslam_map_tls_handshakes_total"
    before, handshakes = fleet.counters(), fleet.replica.metrics()[name]
    assert client.drive("rover-1").startswith("UNAVAILABLE")
    wait_until(lambda: fleet.replica.metrics()[name] > handshakes, 30.0, "the handshake counted")
    assert rises(before, fleet.counters()) == set(), "somebody was asked who it is after the handshake"


def test_a_robot_without_tls_hears_why_nobody_answers(fleet: Fleet) -> None:
    impatient = PATIENT.model_copy(update={"connect_timeout_s": 1.0})
    why = "have no `tls`, as here"
    with uplink_to(fleet.replica.address, impatient) as uplink, pytest.raises(InputError, match=why):
        uplink.wait_welcome()


def test_a_robot_drives_and_reads_its_own_session_by_every_way(fleet: Fleet) -> None:
    token = token_of(fleet, "rover-1")
    ways = [
        robot(fleet),
        robot(fleet, address=fleet.replica.address),
        robot(fleet, address=fleet.token_envoy.address),
        with_token(fleet, token),
        with_token(fleet, token, "rover-1", fleet.envoy.address),
    ]
    before = fleet.counters()
    for way in ways:
        run_id = new_run()
        assert way.drive("rover-1", run_id) == ""
        session = f"rover-1/{run_id}"
        assert (way.get(session), way.trajectory(session), way.stream_map(session)) == ("", "", "")
    assert rises(before, fleet.counters()) == set()


def test_an_operator_sees_and_deletes_the_sessions_of_its_site_and_no_others(fleet: Fleet) -> None:
    runs = {}
    for site, name in ((NORTH, "rover-n"), (SOUTH, "rover-s")):
        run_id = new_run()
        tls = fleet.tls(fleet.certificate("robot", name, site))
        assert Client(fleet.envoy.address, tls).drive(name, run_id) == ""  # its site comes from its certificate
        runs[site] = f"{name}/{run_id}"
    everywhere, north = operator(fleet), operator(fleet, NORTH)
    assert set(runs.values()) <= everywhere.sessions()[0]
    assert runs[NORTH] in north.sessions()[0]
    assert runs[SOUTH] not in north.sessions()[0]
    assert everywhere.sessions(SOUTH)[0] == {runs[SOUTH]}
    assert [north.get(runs[NORTH]), north.trajectory(runs[NORTH]), north.delete(runs[NORTH])] == ["", "", ""]
    assert "NOT_FOUND" in everywhere.get(runs[NORTH])
    assert everywhere.delete(runs[SOUTH]) == ""


def test_nobody_hears_of_sessions_that_he_may_not_read_however_little_he_asks_for(fleet: Fleet, stored: str) -> None:
    runs = {}
    for site, name in ((NORTH, "rover-e"), (SOUTH, "rover-f")):
        run_id = new_run()
        tls = fleet.tls(fleet.certificate("robot", name, site))
        assert Client(fleet.envoy.address, tls).drive(name, run_id) == ""
        runs[site] = f"{name}/{run_id}"
    before = fleet.counters()
    own = robot(fleet, name="rover-e")
    assert own.events() == ({runs[NORTH]}, "")
    assert (own.pose_at(runs[NORTH]), own.local_map(runs[NORTH]), own.watch_poses()[1]) == ("", "", "")
    assert own.watch_poses(session_ids=[runs[NORTH]]) == ({runs[NORTH]}, "")
    heard = set()
    for who in (operator(fleet, NORTH), operator(fleet)):
        assert who.watch_poses(session_ids=[runs[NORTH]])[0] == {runs[NORTH]}
        heard |= who.events(robot_ids=["rover-e"])[0] | who.events(robot_ids=["rover-f"])[0]
    assert heard == set(runs.values())
    assert operator(fleet, NORTH).events(robot_ids=["rover-f"])[0] == set()
    assert stored not in heard
    assert rises(before, fleet.counters()) == set()


def test_the_proxys_certificate_is_no_robots(fleet: Fleet) -> None:
    issued = fleet.authority.read(fleet.authority.folder / "envoy.pem")
    before = fleet.counters()
    assert Client(fleet.envoy.address, fleet.tls(issued)).drive("envoy") != ""
    assert rise_of(fleet, before, "not_a_robot") == {"not_a_robot"}


def test_who_watches_sees_the_scans_of_those_whom_he_may_read_and_of_no_others(fleet: Fleet) -> None:
    issued = {name: fleet.certificate("robot", name, site) for name, site in (("rover-n", NORTH), ("rover-s", SOUTH))}
    robots = {name: Client(fleet.envoy.address, fleet.tls(certificate)) for name, certificate in issued.items()}
    runs = {name: new_run() for name in robots}
    of_n, of_s = (f"{name}/{runs[name]}" for name in robots)
    with (
        robots["rover-n"].watching() as itself,
        operator(fleet, NORTH).watching() as north,
        operator(fleet).watching(robot_id="rover-s") as one,
        operator(fleet).watching() as everything,
    ):
        for name, client in robots.items():
            assert client.drive(name, runs[name], frames=5) == ""
        wanted = {id(itself): {of_n}, id(north): {of_n}, id(one): {of_s}, id(everything): {of_n, of_s}}
        all_of_them = (itself, north, one, everything)
        wait_until(lambda: all(w.sessions >= wanted[id(w)] for w in all_of_them), 30.0, "everybody has seen his own")
        assert [w.sessions for w in all_of_them] == [wanted[id(w)] for w in all_of_them]


def test_nobody_watches_what_is_not_his_to_read(fleet: Fleet) -> None:
    before = fleet.counters()
    asked = [
        (robot(fleet), {"robot_id": "rover-2"}, "PERMISSION_DENIED: other_robot"),
        (operator(fleet, NORTH), {"site_id": SOUTH}, "PERMISSION_DENIED: other_site"),
        (stranger(fleet), {}, "UNAVAILABLE"),
    ]
    for client, filters, reason in asked:
        with client.watching(**filters) as watched:
            assert watched.why.startswith(reason)
            assert not watched.sessions
    rise_of(fleet, before, "other_robot", "other_site")
