"""Signs of life to systemd, sent only while there is life: no thread of the scans' way is stuck.

Sensors may be silent, and then it is said: in the log once, and in the status line as long as it lasts.
"""

from __future__ import annotations

import faulthandler
import logging
import sys
import threading
import time
from collections.abc import Callable, Sequence
from typing import IO

from edge_agent.pulse import Pulse
from splitslam.logs import fields
from splitslam.notify import Notifier

_log = logging.getLogger(__name__)

_PERIOD_S = 1.0  # also that of the status line
_SILENT_S = 2.0  # 20 scans of most LiDARs
_STUCK_S = 5.0  # without a watchdog it is only said


class Watchdog(threading.Thread):
    """Looks at each `pulse` and at the number of scans so far, a few times within systemd's patience.

    A thread at the same thing for half of that patience is stuck: the stacks of all threads go to stderr, and no sign
    of life leaves until it goes on. systemd then ends the process and starts the next one, which continues the run.
    """

    def __init__(
        self,
        notifier: Notifier,
        pulses: Sequence[Pulse],
        scans: Callable[[], int],
        status: Callable[[], str],
        stacks: IO[str] | None = None,
    ) -> None:
        """scans: counts on as the pipeline takes scans. status: the rest of the status line. stacks: default stderr."""
        super().__init__(name="watchdog", daemon=True)
        self._notifier, self._pulses, self._scans, self._status = notifier, pulses, scans, status
        self._stacks = stacks
        patience_s = notifier.watchdog_s
        self._period_s = _PERIOD_S if patience_s is None else min(_PERIOD_S, patience_s / 4)
        self._stuck_s = _STUCK_S if patience_s is None else patience_s / 2
        self._ended = threading.Event()
        self._seen, self._seen_s = 0, time.monotonic()
        self._silent = False
        self._stuck: Pulse | None = None

    def run(self) -> None:
        """Until `close`."""
        while not self._ended.is_set():
            self._look()
            self._ended.wait(self._period_s)

    def close(self) -> None:
        """No more signs of life."""
        self._ended.set()
        if self.is_alive():
            self.join()

    def _look(self) -> None:
        stuck = next((pulse for pulse in self._pulses if pulse.busy_s > self._stuck_s), None)
        if stuck is not None:
            self._say_stuck(stuck)
            return
        if self._stuck is not None:
            _log.warning("thread goes on", extra=fields(thread=self._stuck.name))
            self._stuck = None
        self._notifier.status(f"{self._flow()}; {self._status()}")
        self._notifier.alive()

    def _say_stuck(self, pulse: Pulse) -> None:
        self._notifier.status(f"the {pulse.name} is stuck since {pulse.busy_s:.0f} s")
        if self._stuck is None:
            said = fields(thread=pulse.name, busy_s=round(pulse.busy_s, 1))
            _log.critical("thread stuck: no more signs of life", extra=said)
            faulthandler.dump_traceback(self._stacks or sys.stderr, all_threads=True)
        self._stuck = pulse

    def _flow(self) -> str:
        """How scans come; their silence and its end are logged."""
        now_s, scans = time.monotonic(), self._scans()
        new, span_s = scans - self._seen, now_s - self._seen_s
        if new:
            if self._silent:
                _log.warning("scans come again", extra=fields(after_s=round(span_s)))
            self._seen, self._seen_s, self._silent = scans, now_s, False
            return f"{new / span_s:.0f} scans/s" if span_s > 0.5 * self._period_s else "scans come"
        if span_s >= _SILENT_S and not self._silent:
            self._silent = True
            _log.warning("no scans", extra=fields(silent_s=round(span_s)))
        return f"no scan for {span_s:.0f} s" if self._silent else "waiting for a scan"
