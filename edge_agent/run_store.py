"""What of a run outlives the agent: its identity, its frames that are not durable yet, and what it has lost."""

from __future__ import annotations

import logging
from collections import Counter

from edge_agent.config import AgentConfig
from edge_agent.leftovers import Leftovers
from edge_agent.metrics import EdgeMetrics
from edge_agent.run_id import RunState
from edge_agent.spool import RunFolder, Spool, SpoolFolder
from edge_agent.spool.record import Head
from splitslam.logs import fields
from splitslam.wire import session_pb2 as pb

_log = logging.getLogger(__name__)


class RunStore:
    """Opens the run to continue, or a new one; run: which it is, spool: None without a directory for it."""

    def __init__(self, config: AgentConfig, hello: pb.Hello, metrics: EdgeMetrics) -> None:
        """hello: of this agent; its run_id is filled in. Raises InputError for a directory that cannot be used."""
        self._state, self._metrics = RunState(config.state_dir), metrics
        path = config.spool_dir
        self._folder = folder = None if path is None else SpoolFolder(path, config.spool.max_bytes)
        self.run = self._state.open((lambda run_id: True) if folder is None else (lambda r: folder.continues(r, hello)))
        hello.run_id = self.run.value
        self.spool: Spool | None = None
        self._own: RunFolder | None = None
        self.leftovers: Leftovers | None = None
        if folder is not None:
            self._own = folder.run(self.run.value)
            metrics.drop_sources.append(Counter(self._own.dropped))  # counts go on since the run began
            self._own.begin(hello)
            self.spool = folder.open(self._own)
            self.leftovers = Leftovers(folder, self.run.value, config.server, config.uplink, config.tls)
            metrics.spool_error_sources.append(self.leftovers.errors)

    @property
    def spooled(self) -> Head | None:
        """The newest frame of this run that an agent before has left on disk."""
        return self.spool.recovered.newest if self.spool is not None else None

    @property
    def says_how_far(self) -> bool:
        """Whether no frame was made after `spooled`; else only the service knows how far the run has come."""
        if self.spool is None or not self.run.continued:
            return self.spool is not None
        return self.run.spooled and self.spool.recovered.says_how_far

    @property
    def sends_leftovers(self) -> bool:
        """Whether frames of runs before take a part of the uplink."""
        return self.leftovers is not None and self.leftovers.active

    def keep(self, all_on_disk: bool) -> None:
        """Notes that the run is alive; cheap enough for every scan."""
        if self._state.save(self.run, all_on_disk) and self._own is not None:
            self._own.note_dropped(self._metrics.all_dropped())

    def say_bye(self, last_seq: int) -> None:
        """The run is complete; Bye is about to be said."""
        if self._own is not None:
            self._own.say_bye(last_seq)

    def finished(self) -> None:
        """The service has finished the run: nothing of it is needed here."""
        self._state.forget()
        if self._own is not None:
            self._own.delete()

    def over(self) -> None:
        """The session takes no more frames: those here are set aside, and the next start begins a new run."""
        self._state.forget()
        if self._own is not None and self.spool is not None:
            frames = len(self.spool)
            self.spool.errors["refused"] += frames
            folder = str(self._own.set_aside())
            _log.error("frames refused, set aside", extra=fields(run_id=self.run.value, frames=frames, folder=folder))

    def tell_kept(self, frames: int, on_disk: bool) -> None:
        """The agent stops before the service has said that it has all of them."""
        said = fields(run_id=self.run.value, frames=frames)
        if on_disk:
            _log.warning("frames kept for the next start", extra=said)
        else:
            _log.error("frames not stored by the service, and not all of them on disk", extra=said)

    def close(self) -> None:
        """Everything stays for the next start."""
        if self.leftovers is not None:
            self.leftovers.close()
        if self.spool is not None:
            self.spool.close()
        if self._folder is not None:
            self._folder.close()
