"""`edge-agent run`: puts the parts together, runs them to the end of input or a signal, and takes them apart."""

from __future__ import annotations

import gc
import logging
import sys
import threading
from contextlib import ExitStack

from edge_agent.assembly import RunParts, assemble
from edge_agent.config import AgentConfig
from edge_agent.going_on import UnseenMotion
from edge_agent.loop import AgentLoop, Parts
from edge_agent.metrics import EdgeMetrics
from edge_agent.outputs import Outputs
from edge_agent.run_report import run_report
from edge_agent.sources import open_source
from edge_agent.sources.source import StoppedError
from edge_agent.supervisor import SessionOverError
from edge_agent.watchdog import Watchdog
from splitslam.errors import InputError
from splitslam.logs import fields
from splitslam.notify import Notifier
from splitslam.robot import Robot, load_robot

_log = logging.getLogger(__name__)


def run_agent(config: AgentConfig, stop: threading.Event, notifier: Notifier | None = None) -> None:
    """Runs until the source ends or `stop` is set; then the session stays open, to be resumed.

    notifier: the service manager, told when scans can come, that they do, and of the end. `stop` is set in any case
    when this returns. Raises InputError for what the user can mend; nothing half-written is left behind.
    """
    metrics = EdgeMetrics(keep=config.output.dir is not None)
    notifier = notifier or Notifier({})
    try:
        source = open_source(config, _robot(config), metrics, stop)
    except StoppedError:
        return
    for note in source.notes:
        print(note, file=sys.stderr)
    with ExitStack() as cleanup:
        cleanup.callback(source.close)
        if config.metrics.port is not None:
            port = metrics.serve(config.metrics.host, config.metrics.port)
            cleanup.callback(metrics.close)
            if config.metrics.port == 0:
                print(f"metrics on http://{config.metrics.host}:{port}/metrics", file=sys.stderr)
        outputs = Outputs(config.output.dir) if config.output.dir else None
        if outputs is not None:
            cleanup.callback(outputs.discard)  # does nothing once they are published
        parts = assemble(config, source, metrics, outputs, notifier, stop, cleanup)
        _Run(parts, notifier, stop, cleanup).run()


def _robot(config: AgentConfig) -> Robot:
    """The robot as this run uses it: what is switched off is not there."""
    off = {part: None for part in ("imu", "gnss", "wheels") if part in config.disable}
    return load_robot(config.robot, placed_elsewhere=config.source.ros is not None).model_copy(update=off)


class _Run:
    """A run from its parts' start to the service's last word; `cleanup` takes apart what is started here, too."""

    def __init__(self, parts: RunParts, notifier: Notifier, stop: threading.Event, cleanup: ExitStack) -> None:
        self._parts, self._notifier, self._stop, self._cleanup = parts, notifier, stop, cleanup

    def run(self) -> None:
        """Connect, read, process, say Bye, report."""
        parts = self._parts
        watcher = threading.Thread(target=self._watch, name="stopper", daemon=True)
        watcher.start()
        self._cleanup.callback(watcher.join)
        self._cleanup.callback(self._stop.set)  # lets the watcher go
        parts.uplink.start()
        if parts.store.leftovers is not None:
            parts.store.leftovers.start()
        if parts.clouds is not None:
            parts.clouds.start()
        try:
            if self._may_begin():
                self._read_all()
        except SessionOverError:
            parts.store.over()
            raise

    def _watch(self) -> None:
        self._stop.wait()
        self._notifier.stopping("stopping")
        self._parts.reader.stop()
        self._parts.uplink.stop()

    def _may_begin(self) -> bool:
        """Once the service has said Welcome, or without it where nobody waits and the disk says how far the run is."""
        config, store = self._parts.config, self._parts.store
        patient = store.run.continued or config.uplink.connect_timeout_s is None
        self._notifier.status(f"waiting for the map service at {config.server}")
        return (patient and store.says_how_far) or self._parts.uplink.wait_welcome() is not None

    def _read_all(self) -> None:
        parts, stop = self._parts, self._stop
        loop = parts.standing.loop = self._make_loop()
        parts.progress.start(parts.source.scan_count)
        gc.freeze()  # the collector would look at all that was imported and made so far every few seconds
        self._cleanup.callback(gc.unfreeze)
        gc.enable()
        parts.reader.start()
        self._watch_over(loop)
        loop.run(parts.queue.batches())
        done = not stop.is_set() and loop.finish()
        parts.tally.end(parts.reader.cpu_s)
        finished = done and self._say_bye()
        if finished and parts.clouds is not None:
            parts.clouds.finish(stop, parts.progress.dense)
        if not finished and parts.uplink.kept:
            parts.store.tell_kept(parts.uplink.kept, parts.uplink.all_on_disk)
        parts.uplink.close()
        if parts.outputs is not None:
            parts.outputs.publish(run_report(parts, stopped=not finished), parts.metrics.page())
        parts.progress.end(parts.standing.scans_read, parts.tally.mapped)

    def _say_bye(self) -> bool:
        """Every frame is answered. Whether the service has finished the run."""
        parts, last_seq = self._parts, self._parts.pipeline.seq
        if last_seq == 0:
            dropped = ", ".join(f"{count} {reason}" for reason, count in sorted(parts.standing.dropped().items()))
            why = dropped or "none in it"
            raise InputError(f"{parts.config.source.name}: no usable scans ({why}); expected at least one")
        parts.uplink.report_drops(parts.standing.dropped())
        parts.store.say_bye(last_seq)
        if parts.uplink.finish(last_seq) is None:
            return False
        parts.store.finished()
        return True

    def _watch_over(self, loop: AgentLoop) -> None:
        """From now on systemd, if there is one, is told how the run goes."""
        if not self._notifier.on:
            return
        sink, line = self._parts.sink, self._parts.standing.line
        watchdog = Watchdog(self._notifier, (self._parts.reader.pulse, loop.pulse), lambda: sink.read, line)
        self._notifier.ready(f"{line()}; waiting for the first scan")
        watchdog.start()
        self._cleanup.callback(watchdog.close)

    def _make_loop(self) -> AgentLoop:
        """A continued run goes on after the last scan that is on disk or that the service has, whichever is newer."""
        parts = self._parts
        if parts.store.run.continued:
            self._go_on()
        driven = Parts(
            sequencer=parts.sequencer,
            imu=parts.imu,
            pipeline=parts.pipeline,
            uplink=parts.uplink,
            sink=parts.sink,
            metrics=parts.metrics,
            check=parts.check,
            outages=parts.outages,
        )
        by_the_clock = parts.config.source.by_the_clock
        return AgentLoop(driven, not by_the_clock, parts.after.seq + 1, parts.reader.due_s if by_the_clock else None)

    def _go_on(self) -> None:
        parts, after = self._parts, self._parts.after
        newest, welcome = parts.store.spooled, parts.uplink.welcome
        if newest is not None:
            after.seq, after.stamp_ns = newest.seq, newest.stamp_ns
        if welcome is not None and welcome.applied_seq > after.seq:
            after.seq = welcome.applied_seq
            after.stamp_ns = max((pose.stamp_ns for pose in welcome.last_poses), default=after.stamp_ns)
        if after.seq:
            parts.pipeline.seq, parts.tally.first_seq = after.seq, after.seq + 1
            parts.pipeline.imu = UnseenMotion(parts.imu, after.stamp_ns)
            _log.warning("run continued", extra=fields(run_id=parts.store.run.value, seq=after.seq))
