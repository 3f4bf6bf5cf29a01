"""Names in certificates, what the proxy's header is read as, and where TLS is asked for."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge_agent.config import AgentConfig
from map_service.callers import CLAIM, XFCC, Callers, DeniedError, forwarded_caller
from map_service.config import ServiceConfig
from map_service.hello import _NAME as HELLO_NAME
from map_service.revoked import RevokedList
from splitslam import config
from splitslam.errors import InputError
from splitslam.security.identity import NAME, Identity
from splitslam.security.loopback import is_loopback
from splitslam.security.settings import ClientTls, ServerTls

PRINT = "ab" * 32
URI = "spiffe://farm/site/north/robot/rover-1"
names = st.from_regex(NAME, fullmatch=True)
fleets = st.from_regex(r"[a-z0-9][a-z0-9._-]{0,62}", fullmatch=True)


@given(fleets, names, names)
def test_an_identity_is_read_back_as_it_was_written(fleet: str, name: str, site: str) -> None:
    for identity in (
        Identity(fleet, "robot", name, site),
        Identity(fleet, "operator", name, site),
        Identity(fleet, "operator", name),
        Identity(fleet, "service"),
        Identity(fleet, "envoy"),
    ):
        assert Identity.parse(identity.uri) == identity


@given(st.text(alphabet="abz/:.-_%\n robotsitespiffe", max_size=60))
def test_a_text_is_an_identity_only_when_it_is_exactly_one(text: str) -> None:
    try:
        identity = Identity.parse(text)
    except ValueError:
        return
    assert identity.uri == text


@pytest.mark.parametrize(
    "uri",
    [
        "",
        "spiffe://farm",
        "spiffe://farm/robot/rover-1",  # of no site
        "spiffe://farm/site/north/robot/rover-1/",
        "spiffe://farm/site/north/robot/rover-1\n",
        "spiffe://farm/site/north/robot/../service",
        "spiffe://farm/site/north/service",
        "spiffe://FARM/service",
        "https://farm/service",
        " spiffe://farm/service",
    ],
)
def test_what_is_no_identity_is_refused(uri: str) -> None:
    with pytest.raises(ValueError):
        Identity.parse(uri)


def test_names_of_robots_in_certificates_and_in_hello_are_the_same_set() -> None:
    assert NAME.pattern == HELLO_NAME.pattern


@pytest.mark.parametrize(
    "value",
    [
        f"Hash={PRINT};URI={URI}",
        f"By=spiffe://farm/envoy;Hash={PRINT};URI={URI}",
        f'By=spiffe://farm/envoy;Hash={PRINT};Subject="CN=a,\\"b\\"; URI=spiffe://farm/service";URI={URI}',
    ],
)
def test_the_proxys_header_names_one_caller(value: str) -> None:
    caller = forwarded_caller([value])
    assert caller.identity == Identity("farm", "robot", "rover-1", "north")
    assert caller.fingerprint == PRINT


@pytest.mark.parametrize(
    "values",
    [
        [],
        [""],
        ["nonsense"],
        [f"URI={URI}"],
        [f"Hash={PRINT}"],
        [f"Hash=xyz;URI={URI}"],
        [f"Hash={PRINT};Hash={PRINT};URI={URI}"],
        [f"Hash={PRINT};URI={URI},Hash={PRINT};URI={URI}"],
        [f"Hash={PRINT};URI={URI};"],
        [f"Hash={PRINT};Who=me;URI={URI}"],
        [f'Hash={PRINT};Subject="open;URI={URI}'],
        [f"Hash={PRINT};URI={URI}"] * 2,
    ],
)
def test_a_header_that_is_not_as_the_proxy_writes_it_names_nobody(values: list[str]) -> None:
    with pytest.raises(DeniedError) as denied:
        forwarded_caller(values)
    assert denied.value.reason == "bad_xfcc"


@pytest.mark.parametrize("uris", [f"URI={URI};URI={URI}", "URI=spiffe://farm", "URI=", "URI=https://farm/service"])
def test_a_certificate_that_names_nobody_or_two_is_refused(uris: str) -> None:
    with pytest.raises(DeniedError) as denied:
        forwarded_caller([f"Hash={PRINT};{uris}"])
    assert denied.value.reason == "bad_certificate"


class Plain:
    """A call over a connection without a certificate."""

    def __init__(self, *metadata: tuple[str, str]) -> None:
        self._metadata = metadata

    def auth_context(self) -> dict[str, list[bytes]]:
        return {}

    def invocation_metadata(self) -> Any:
        return self._metadata


@pytest.mark.parametrize("key", [XFCC, CLAIM])
def test_who_has_shown_no_certificate_cannot_forward_one(key: str) -> None:
    with pytest.raises(DeniedError) as denied:
        Callers("farm").identify(Plain((key, f"Hash={PRINT};URI={URI}")))
    assert denied.value.reason == "forged_xfcc"


def test_without_tls_nobody_is_asked() -> None:
    assert Callers(None).identify(Plain((XFCC, "x"))).identity is None


def test_a_list_of_revoked_certificates_is_believed_until_a_readable_one_replaces_it(tmp_path: Path) -> None:
    path = tmp_path / "revoked.txt"
    path.write_text(f"# stolen\n{PRINT.upper()}  # rover-1\n")
    revoked = RevokedList(path)
    assert revoked.holds(PRINT)
    path.write_text("nonsense")
    assert revoked.holds(PRINT)
    path.write_text("")
    assert not revoked.holds(PRINT)
    path.write_text("nonsense\n")
    with pytest.raises(InputError, match=r"revoked\.txt: 'nonsense': expected the SHA-256"):
        RevokedList(path)


@pytest.mark.parametrize("address", ["127.0.0.1:1", "127.9.9.9:1", "[::1]:1", "localhost:50051", "localhost"])
def test_loopback_is_known(address: str) -> None:
    assert is_loopback(address)


@pytest.mark.parametrize("address", ["0.0.0.0:1", "[::]:1", ":1", "10.0.0.1:1", "map.example:1", "localhost.example:1"])
def test_everything_else_is_another_machine(address: str) -> None:
    assert not is_loopback(address)


FILES = {"cert": "a", "key": "b", "ca": "c"}


def service(**values: Any) -> ServiceConfig:
    return config.validate(ServiceConfig, values, "map.yaml")


def agent(**values: Any) -> AgentConfig:
    return config.validate(AgentConfig, {"robot": "r", "source": {"recording": "r"}, **values}, "agent.yaml")


def test_other_machines_are_listened_to_with_tls_or_when_it_is_said_in_so_many_words() -> None:
    with pytest.raises(InputError, match=re.escape("map.yaml: listen 0.0.0.0:1: other machines can connect")):
        service(listen="0.0.0.0:1")
    assert service(listen="0.0.0.0:1", tls=FILES).tls.on
    assert not service(listen="0.0.0.0:1", tls={"insecure": True}).tls.on
    assert not service(listen="127.0.0.1:1").tls.on


def test_other_machines_are_talked_to_with_tls_or_when_it_is_said_in_so_many_words() -> None:
    with pytest.raises(InputError, match=re.escape("agent.yaml: server map.example:1 is another machine")):
        agent(server="map.example:1")
    assert agent(server="map.example:1", tls=FILES).tls.cert == Path("a")
    assert agent(server="map.example:1", tls={"ca": "c", "token": "t"}).tls.token == Path("t")
    assert agent(server="map.example:1", tls={"insecure": True}).tls.insecure
    assert agent(server="127.0.0.1:1").tls == ClientTls()


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"cert": "a"}, "cert and key: expected both"),
        ({"cert": "a", "key": "b"}, "ca: expected with cert"),
        ({"ca": "c"}, "expected cert and key, or token"),
        ({"insecure": True, "ca": "c"}, "insecure: expected false with ca"),
        ({"insecure": True, "token": "t"}, "anybody on the way"),
        ({"token": "t"}, "is another machine"),
    ],
)
def test_half_a_configuration_of_the_robot_is_an_error_that_says_what_is_missing(values: Any, text: str) -> None:
    with pytest.raises(InputError, match=text):
        agent(server="map.example:1", tls=values)


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"cert": "a", "key": "b"}, "expected all three or none"),
        ({**FILES, "insecure": True}, "insecure: expected false with cert"),
        ({"tokens": "t"}, "expected only with cert, key and ca"),
        ({**FILES, "clients": "token"}, "tokens: expected with clients: token"),
    ],
)
def test_half_a_configuration_of_the_service_is_an_error_that_says_what_is_missing(values: Any, text: str) -> None:
    with pytest.raises(InputError, match=text):
        service(tls=values)


def test_defaults_hold_together() -> None:
    assert (ServerTls().on, ClientTls().insecure) == (False, False)
