"""Every line that a document gives to be typed is typed by a test, or read by whatever would run it."""

from __future__ import annotations

import pytest

from tests.conftest import ROOT
from tests.docs import known, paper_table
from tests.docs.pages import ShellLine, all_shell_lines, shell_lines

LINES = all_shell_lines()


@pytest.mark.parametrize("line", LINES, ids=lambda line: f"{line.page}:{line.number}")
def test_a_line_is_typed_by_a_test_or_read_by_what_would_run_it(line: ShellLine) -> None:
    assert known.problem_with(line) is None


@pytest.mark.parametrize(("place", "test"), known.TYPED_BY.items())
def test_what_is_said_to_type_a_page_is_there_and_so_are_its_lines(place: str, test: str) -> None:
    assert paper_table.problem_with(test, ROOT) is None
    assert [line for line in LINES if place in (line.page, f"{line.page}#{line.heading}")]


def test_nothing_is_excused_that_no_document_has() -> None:
    assert {known.not_in_ci(line.text) for line in LINES} - {None} == set(known.NOT_IN_CI)


@pytest.mark.parametrize(
    "text",
    [
        "splitslam fly",
        "splitslam run drive.bag --robot robot.yaml",  # --out is missing
        "splitslam run drive.bag --robot robot.yaml --out results --max-scans many",
        "splitslam check drive.bag --robto robot.yaml",
        ".venv/bin/map-service serve extra",
        "edge-agent run",
        "make no-such-target",
        "make fuzz SECONDZ=3",
        "python -m benchmarks.no_such",
        "python -m benchmarks.accuracy --swep",
        "rm -rf /",
        "sudo systemctl start edge-agent",
    ],
)
def test_a_line_that_nobody_knows_or_that_would_fail_is_found(text: str) -> None:
    (line,) = shell_lines("docs/new.md", f"# New\n\n```\n{text}\n```\n")
    assert known.problem_with(line)


def test_lines_are_found_in_shell_blocks_alone_and_under_their_heading() -> None:
    text = (
        "# A\n```\n$ make demo  # or so\n# nothing\n```\n## B\n```text\nx\n```\n  ```sh\n  make \\\n    test\n  ```\n"
    )
    assert list(shell_lines("p", text)) == [
        ShellLine("p", "A", 3, "make demo  # or so"),
        ShellLine("p", "B", 12, "make test"),
    ]


@pytest.mark.parametrize("text", ["```shel\nmake demo\n```\n", "```\nmake demo\n"])
def test_a_block_that_might_hide_commands_is_an_error(text: str) -> None:
    with pytest.raises(ValueError, match=r"^p:1: "):
        list(shell_lines("p", text))
