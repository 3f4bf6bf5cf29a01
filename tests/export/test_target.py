"""No half file, no folder and no file that nobody allowed is ever replaced."""

from __future__ import annotations

from pathlib import Path

import pytest

from splitslam.errors import InputError
from splitslam.export.target import check_target, complete


def test_the_file_is_there_when_it_is_complete(tmp_path: Path) -> None:
    path = tmp_path / "map.ply"
    with complete(path, force=False) as part:
        part.write_text("all")
        assert not path.exists()
        assert part.parent == tmp_path
    assert path.read_text() == "all"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError, RuntimeError, SystemExit])
def test_whatever_goes_wrong_leaves_things_as_they_were(error: type[BaseException], tmp_path: Path) -> None:
    path = tmp_path / "map.ply"
    path.write_text("before")

    def half_done() -> None:
        with complete(path, force=True) as part:
            part.write_text("half")
            raise error

    with pytest.raises(error):
        half_done()
    assert path.read_text() == "before"
    assert list(tmp_path.iterdir()) == [path]


def test_only_force_replaces_a_file_and_nothing_replaces_a_folder(tmp_path: Path) -> None:
    (tmp_path / "map").mkdir()
    (tmp_path / "map" / "dear.txt").write_text("kept")
    (tmp_path / "map.ply").write_text("before")
    with pytest.raises(InputError, match="--force"):
        check_target(tmp_path / "map.ply", force=False)
    check_target(tmp_path / "map.ply", force=True)
    for force in (False, True):
        with pytest.raises(InputError, match="found a folder"):
            check_target(tmp_path / "map", force)
    with pytest.raises(InputError, match="found no"):
        check_target(tmp_path / "nowhere" / "map.ply", force=True)
    assert (tmp_path / "map" / "dear.txt").read_text() == "kept"


def test_who_was_quicker_is_not_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "map.ply"

    def too_late() -> None:
        with complete(path, force=False) as part:
            part.write_text("late")
            path.write_text("quicker")

    with pytest.raises(InputError, match="is there already"):
        too_late()
    assert path.read_text() == "quicker"


def test_the_file_is_readable_as_others_are(tmp_path: Path) -> None:
    plain, path = tmp_path / "plain", tmp_path / "map.ply"
    plain.write_text("")
    with complete(path, force=False):
        pass
    assert path.stat().st_mode == plain.stat().st_mode
