"""What `splitslam view` was asked for, checked before anything is started."""

from __future__ import annotations

import importlib.util
import re
from dataclasses import dataclass, field
from pathlib import Path

from splitslam.errors import InputError
from splitslam.security.settings import ClientTls

WEB_POINTS = 20_000
_FEWEST_POINTS = 1000
DEFAULT_SERVER = "127.0.0.1:50051"
_MEMORY = re.compile(r"[1-9]\d*(MB|GB|MiB|GiB)|[1-9]\d?%")
_SERVER = re.compile(r"(\[[0-9a-fA-F:]+\]|[^:/\s]+):(\d{1,5})")


@dataclass(frozen=True, slots=True)
class ViewOptions:
    """target: a run's folder, a .rrd file, or HOST:PORT of a map service.

    save: write a .rrd instead of showing it. web: show it in a browser (open_browser: and open one), else in Rerun's
    own window. port, web_port: of the data and of the page, on loopback; 0: any. memory: what is kept for who opens
    later, and by Rerun's window; beyond it the oldest goes. voxel_m: of the map as it is shown. points: of all maps
    together at most, beyond it the voxels grow; 0: no bound; None: with `web` what a browser without a GPU can draw,
    else no bound. robot_id, site_id: these alone; "": all. session_id: what is stored of this one, which need not run
    any more, instead of what comes.
    seconds: end after so long; None: when Ctrl-C or the window ends it.
    """

    target: str = DEFAULT_SERVER
    save: Path | None = None
    web: bool = False
    open_browser: bool = False
    port: int = 0
    web_port: int = 0
    memory: str = "1GiB"
    voxel_m: float = 0.1
    points: int | None = None
    robot_id: str = ""
    site_id: str = ""
    session_id: str = ""
    seconds: float | None = None
    tls: ClientTls = field(default_factory=ClientTls)

    def __post_init__(self) -> None:
        """Raises InputError: one line that names the option and what was expected."""
        if not self.folder and not self.file and not _is_server(self.target):
            raise InputError(
                f"splitslam view: {self.target}: expected a run's folder, a .rrd file or HOST:PORT of a map service"
            )
        if self.save is not None and (self.save.is_dir() or not self.save.absolute().parent.is_dir()):
            raise InputError(f"--save {self.save}: expected a file in a folder that exists")
        if self.save is not None and self.web:
            raise InputError("--web: expected without --save")
        if self.save is not None and self.file:
            raise InputError(f"--save: expected with a folder or a service, {self.target} is a recording already")
        if not _MEMORY.fullmatch(self.memory):
            raise InputError(f"--memory: expected a size such as 500MB, 2GiB or 25%, found {self.memory!r}")
        if not (self.voxel_m == 0 or 0.01 <= self.voxel_m <= 100):
            raise InputError(f"--voxel: expected 0 or 0.01 to 100 m, found {self.voxel_m:g}")
        if self.points is not None and self.points != 0 and self.points < _FEWEST_POINTS:
            raise InputError(f"--points: expected 0 or at least {_FEWEST_POINTS}, found {self.points}")
        if self.seconds is not None and not self.seconds > 0:
            raise InputError(f"--seconds: expected more than 0, found {self.seconds:g}")

    @property
    def most_points(self) -> int:
        """Of all maps together; 0: no bound."""
        if self.points is not None:
            return self.points
        return WEB_POINTS if self.web else 0

    @property
    def folder(self) -> Path | None:
        """Of a finished run."""
        path = Path(self.target)
        return path if path.is_dir() else None

    @property
    def file(self) -> Path | None:
        """A recording for Rerun."""
        path = Path(self.target)
        return path if path.suffix == ".rrd" and path.is_file() else None


def _is_server(text: str) -> bool:
    found = _SERVER.fullmatch(text)
    return bool(found) and 0 < int(found[2]) < 65536


def check_view_installed() -> None:
    """Raises InputError that says what to install."""
    if importlib.util.find_spec("rerun") is None:
        raise InputError("not everything is installed: pip install 'splitslam[view]'")
