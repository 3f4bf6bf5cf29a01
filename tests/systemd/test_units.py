"""The unit files are understood by systemd to the last key, and open no more than they must."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests import tolerances as bars
from tests.systemd.unit import UNITS, analyze, exposure, placed, read_unit

AGENT, SERVICE = "edge-agent.service", "map-service.service"
FPGA, REALTIME, SERIAL = "fpga.conf", "realtime.conf", "serial.conf"
EACH = pytest.mark.parametrize(
    ("name", "drop_ins"),
    [
        *((AGENT, drop_ins) for drop_ins in ((), (FPGA,), (REALTIME,), (SERIAL,), (FPGA, REALTIME, SERIAL))),
        (SERVICE, ()),
    ],
)


@pytest.fixture
def executables(tmp_path: Path) -> Path:
    folder = tmp_path / "bin"
    folder.mkdir()
    for name in ("edge-agent", "map-service"):
        (folder / name).write_text("#!/bin/sh\n")
        (folder / name).chmod(0o755)
    return folder


@EACH
def test_systemd_has_nothing_to_say_about_a_unit(
    name: str, drop_ins: tuple[str, ...], executables: Path, tmp_path: Path
):
    verified = analyze("verify", placed(name, tmp_path, executables, drop_ins))
    assert (verified.returncode, verified.stderr + verified.stdout) == (0, "")


def test_an_unknown_key_would_be_seen(executables: Path, tmp_path: Path):
    unit = placed(AGENT, tmp_path, executables)
    unit.write_text(unit.read_text() + "\n[Service]\nWatchdogSecs=10\n")
    assert "WatchdogSecs" in analyze("verify", unit).stderr


@pytest.mark.parametrize(
    ("name", "drop_ins", "bar"),
    [
        (AGENT, (), bars.UNIT_EXPOSURE),
        (AGENT, (REALTIME,), bars.UNIT_EXPOSURE),
        (AGENT, (SERIAL,), bars.UNIT_EXPOSURE),
        (AGENT, (FPGA,), bars.UNIT_EXPOSURE_FPGA),
        (SERVICE, (), bars.UNIT_EXPOSURE),
    ],
)
def test_a_unit_is_exposed_no_more_than_it_may_be(
    name: str, drop_ins: tuple[str, ...], bar: float, executables: Path, tmp_path: Path
):
    found = exposure(placed(name, tmp_path, executables, drop_ins))
    print(f"{name} {drop_ins}: {found}")
    assert found <= bar


@pytest.mark.parametrize("drop_in", [FPGA, SERIAL])
def test_a_drop_in_for_devices_opens_more_and_says_for_each_key_why(drop_in: str, executables: Path, tmp_path: Path):
    closed = exposure(placed(AGENT, tmp_path, executables))
    assert exposure(placed(AGENT, tmp_path, executables, (drop_in,))) > closed
    reason = False
    unexplained = []
    for line in (UNITS / f"{AGENT}.d" / drop_in).read_text().partition("[Service]")[2].splitlines():
        if line.startswith("#"):
            reason = True
        elif not line:
            reason = False
        elif not reason:
            unexplained.append(line)
    assert not unexplained


def test_a_bad_configuration_is_not_started_again_and_a_lost_session_is():
    from edge_agent.supervisor import SessionOverError
    from splitslam.errors import InputError

    unit = read_unit(UNITS / AGENT)
    never = {int(code) for code in unit.one("RestartPreventExitStatus").split()}
    assert unit.one("Restart") == "on-failure"
    assert InputError.exit_code in never
    assert SessionOverError.exit_code not in never | {0}
