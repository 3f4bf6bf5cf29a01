"""Runs of before whose frames the map service may not have: replayed and finished beside the new run, oldest first."""

from __future__ import annotations

import logging
import threading
from collections import Counter

from edge_agent.config import UplinkConfig
from edge_agent.metrics import EdgeMetrics
from edge_agent.spool import RunFolder, SpoolFolder
from edge_agent.supervisor import SessionOverError
from edge_agent.uplink import Uplink
from splitslam.errors import InputError
from splitslam.logs import fields
from splitslam.security.settings import ClientTls

_SHARE = 0.3  # of a limited uplink; live frames keep to their backlog share meanwhile
_log = logging.getLogger(__name__)


class Leftovers:
    """One thread; `close` leaves what is not done for the next start.

    errors: `refused`, frames of runs that the service does not take. Such a run is set aside when its session is over
    (finished by somebody else, or lost by the service); else it stays, as the service may think otherwise later.
    """

    def __init__(
        self, folder: SpoolFolder, run_id: str, server: str, settings: UplinkConfig, tls: ClientTls | None = None
    ) -> None:
        """run_id: the new run."""
        self.errors: Counter[str] = Counter()
        limit_kbps = None if settings.max_kbps is None else settings.max_kbps * _SHARE
        self._settings = settings.model_copy(update={"max_kbps": limit_kbps, "reconnect_timeout_s": None})
        self._folder, self._server, self._tls = folder, server, tls
        self._runs = folder.others(run_id)
        self._closing = False
        self._lock = threading.Lock()
        self._uplink: Uplink | None = None
        self._thread = threading.Thread(target=self._send_all, name="leftovers", daemon=True)

    @property
    def active(self) -> bool:
        """Frames of before are under way, or wait."""
        return self._thread.is_alive()

    def start(self) -> None:
        if self._runs:
            self._thread.start()

    def close(self) -> None:
        with self._lock:
            self._closing = True
            if self._uplink is not None:
                self._uplink.stop()
        if self._thread.is_alive():
            self._thread.join()

    def _send_all(self) -> None:
        for run in self._runs:
            if self._closing:
                return
            try:
                self._send(run)
            except OSError as error:
                _log.error("frames of before cannot be read", extra=fields(run_id=run.run_id, detail=str(error)))
            except Exception:  # a defect here must not cost the live run anything
                _log.exception("frames of before not sent", extra=fields(run_id=run.run_id))

    def _send(self, run: RunFolder) -> None:
        hello = run.hello
        if hello is None:
            return
        spool = self._folder.open(run)
        frames, newest = len(spool), spool.recovered.newest
        metrics = EdgeMetrics(keep=False)
        metrics.drop_sources.append(Counter(run.dropped))
        uplink = Uplink(self._server, hello, self._settings, metrics, spool, tls=self._tls)
        with self._lock:
            if self._closing:
                spool.close()
                return
            self._uplink = uplink
        _log.warning("frames of before are sent", extra=fields(run_id=run.run_id, frames=frames))
        try:
            uplink.start()
            done = self._finish(run, uplink, metrics, 0 if newest is None else newest.seq)
        except SessionOverError as error:
            done = run.said_bye
            if not done:
                self.errors["refused"] += frames
                said = fields(run_id=run.run_id, frames=frames, folder=str(run.set_aside()), detail=str(error))
                _log.error("frames refused, set aside", extra=said)
        except InputError as error:
            done = False
            self.errors["refused"] += frames
            kept = fields(run_id=run.run_id, frames=frames, detail=str(error))
            _log.error("frames refused, kept for the next start", extra=kept)
        finally:
            uplink.close()
            spool.close()
        if done:
            run.delete()

    def _finish(self, run: RunFolder, uplink: Uplink, metrics: EdgeMetrics, newest_seq: int) -> bool:
        """Everything answered, then Bye; False when closed meanwhile."""
        if (welcome := uplink.wait_welcome()) is None or not uplink.wait_answered(newest_seq):
            return False
        uplink.take_answers()  # nobody waits for them
        uplink.report_drops(metrics.all_dropped())
        last_seq = max(newest_seq, welcome.applied_seq)
        run.say_bye(last_seq)
        return uplink.finish(last_seq) is not None
