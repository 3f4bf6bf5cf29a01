"""No secret gets through, and what is none does."""

from __future__ import annotations

from pathlib import Path

import pytest

from edge_agent.config import AgentConfig
from map_service.config import ServiceConfig
from splitslam.redact import GONE, Redactor, is_secret_name

SECRET = "h0rse-battery+staple"


@pytest.mark.parametrize(
    "name", ["password", "token", "api_key", "apiKey", "TLS_KEY_PASSWORD", "SPLITSLAM_EDGE__AUTH__TOKEN", "x.secret"]
)
def test_a_name_says_that_its_value_is_a_secret(name: str):
    assert is_secret_name(name)
    assert Redactor().mapping({name: SECRET, "other": {name: [SECRET]}}) == {name: GONE, "other": {name: [GONE]}}


@pytest.mark.parametrize("name", ["keyframe_points", "monkey", "compass", "spinning", "author", "max_kbps"])
def test_a_name_that_only_contains_such_a_word_does_not(name: str):
    assert not is_secret_name(name)


@pytest.mark.parametrize(
    "text",
    [
        "postgresql://robot:{}@rack/maps",
        "https://{}@host/path",
        "Authorization: Bearer {}",
        '{{"token": "{}", "x": 1}}',
        "--password={} --next",
        "key_password: '{}'",
        "-----BEGIN EC PRIVATE KEY-----\n{}\n-----END EC PRIVATE KEY-----",
        "-----BEGIN PRIVATE KEY-----\n{}",
    ],
)
def test_what_looks_like_a_secret_in_a_text_is_taken_out_unseen_before(text: str):
    assert SECRET in text.format(SECRET)
    clean = Redactor().text(text.format(SECRET))
    assert SECRET not in clean
    assert GONE in clean


def test_a_secret_that_was_seen_once_is_known_everywhere_also_percent_encoded():
    redactor = Redactor()
    redactor.mapping({"store": "postgresql://robot:p%40ss-word@rack/maps", "operator": {"token": SECRET}})
    assert redactor.text(f"tried {SECRET} and p@ss-word and p%40ss-word") == f"tried {GONE} and {GONE} and {GONE}"


def test_where_a_key_lies_is_no_secret_and_short_values_do_not_eat_the_text(tmp_path: Path):
    file = tmp_path / "robot"
    file.touch()
    tls = {"key": "/etc/splitslam/robot.key", "token": str(file), "pin": "1"}
    data = {"tls": tls, "keys": None, "auth": True, "reset_keys": 100}
    clean = Redactor().mapping(data)
    assert clean == {**data, "tls": {**tls, "pin": GONE}}
    redactor = Redactor()
    redactor.mapping({"pin": "1"})
    assert redactor.text("101 of 111") == "101 of 111"


@pytest.mark.parametrize("config", [AgentConfig.model_construct(), ServiceConfig()], ids=["agent", "service"])
def test_nothing_of_our_own_defaults_is_a_secret(config: AgentConfig | ServiceConfig):
    plain = config.model_dump(mode="json")
    assert GONE not in str(Redactor().mapping(plain))
