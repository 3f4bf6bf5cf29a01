"""How each shell line of the documents is known to work."""

from __future__ import annotations

import shlex

from tests.docs.commands import mistake_in
from tests.docs.pages import ShellLine

# Pages, or page#heading, whose lines a test types as they stand, all of them.
TYPED_BY = {
    "docs/quick_start.md": "tests/docs/test_quick_start.py:test_every_command_of_the_page_works_in_its_order",
    "docs/robot.md": "tests/systemd/test_robot_guide.py:test_every_command_of_the_guide_works_in_its_order",
    "docs/security.md": "tests/security/test_guide.py:test_the_set_up_of_the_guide_works_as_it_stands",
    "docs/store.md": "tests/docs/test_store_page.py:test_every_command_of_the_page_works",
    "docs/simulator.md": "tests/docs/test_simulator_page.py:test_every_command_of_the_page_works",
    "docs/server.md#Certificates": "tests/deploy/test_server_guide.py:"
    "test_each_container_can_read_its_certificates_and_no_other_s",
    "docs/server.md#Secrets": "tests/deploy/test_server_guide.py:"
    "test_the_secrets_that_it_makes_are_long_each_its_own_and_for_nobody_else_to_read",
    "docs/server.md#Kubernetes": "tests/deploy/test_server_guide.py:"
    "test_its_secrets_of_kubernetes_are_those_that_the_pods_mount",
}
# What cannot be run in CI. Everything else is read at least by its own parser, by make or by Python.
NOT_IN_CI = {
    "docker compose": "there is no container engine; tests/deploy runs what the file says as processes",
    "python3 -m venv": "it would only be filled from the network, as `make setup` has filled the one of this test",
    ".venv/bin/python -m pip install": "the same; tests/packaging installs the wheel",
}


def problem_with(line: ShellLine) -> str | None:
    """Why nobody can say that a line works, or None."""
    if {line.page, f"{line.page}#{line.heading}"} & TYPED_BY.keys():
        return None
    if not_in_ci(line.text):
        return None
    try:
        mistake = mistake_in(line.text)
    except KeyError as unknown:
        mistake = f"{unknown}: no command that a test knows: type it in a test (TYPED_BY), or say why not (NOT_IN_CI)"
    return f"{line.page}:{line.number}: {mistake}" if mistake else None


def not_in_ci(text: str) -> str | None:
    """Which entry of NOT_IN_CI a line is, or None."""
    words = shlex.split(text, comments=True)
    return next((name for name in NOT_IN_CI if words[: len(name.split())] == name.split()), None)
