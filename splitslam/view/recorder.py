"""What a viewer would see of one robot's run, recorded while it goes on."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from splitslam.run.processes import RunFailedError
from splitslam.security.client import Connector
from splitslam.security.settings import ClientTls
from splitslam.view.batches import recording_stream
from splitslam.view.folder import RECORDING
from splitslam.view.layout import AT_THE_START, eye_over, layout
from splitslam.view.live import LiveView
from splitslam.view.scene import Scene

VOXEL_M = 0.1
_CONNECT_S, _END_S = 10.0, 30.0


@contextmanager
def recorded(server: str, tls: ClientTls, robot_id: str, folder: Path, note: Callable[[str], None]) -> Iterator[None]:
    """For as long as the block runs, into view.rrd in `folder`. The run never waits for it, but for its last messages.

    Raises RunFailedError when the service cannot be watched.
    """
    recording = recording_stream(live=False)
    recording.save(folder / RECORDING, default_blueprint=layout(AT_THE_START))
    scene = Scene(recording, VOXEL_M)
    view = LiveView(scene, Connector(server, tls), note, robot_id)
    recorder = _Recorder(view)
    try:
        recorder.wait_connected()
        yield
        recorder.finish()
    finally:
        recorder.stop()
        view.close()
        recording.send_blueprint(layout(eye_over(scene.positions_map)))
        recording.flush()
        recording.disconnect()
    counts = view.counts
    if lost := counts.missed + counts.bad:
        note(f"{RECORDING}: {lost} of {lost + counts.scans} scans are not in it: recording was slower than the run")


class _Recorder(threading.Thread):
    def __init__(self, view: LiveView) -> None:
        super().__init__(name="recorder", daemon=True)
        self._view = view
        self._over = threading.Event()
        self._failed: RunFailedError | None = None
        self.start()

    def run(self) -> None:
        try:
            self._view.run(lambda: not self._over.is_set())
            self._view.finish()
        except RunFailedError as error:
            self._failed = error

    def wait_connected(self) -> None:
        if not self._view.connected.wait(_CONNECT_S):
            raise self._failed or RunFailedError(f"map service: WatchScans: no answer within {_CONNECT_S:g} s")

    def finish(self) -> None:
        self.stop()
        if self._failed is not None:
            raise self._failed

    def stop(self) -> None:
        self._over.set()
        self.join(_END_S)
