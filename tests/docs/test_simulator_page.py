"""docs/simulator.md's commands, each for the first second of its drive."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from splitslam.cli import app
from tests.conftest import ROOT
from tests.docs.pages import shell_lines

PAGE = "docs/simulator.md"


def test_every_command_of_the_page_works(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    lines = [line.text for line in shell_lines(PAGE, (ROOT / PAGE).read_text())]
    assert len(lines) >= 4
    for line in lines:
        program, *words = shlex.split(line)
        assert program == "splitslam"
        shorter = [] if "--list" in words else ["--seconds", "1"]
        result = CliRunner().invoke(app, [*words, *shorter], catch_exceptions=False)
        assert result.exit_code == 0, (line, result.output)
    drives = {line.split()[2] for line in lines if "--list" not in line}
    assert {path.name for path in Path("out/sim").glob("*.bag")} == {f"{drive}.bag" for drive in drives}
