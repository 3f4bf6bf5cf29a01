"""docs/paper.md covers the whole paper, and what it and the other documents name is there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.conftest import ROOT
from tests.docs import commands, paper_table
from tests.docs.pages import DOCUMENTS

ROMAN = ("I", "II", "III", "IV", "V", "VI")
NODES = ("Play", "Imu", "Image", "Feature", "Map", "Rviz")
EXPECTED = [
    *(f"Table {number}" for number in ROMAN),
    *(f"Figure {number}" for number in range(1, 13)),
    *(f"Equation {number}" for number in range(1, 4)),
    *(f"Algorithm {number}" for number in range(1, 3)),
    *(f"{name} node" for name in NODES),
]
ROWS = paper_table.read_rows((ROOT / "docs" / "paper.md").read_text())
LINK = re.compile(r"\]\((?!https?://|#)([^)#\s]+)")
PLACE = re.compile(r"\]\((?!https?://)([^)#\s]*)#([^)\s]+)\)")
HEADING = re.compile(r"^#+ (.+)$", re.MULTILINE)
EACH_ROW = pytest.mark.parametrize("row", ROWS, ids=lambda row: row.paper)


def test_each_part_of_the_paper_has_one_row() -> None:
    assert sorted(row.paper for row in ROWS) == sorted(EXPECTED)


@EACH_ROW
def test_a_row_leads_to_code_command_and_test_or_names_the_issue_that_brings_them(row: paper_table.Row) -> None:
    assert row.built or row.issues, f"{row.paper}: neither built nor is there an issue"
    if row.built:
        assert row.code, f"{row.paper} names no code"
        assert row.commands, f"{row.paper} names no command"
        assert row.tests, f"{row.paper} names no test"


@EACH_ROW
def test_the_code_and_the_tests_that_a_row_names_exist(row: paper_table.Row) -> None:
    problems = [problem for reference in row.code + row.tests if (problem := paper_table.problem_with(reference, ROOT))]
    assert not problems
    assert all(test.startswith(("tests/", "fpga_overlay/")) and ":test_" in test for test in row.tests)
    assert not any(code.startswith("tests/") or ":test_" in code for code in row.code)


@EACH_ROW
def test_what_a_row_shows_as_a_command_is_one(row: paper_table.Row) -> None:
    shown = commands.shown_in(" ".join(f"`{command}`" for command in row.commands))
    assert len(shown) == len(row.commands), f"{row.paper}: {row.commands}"
    assert not [problem for command in shown if (problem := commands.problem_with(command))]


@pytest.mark.parametrize("document", DOCUMENTS, ids=str)
def test_every_command_in_a_document_can_be_typed(document: Path) -> None:
    shown = commands.shown_in((ROOT / document).read_text())
    assert not [problem for command in shown if (problem := commands.problem_with(command))]


@pytest.mark.parametrize("document", DOCUMENTS, ids=str)
def test_every_module_and_test_that_a_document_says_to_run_is_there(document: Path) -> None:
    shown = commands.python_in((ROOT / document).read_text())
    assert not [problem for command in shown if (problem := commands.mistake_in(command))]


@pytest.mark.parametrize("document", DOCUMENTS, ids=str)
def test_every_link_and_picture_of_a_document_leads_to_a_file(document: Path) -> None:
    path = ROOT / document
    missing = [target for target in LINK.findall(path.read_text()) if not (path.parent / target).exists()]
    assert not missing


@pytest.mark.parametrize("document", DOCUMENTS, ids=str)
def test_every_link_to_a_place_in_a_document_leads_to_a_heading(document: Path) -> None:
    path = ROOT / document
    places = {(path.parent / target if target else path, place) for target, place in PLACE.findall(path.read_text())}
    missing = [place for target, place in places if target.suffix == ".md" and place not in _anchors(target)]
    assert not missing


def test_the_readme_leads_to_every_page() -> None:
    linked = set(LINK.findall((ROOT / "README.md").read_text()))
    assert {str(page) for page in DOCUMENTS if page.parent.name == "docs"} <= linked


def _anchors(path: Path) -> set[str]:
    """As GitHub makes them: letters, digits, hyphens and underscores in lower case."""
    titles = HEADING.findall(commands.FENCE.sub("", path.read_text()))
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


@pytest.mark.parametrize(
    "reference",
    [
        "splitslam/errors.py:NoSuchError",
        "splitslam/missing.py:f",
        "splitslam/errors.py",
        "splitslam/errors.py:InputError.no_such_method",
    ],
)
def test_a_reference_to_something_that_is_not_there_is_found(reference: str) -> None:
    assert paper_table.problem_with(reference, ROOT)
    assert not paper_table.problem_with("splitslam/errors.py:InputError", ROOT)


@pytest.mark.parametrize(
    "command",
    [
        "splitslam fly",
        "splitslam run R.bag --robto R.yaml",
        "make no-such-target",
        "map-service run",
        "edge-agent serve",
    ],
)
def test_a_command_that_does_not_exist_is_found(command: str) -> None:
    assert commands.shown_in(f"text `{command}` text") == [command]
    assert commands.problem_with(command)
    assert not commands.problem_with("make test")


def test_a_row_that_is_neither_built_nor_planned_is_found() -> None:
    text = "| " + " | ".join(paper_table.HEADER) + " |\n|---|---|---|---|---|---|\n| Table I | x |  |  |  | someday |\n"
    (row,) = paper_table.read_rows(text)
    assert not row.built
    assert not row.issues
