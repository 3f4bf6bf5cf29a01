from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from splitslam.errors import InputError
from splitslam.tum import Trajectory, read_tum, write_tum

GOOD = "1700000000.123456789 1 2 3 0 0 0 1\n"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "expected poses"),
        ("# only a comment\n\n", "expected poses"),
        (GOOD + "1700000001 1 2 3 0 0 1\n", ":2: expected 8 numbers .* found 7 fields"),
        (GOOD + "1700000001 1 2 three 0 0 0 1\n", ":2: expected 8 numbers .* found '1 2 three 0 0 0 1'"),
        (GOOD + "yesterday 1 2 3 0 0 0 1\n", ":2: stamp_s: expected seconds, found 'yesterday'"),
        (GOOD + "nan 1 2 3 0 0 0 1\n", ":2: stamp_s: expected seconds, found 'nan'"),
        (GOOD + "1e300 1 2 3 0 0 0 1\n", ":2: stamp_s: expected seconds"),
        (GOOD + GOOD, ":2: stamp_s: expected later than the pose before"),
        (GOOD + "1700000001 1 2 nan 0 0 0 1\n", ":2: expected finite numbers"),
        (GOOD + "1700000001 1 2 3 0 0 0 0\n", ":2: qx qy qz qw: expected a unit quaternion"),
    ],
)
def test_a_bad_trajectory_file_is_one_line_that_names_file_line_and_field(tmp_path: Path, text: str, expected: str):
    path = tmp_path / "bad.tum"
    path.write_text(text)
    with pytest.raises(InputError, match=expected) as caught:
        read_tum(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_a_missing_file_a_folder_and_binary_data_are_input_errors(tmp_path: Path):
    (tmp_path / "binary").write_bytes(b"\xff\xfe\x00\x80")
    for name in ("missing.tum", "", "binary"):
        with pytest.raises(InputError, match="expected a t"):
            read_tum(tmp_path / name)


def test_stamps_survive_to_the_nanosecond_and_comments_are_skipped(tmp_path: Path):
    rng = np.random.default_rng(1)
    quats = rng.normal(size=(5, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    stamps_ns = 1_700_000_000_000_000_001 + np.arange(5) * 100_000_007
    write_tum(tmp_path / "a.tum", Trajectory(stamps_ns, rng.normal(size=(5, 3)) * 1000, quats))
    (tmp_path / "b.tum").write_text("# stamp ...\n" + (tmp_path / "a.tum").read_text() + "\n")
    again = read_tum(tmp_path / "b.tum")
    assert again.stamps_ns.tolist() == stamps_ns.tolist()
    write_tum(tmp_path / "c.tum", again)
    assert (tmp_path / "c.tum").read_text() == (tmp_path / "a.tum").read_text()
