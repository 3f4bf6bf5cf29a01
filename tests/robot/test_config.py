"""Configuration: YAML, then the environment over it, then one clear line for what is wrong."""

from __future__ import annotations

from pathlib import Path

import pytest

from splitslam.config import Model, dump, load
from splitslam.errors import InputError


class Uplink(Model):
    max_kbps: float | None = None
    buffer_bytes: int = 1000


class Pipeline(Model):
    deskew: str = "auto"
    fast: bool = False


class Agent(Model):
    robot: Path | None = None
    uplink: Uplink = Uplink()
    pipeline: Pipeline = Pipeline()
    disable: tuple[str, ...] = ()


PREFIX = "SPLITSLAM_EDGE"


@pytest.fixture
def write(tmp_path):
    def _write(text: str) -> Path:
        path = tmp_path / "agent.yaml"
        path.write_text(text)
        return path

    return _write


def test_no_file_gives_the_defaults():
    assert load(Agent, None) == Agent()


def test_the_environment_goes_over_the_file_key_by_key(write, monkeypatch):
    monkeypatch.setenv("SPLITSLAM_EDGE__UPLINK__MAX_KBPS", "1500")
    monkeypatch.setenv("SPLITSLAM_EDGE__DISABLE", "[loops, gnss]")
    path = write("uplink: {max_kbps: 3, buffer_bytes: 7}")
    agent = load(Agent, path, PREFIX)
    assert agent.uplink == Uplink(max_kbps=1500, buffer_bytes=7)
    assert agent.disable == ("loops", "gnss")
    assert load(Agent, path).uplink.max_kbps == 3


def test_off_is_a_word_and_an_exponent_is_a_number(write):
    agent = load(Agent, write("pipeline: {deskew: off, fast: true}\nuplink: {max_kbps: 1e3}"))
    assert agent.pipeline == Pipeline(deskew="off", fast=True)
    assert agent.uplink.max_kbps == 1000.0


def test_what_is_printed_can_be_loaded(write):
    agent = Agent(robot=Path("a b.yaml"), disable=("off", "1"), pipeline=Pipeline(deskew="off"))
    assert load(Agent, write(dump(agent))) == agent


def test_an_unknown_variable_names_the_nearest(monkeypatch):
    monkeypatch.setenv("SPLITSLAM_EDGE__UPLINK__MAX_KPBS", "1")
    with pytest.raises(InputError, match=r"UPLINK__MAX_KPBS: unknown key; nearest known: .*UPLINK__MAX_KBPS"):
        load(Agent, None, PREFIX)


def test_a_wrong_value_names_file_key_and_value(write):
    path = write("uplink: {max_kbps: fast}")
    with pytest.raises(InputError, match=r"agent.yaml: uplink.max_kbps: .*valid number.*found 'fast'"):
        load(Agent, path)


def test_a_config_cannot_be_changed():
    with pytest.raises(ValueError, match="frozen"):
        Agent().disable = ("x",)  # type: ignore[misc]
