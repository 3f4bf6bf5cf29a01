"""`splitslam view`: what it was given, and where it is shown."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import rerun as rr
from rerun.blueprint import Blueprint

from splitslam.run.processes import interruptible
from splitslam.security.client import Connector
from splitslam.view.batches import recording_stream
from splitslam.view.folder import RECORDING, read_folder, show_folder
from splitslam.view.layout import AT_THE_START, eye_over, layout
from splitslam.view.live import Counts, LiveView
from splitslam.view.options import ViewOptions
from splitslam.view.rerun_server import RerunServer, rerun_server
from splitslam.view.scene import Scene
from splitslam.view.stored import show_session

_TICK_S, _FLUSH_S = 0.2, 5.0


def run_view(options: ViewOptions) -> None:
    """Until the window is closed, the time is over, or Ctrl-C.

    Raises InputError for what cannot be shown, RunFailedError for a service or a program that fails.
    """
    with interruptible():
        try:
            _view(options)
        except KeyboardInterrupt:  # the usual way out of a program that never ends
            return


def _view(options: ViewOptions) -> None:
    folder = options.folder
    recorded = options.file or (folder / RECORDING if folder is not None and options.save is None else None)
    if recorded is not None and recorded.exists():
        with rerun_server(options, (recorded,)) as server:
            _tell(server)
            _wait(options, server)
    elif folder is not None:
        _view_folder(folder, options)
    elif options.session_id:
        _view_session(options)
    else:
        _view_service(options)


def _view_folder(folder: Path, options: ViewOptions) -> None:
    run = read_folder(folder)
    with _recording(options, layout(eye_over(run.trajectory.positions_m))) as (recording, server):
        show_folder(run, Scene(recording, options.voxel_m, options.most_points))
        if server is not None:
            _wait(options, server)


def _view_session(options: ViewOptions) -> None:
    connector = Connector(options.target, options.tls)
    with _recording(options, layout(AT_THE_START)) as (recording, server):
        show_session(options.session_id, connector, Scene(recording, options.voxel_m, options.most_points))
        if server is not None:
            _wait(options, server)


def _view_service(options: ViewOptions) -> None:
    connector = Connector(options.target, options.tls)
    with _recording(options, layout(AT_THE_START)) as (recording, server):
        view = LiveView(
            Scene(recording, options.voxel_m, options.most_points), connector, _note, options.robot_id, options.site_id
        )
        going_on = _Until(options.seconds, server)
        try:
            view.run(going_on)
        finally:
            view.close()
            _note(_sum(view.counts))
    if server is not None:
        server.check()


@contextmanager
def _recording(options: ViewOptions, blueprint: Blueprint) -> Iterator[tuple[rr.RecordingStream, RerunServer | None]]:
    """Into the file that was asked for, or to a server that shows it; complete when the block is left."""
    recording = recording_stream(live=options.save is None and options.folder is None)
    with ExitStack() as stack:
        server = None
        if options.save is not None:
            recording.save(options.save, default_blueprint=blueprint)
        else:
            server = stack.enter_context(rerun_server(options))
            recording.connect_grpc(server.url, default_blueprint=blueprint)
            _tell(server)
        stack.callback(_end, recording)  # before the server
        yield recording, server


def _end(recording: rr.RecordingStream) -> None:
    with suppress(RuntimeError):  # the server has gone, and with it whoever could see the rest
        recording.flush(timeout_sec=_FLUSH_S)
    recording.disconnect()


class _Until:
    """Called between any two steps: false when it is time to end."""

    def __init__(self, seconds: float | None, server: RerunServer | None) -> None:
        self._end_s = None if seconds is None else time.monotonic() + seconds
        self._server = server

    def __call__(self) -> bool:
        in_time = self._end_s is None or time.monotonic() < self._end_s
        return in_time and (self._server is None or self._server.open)


def _wait(options: ViewOptions, server: RerunServer) -> None:
    going_on = _Until(options.seconds, server)
    while going_on():
        time.sleep(_TICK_S)
    server.check()


def _tell(server: RerunServer) -> None:
    print(server.page or server.url, flush=True)


def _note(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def _sum(counts: Counts) -> str:
    line = f"{counts.scans} scans of {counts.robots} robots shown"
    if counts.missed:
        line += f", {counts.missed} missed: this viewer was too slow"
    return f"{line}, {counts.bad} messages dropped" if counts.bad else line
