"""`source` names exactly one source, and what is misspelt or does not fit is one clear line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from edge_agent.config import AgentConfig
from splitslam.config import dump, load
from splitslam.errors import InputError


def loaded(tmp_path: Path, source: Any) -> AgentConfig:
    path = tmp_path / "edge.yaml"
    path.write_text(yaml.safe_dump({"robot": "robot.yaml", "source": source}))
    return load(AgentConfig, path)


@pytest.mark.parametrize(
    ("source", "line"),
    [
        ({}, "source: expected exactly one of recording, live.*, found none"),
        ({"recording": "a.bag", "live": {}}, "source: expected exactly one of .*, found recording and live"),
        ({"live": {}, "realtime": True}, "source: realtime, max_scans, began_s: expected only with recording"),
        ({"live": {}, "max_scans": 3}, "expected only with recording"),
        (
            {"live": {"lidar": {"udp": {"prot": 2368}}}},
            "udp.prot: unknown key; nearest known: source.live.lidar.udp.port",
        ),
        ({"live": {"gnss": {}}}, "source.live.gnss: expected exactly one of serial, tcp"),
        ({"live": {"gnss": {"tcp": {"host": "gnss.local", "port": 1}}}}, "host: expected an IP address"),
        ({"live": {"imu": {"serial": {}}}}, "source.live.imu.serial.device: must be given"),
        ({"live": {"clock": "ntp"}}, "source.live.clock: .*auto.*gps.*ptp.*host"),
        ({"live": {"apart_s": 0}}, "source.live.apart_s: .*greater than 0"),
    ],
)
def test_what_does_not_fit_is_one_clear_line(source: Any, line: str, tmp_path: Path):
    with pytest.raises(InputError, match=line) as error:
        loaded(tmp_path, source)
    assert "\n" not in str(error.value)


def test_live_sensors_are_by_the_clock_and_the_effective_configuration_is_read_back(tmp_path: Path):
    config = loaded(tmp_path, {"live": {}})
    assert config.source.by_the_clock
    assert config.source.name == "live"
    assert config.source.live is not None
    assert config.source.live.lidar.udp.position_port == 8308
    (tmp_path / "dumped.yaml").write_text(dump(config))
    assert load(AgentConfig, tmp_path / "dumped.yaml") == config


def test_a_recording_is_in_lockstep_unless_it_is_told_to_keep_the_clock(tmp_path: Path):
    assert not loaded(tmp_path, {"recording": "a.bag"}).source.by_the_clock
    assert loaded(tmp_path, {"recording": "a.bag", "realtime": True}).source.by_the_clock


def test_a_key_may_come_by_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "edge.yaml").write_text("robot: robot.yaml\nsource: {live: {}}\n")
    monkeypatch.setenv("SPLITSLAM_EDGE__SOURCE__LIVE__LIDAR__UDP__PORT", "2371")
    config = load(AgentConfig, tmp_path / "edge.yaml", "SPLITSLAM_EDGE")
    assert config.source.live is not None
    assert config.source.live.lidar.udp.port == 2371
