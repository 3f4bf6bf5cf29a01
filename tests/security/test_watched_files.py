"""Files are read once a change, and who reads them decides what a change is worth."""

from __future__ import annotations

from pathlib import Path

import pytest

from splitslam.watched_files import WatchedFiles


def test_files_are_read_once_a_change_and_what_they_said_before_is_known(tmp_path: Path) -> None:
    one, other = tmp_path / "one", tmp_path / "other"
    one.write_text("a")
    before: list[str] = []

    def read() -> str:
        return "".join(path.read_text() for path in (one, other) if path.exists())

    def again(said: str) -> str:
        before.append(said)
        return read()

    files = WatchedFiles((one, other), read, again)
    assert [files.current(), files.current(), before] == ["a", "a", []]
    other.write_text("b")  # that there is one now is a change
    assert [files.current(), files.current(), before] == ["ab", "ab", ["a"]]
    (tmp_path / "new").write_text("c")
    (tmp_path / "new").replace(other)
    one.unlink()
    assert [files.current(), files.current(), before] == ["c", "c", ["a", "ab"]]


def test_a_change_while_files_are_read_for_the_first_time_is_not_missed(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_text("old")

    def read_in_the_last_moment() -> str:
        said = path.read_text()
        path.write_text("new!")
        return said

    files = WatchedFiles((path,), read_in_the_last_moment, lambda _: path.read_text())
    assert files.current() == "new!"


def test_what_cannot_be_read_at_first_is_the_caller_s_to_mend(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        WatchedFiles((tmp_path / "none",), (tmp_path / "none").read_text, lambda said: said)
