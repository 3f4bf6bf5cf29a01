"""What `splitslam run` was asked for, checked before anything is started."""

from __future__ import annotations

import difflib
import importlib.util
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from splitslam.errors import InputError

DESKEW = ("auto", "reference", "cpu", "fpga", "cosim", "off", "rotation")
PARTS = ("loops", "gnss", "imu", "wheels")
_NEEDED = {"edge": "rosbags", "server": "sqlalchemy", "viz": "matplotlib", "sim": "embreex", "view": "rerun"}


@dataclass(frozen=True, slots=True)
class RunOptions:
    """One run. server None: an embedded map service. deskew None: as configured. truth: scored in the report.

    picture: where a PNG of the run goes as well. view: record what `splitslam view` would show, as view.rrd.
    """

    recording: Path
    robot: Path
    out: Path
    config: Path | None = None
    server: str | None = None
    realtime: bool = False
    max_scans: int | None = None
    deskew: str | None = None
    disable: tuple[str, ...] = ()
    max_kbps: float | None = None
    truth: Path | None = None
    picture: Path | None = None
    view: bool = False

    def __post_init__(self) -> None:
        """Raises InputError: one line that names the option and what was expected."""
        if not self.recording.exists():
            raise InputError(
                f"{self.recording}: expected a recording (ROS 1 bag, ROS 2 bag or mcap), found nothing there"
            )
        check_picture(self.picture)
        if self.deskew is not None:
            _one_of("--deskew", self.deskew, DESKEW)
        for part in self.disable:
            _one_of("--disable", part, PARTS)
        if self.max_kbps is not None and not self.max_kbps > 0:
            raise InputError(f"--max-kbps: expected more than 0, found {self.max_kbps:g}")
        if self.max_scans is not None and self.max_scans < 1:
            raise InputError(f"--max-scans: expected at least 1, found {self.max_scans}")


def check_picture(path: Path | None) -> None:
    """Raises InputError when no file can be there."""
    if path is not None and (path.is_dir() or not path.absolute().parent.is_dir()):
        raise InputError(f"--picture {path}: expected a file in a folder that exists")


def _one_of(option: str, value: str, known: tuple[str, ...]) -> None:
    if value in known:
        return
    nearest = difflib.get_close_matches(value, known, n=1)
    hint = f"; nearest: {nearest[0]}" if nearest else ""
    raise InputError(f"{option}: expected one of {', '.join(known)}, found {value!r}{hint}")


def check_installed(extras: Iterable[str]) -> None:
    """Raises InputError that says what to install when an extra of this package is missing."""
    missing = [extra for extra in extras if importlib.util.find_spec(_NEEDED[extra]) is None]
    if missing:
        raise InputError(f"not everything is installed: pip install 'splitslam[{','.join(missing)}]'")
