"""Rerun's own program: the server that keeps what is logged for whoever connects, its page for browsers, its window.

All of it on loopback, and the server with a bound on its memory: a window or a page that hangs keeps nobody waiting,
not even us.
"""

from __future__ import annotations

import importlib.util
import json
import os
import socket
import time
import webbrowser
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from urllib.parse import quote

from splitslam.errors import InputError
from splitslam.run.processes import Child, RunFailedError, how_it_ended, started
from splitslam.view.options import ViewOptions

HOST = "127.0.0.1"
_START_S, _STOP_S, _TICK_S = 20.0, 3.0, 0.05
_NAME = "rerun"


@dataclass(frozen=True, slots=True)
class RerunServer:
    """url: for programs that log, and for Rerun's window. page: for a browser, None without."""

    url: str
    page: str | None
    _children: tuple[Child, ...]

    @property
    def open(self) -> bool:
        """Nobody has closed the window, and the server lives."""
        return all(child.exit_code is None for child in self._children)

    def check(self) -> None:
        """Raises RunFailedError when one of the programs has failed."""
        for child in self._children:
            if child.exit_code:
                lines = [text for _, text in child.remaining_lines() if text.strip()]
                raise RunFailedError(": ".join([how_it_ended(_NAME, child.exit_code), *lines[-1:]]))


@contextmanager
def rerun_server(options: ViewOptions, files: Sequence[Path] = ()) -> Iterator[RerunServer]:
    """Serves, and shows in a window unless `options.web`, for as long as the block runs.

    files: recordings that are shown besides what is logged. Raises InputError where a window cannot be, RunFailedError
    when a program does not come up.
    """
    if not options.web and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise InputError("splitslam view: no display here: expected --web, for a browser, or --save FILE.rrd")
    port = options.port or _free_port()
    url = f"rerun+http://{HOST}:{port}/proxy"
    command = [*map(str, files), "--bind", HOST, "--port", str(port)]
    command += ["--server-memory-limit", options.memory]
    page = None
    if options.web:
        web_port = options.web_port or _free_port()
        command += ["--serve-web", "--web-viewer-port", str(web_port)]
        page = f"http://{HOST}:{web_port}/?url={quote(url, safe='')}"
    else:
        command += ["--serve-grpc"]
    with ExitStack() as stack:
        program = _program(Path(stack.enter_context(TemporaryDirectory(prefix="splitslam-view-"))))
        children = [stack.enter_context(started(_NAME, (*program, *command), _STOP_S))]
        for at in (port, web_port) if options.web else (port,):
            _wait_listening(children[0], at)
        if not options.web:
            window = ("--connect", url, "--bind", HOST, "--port", "auto", "--memory-limit", options.memory)
            children.append(stack.enter_context(started(_NAME, (*program, *window), _STOP_S)))
        elif options.open_browser and page is not None:
            webbrowser.open(page)
        yield RerunServer(url, page, tuple(children))


def _program(folder: Path) -> tuple[str, ...]:
    """Rerun's command with a configuration of its own in `folder`: that it tells its makers nothing of its use."""
    config = folder / "rerun" / "analytics.json"
    config.parent.mkdir()
    config.write_text(json.dumps({"analytics_enabled": False, "analytics_id": "", "metadata": {}}))
    found = importlib.util.find_spec("rerun_cli")
    if found is None or found.origin is None:
        raise RunFailedError("rerun_cli, which comes with rerun-sdk: not found")
    # itself, not `python -m rerun`: that starts it as a child, which would stay when we end
    return ("/usr/bin/env", f"XDG_CONFIG_HOME={folder}", str(Path(found.origin).with_name("rerun")))


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        return probe.getsockname()[1]


def _wait_listening(child: Child, port: int) -> None:
    deadline_s = time.monotonic() + _START_S
    while time.monotonic() < deadline_s:
        if child.exit_code is not None:
            lines = [text for _, text in child.remaining_lines() if text.strip()]
            raise RunFailedError(": ".join([how_it_ended(_NAME, child.exit_code), *lines[-1:]]))
        with socket.socket() as probe:
            if probe.connect_ex((HOST, port)) == 0:
                return
        time.sleep(_TICK_S)
    raise RunFailedError(f"{_NAME}: expected to listen on {HOST}:{port} within {_START_S:g} s, did not")
