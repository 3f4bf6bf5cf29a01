"""`edge-agent run`: puts the parts together, runs them to the end of input or a signal, and takes them apart."""

from __future__ import annotations

import gc
import logging
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import asdict
from typing import Any

from edge_agent.about import write_about
from edge_agent.check import LiveCheck
from edge_agent.clouds.dense import NEVER, open_clouds
from edge_agent.config import AgentConfig
from edge_agent.feed import PoseFeed
from edge_agent.going_on import StartAfter, UnseenMotion
from edge_agent.imu import make_imu_node
from edge_agent.kernel_cache import counted
from edge_agent.loop import AgentLoop, Parts
from edge_agent.metrics import EdgeMetrics
from edge_agent.odometry.outage import Outages
from edge_agent.outputs import Outputs
from edge_agent.pipeline import EdgePipeline
from edge_agent.raw_ring import RawRing
from edge_agent.reader import EventQueue, Reader
from edge_agent.ros.base_samples import Belief
from edge_agent.ros.output import open_output
from edge_agent.run_store import RunStore
from edge_agent.sink import AgentSink, Progress
from edge_agent.sources import Sequencer, Source, TimedEvent, open_source
from edge_agent.sources.source import StoppedError
from edge_agent.tally import Tally, stage_summaries
from edge_agent.tcp_meter import TcpBytes
from edge_agent.uplink import SessionOverError, Uplink
from edge_agent.warm_up import warm_up
from edge_agent.watchdog import Watchdog
from edge_agent.wire import EDGE_ONLY, WIRE_VERSION, state_name
from splitslam import __version__
from splitslam.codec import CODEC_VERSION
from splitslam.errors import InputError
from splitslam.logs import fields, say_always
from splitslam.notify import Notifier
from splitslam.robot import Robot, load_robot, robot_for_service
from splitslam.wire import session_pb2 as pb

_log = logging.getLogger(__name__)


def run_agent(config: AgentConfig, stop: threading.Event, notifier: Notifier | None = None) -> None:
    """Runs until the source ends or `stop` is set; then the session stays open, to be resumed.

    notifier: the service manager, told when scans can come, that they do, and of the end. `stop` is set in any case
    when this returns. Raises InputError for what the user can mend; nothing half-written is left behind.
    """
    metrics = EdgeMetrics(keep=config.output.dir is not None)
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
        _Run(config, source, metrics, outputs, notifier or Notifier({}), stop, cleanup).run()


def _robot(config: AgentConfig) -> Robot:
    """The robot as this run uses it: what is switched off is not there."""
    off = {part: None for part in ("imu", "gnss", "wheels") if part in config.disable}
    return load_robot(config.robot, placed_elsewhere=config.source.ros is not None).model_copy(update=off)


def _raw_ring(config: AgentConfig) -> RawRing | None:
    folder = config.raw_ring.dir
    return RawRing(folder, config.raw_ring) if folder is not None and config.raw_ring.max_bytes else None


class _Run:
    """One run's parts, in the order in which they start; `cleanup` takes them apart in the reverse one."""

    def __init__(
        self,
        config: AgentConfig,
        source: Source,
        metrics: EdgeMetrics,
        outputs: Outputs | None,
        notifier: Notifier,
        stop: threading.Event,
        cleanup: ExitStack,
    ) -> None:
        self._config, self._source, self._metrics, self._outputs = config, source, metrics, outputs
        self._notifier, self._stop, self._cleanup = notifier, stop, cleanup
        robot, beams = source.robot, source.beam_elevations_rad
        by_the_clock = config.source.by_the_clock
        ring = _raw_ring(config)
        if ring is not None:
            source.tap = ring.add
            cleanup.callback(ring.close)
        self._imu = make_imu_node(robot, config.imu)
        self._pipeline = EdgePipeline(robot, config.pipeline, beams, self._imu)
        node = self._pipeline.image_node
        cleanup.callback(node.close)
        metrics.deskew_from(node.name, node.counts)
        notifier.status("compiling kernels, or reading them from the cache")
        with counted() as kernels:
            warm_up(robot, config.pipeline, config.imu, beams, config.odometry)
        clock_ns = time.monotonic_ns if by_the_clock else None
        self._loop: AgentLoop | None = None
        self._outages = Outages(config.odometry, node.name not in ("off", "rotation"), clock_ns)
        metrics.outages_from(self._outages.report)
        metrics.spool_limit.set(config.spool.max_bytes if config.spools else 0)
        hello = self._hello(robot)
        self._store = RunStore(config, hello, metrics)
        cleanup.callback(self._store.close)
        write_about(config, robot, kernels, metrics.port)
        store = self._store
        say_always(robot_id=robot.robot.id, run_id=store.run.value)
        self._uplink = Uplink(
            config.server, hello, config.uplink, metrics, store.spool, lambda: store.sends_leftovers, config.tls
        )
        metrics.certificate_from(self._uplink.certificate_expires_s)
        self._clouds = open_clouds(config, hello, self._pipeline, self._uplink, metrics)
        self._queue = EventQueue(config.source.queue_scans, by_the_clock, metrics)
        self._after = StartAfter(0, -(2**62), live=source.live_offset_ns is not None)
        began_s, offset_ns = config.source.began_s, source.live_offset_ns
        self._reader = Reader(self._events(), self._queue, by_the_clock, began_s, offset_ns, lambda: source.start_ns)
        feed = None
        if config.feed.socket is not None:
            feed = PoseFeed(config.feed, config.feed.socket, robot.T_body_lidar, metrics)
            cleanup.callback(feed.close)
        self._tally = Tally(keep=config.output.dir is not None)
        self._progress = Progress(config.output.progress)
        self._sequencer = Sequencer(robot)
        self._check = LiveCheck(robot, metrics)
        metrics.drop_sources += [source.dropped, self._sequencer.dropped]
        metrics.clock_step_sources.append(self._sequencer.times.steps)
        metrics.imu_from(self._imu_gaps, lambda: self._imu.resets, lambda: self._sequencer.uncovered)
        metrics.scans_from(self._scans, lambda: dict(self._tally.corrections_by_cause))
        belief = Belief(self._imu, self._state, lambda: self._sequencer.offset_ns)
        ros = open_output(config, source, belief, self._ros_report, stop, cleanup)
        if ros is not None:
            metrics.drop_sources.append(ros.dropped)
        self._sink = AgentSink(
            tally=self._tally,
            outputs=outputs,
            feed=feed,
            ros=ros,
            by_scan=robot.imu is None,
            progress=self._progress,
            run_id=self._store.run.value,
            reader_cpu_s=lambda: self._reader.cpu_s,
            keep_run=lambda: self._store.keep(self._uplink.all_on_disk),
            report_drops=lambda: self._uplink.report_drops(self._metrics.all_dropped()),
            clouds=self._clouds.keeper if self._clouds else None,
        )
        cleanup.callback(self._uplink.close)
        if self._clouds is not None:
            cleanup.callback(self._clouds.close)
        cleanup.callback(self._reader.close)

    def _hello(self, robot: Robot) -> pb.Hello:
        config = self._config
        return pb.Hello(
            robot_id=robot.robot.id,
            robot_file_yaml=robot_for_service(robot),
            beam_elevations_rad=self._source.beam_elevations_rad.tolist(),
            wire_version=WIRE_VERSION,
            codec_version=CODEC_VERSION,
            site_id=config.site_id,
            map_id=config.map_id,
            agent_version=__version__,
            deskew=self._pipeline.image_node.name,
            disable=[part for part in config.disable if part != EDGE_ONLY],
            lockstep=not config.source.by_the_clock,
        )

    def run(self) -> None:
        """Connect, read, process, say Bye, report."""
        stop = self._stop
        watcher = threading.Thread(target=self._watch, args=(stop,), name="stopper", daemon=True)
        watcher.start()
        self._cleanup.callback(watcher.join)
        self._cleanup.callback(stop.set)  # lets the watcher go
        self._uplink.start()
        if self._store.leftovers is not None:
            self._store.leftovers.start()
        if self._clouds is not None:
            self._clouds.start()
        try:
            self._run(stop)
        except SessionOverError:
            self._store.over()
            raise

    def _run(self, stop: threading.Event) -> None:
        patient = self._store.run.continued or self._config.uplink.connect_timeout_s is None
        self._notifier.status(f"waiting for the map service at {self._config.server}")
        if not (patient and self._store.says_how_far) and self._uplink.wait_welcome() is None:
            return
        loop = self._loop = self._make_loop()
        self._progress.start(self._source.scan_count)
        gc.freeze()  # the collector would look at all that was imported and made so far every few seconds
        self._cleanup.callback(gc.unfreeze)
        gc.enable()
        self._reader.start()
        self._watch_over(loop)
        loop.run(self._queue.batches())
        finished = None
        if not stop.is_set() and loop.finish():
            self._tally.end(self._reader.cpu_s)
            self._nothing_usable()
            self._uplink.report_drops(self._metrics.all_dropped())
            self._store.say_bye(self._pipeline.seq)
            finished = self._uplink.finish(self._pipeline.seq)
        if finished is not None:
            self._store.finished()
            if self._clouds is not None:
                self._clouds.finish(stop, self._progress.dense)
        else:
            self._tally.end(self._reader.cpu_s)
        self._uplink.close()
        if self._outputs is not None:
            self._outputs.publish(self._report(finished is None), self._metrics.page())
        self._progress.end(self._scans_read, self._tally.mapped)

    def _watch_over(self, loop: AgentLoop) -> None:
        """From now on systemd, if there is one, is told how the run goes."""
        if not self._notifier.on:
            return

        def status() -> str:
            link = "connected" if self._uplink.anchored else "not connected"
            said = f"{state_name(loop.state)}; {link}, {self._uplink.kept} frames kept"
            return "; ".join(filter(None, (said, self._source.status())))

        pulses = (self._reader.pulse, loop.pulse)
        watchdog = Watchdog(self._notifier, pulses, lambda: self._sink.read, status)
        self._notifier.ready(f"{status()}; waiting for the first scan")
        watchdog.start()
        self._cleanup.callback(watchdog.close)

    def _watch(self, stop: threading.Event) -> None:
        stop.wait()
        self._notifier.stopping("stopping")
        self._reader.stop()
        self._uplink.stop()

    def _events(self) -> Iterator[TimedEvent | None]:
        yield from self._after.events(self._source.events())

    def _make_loop(self) -> AgentLoop:
        """A continued run goes on after the last scan that is on disk or that the service has, whichever is newer."""
        if self._store.run.continued:
            self._go_on()
        parts = Parts(
            sequencer=self._sequencer,
            imu=self._imu,
            pipeline=self._pipeline,
            uplink=self._uplink,
            sink=self._sink,
            metrics=self._metrics,
            check=self._check,
            outages=self._outages,
        )
        by_the_clock = self._config.source.by_the_clock
        return AgentLoop(parts, not by_the_clock, self._after.seq + 1, self._reader.due_s if by_the_clock else None)

    def _go_on(self) -> None:
        after, newest, welcome = self._after, self._store.spooled, self._uplink.welcome
        if newest is not None:
            after.seq, after.stamp_ns = newest.seq, newest.stamp_ns
        if welcome is not None and welcome.applied_seq > after.seq:
            after.seq = welcome.applied_seq
            after.stamp_ns = max((pose.stamp_ns for pose in welcome.last_poses), default=after.stamp_ns)
        if after.seq:
            self._pipeline.seq, self._tally.first_seq = after.seq, after.seq + 1
            self._pipeline.imu = UnseenMotion(self._imu, after.stamp_ns)
            _log.warning("run continued", extra=fields(run_id=self._store.run.value, seq=after.seq))

    def _nothing_usable(self) -> None:
        if self._pipeline.seq == 0:
            why = (
                ", ".join(f"{count} {reason}" for reason, count in sorted(self._metrics.all_dropped().items()))
                or "none in it"
            )
            raise InputError(f"{self._config.source.name}: no usable scans ({why}); expected at least one")

    @property
    def _scans_read(self) -> int:
        return self._source.counts.scans_read - self._after.skipped - self._reader.passed_scans

    def _scans(self) -> dict[str, int]:
        tally = self._tally
        return {
            "read": self._scans_read,
            "sent": tally.sent,
            "mapped": tally.mapped,
            "rejected": tally.rejected,
            "replayed": tally.replayed,
        }

    def _state(self) -> int:
        return self._imu.state if self._loop is None else self._loop.state

    def _ros_report(self) -> dict[str, object]:
        """The values of /diagnostics."""
        scans = self._scans()
        return {
            "connected": self._uplink.anchored,
            "frames_kept": self._uplink.kept,
            "scans_read": scans["read"],
            "scans_mapped": scans["mapped"],
            "dropped": sum(self._metrics.all_dropped().values()),
            "sensors": self._source.status() or "ok",
        }

    def _imu_gaps(self) -> tuple[int, float]:
        gaps = getattr(self._imu, "gaps", None)  # the node of a robot without IMU has none
        return (0, 0.0) if gaps is None else (gaps.count, gaps.seconds)

    def _report(self, stopped: bool) -> dict[str, Any]:
        """edge.json: the edge's part of report.json under the same keys, and series by scan for the plots."""
        tally, counts = self._tally, self._source.counts
        recording_s = (self._source.end_ns - self._source.start_ns) * 1e-9
        jumps = {**self._imu.jumps, "map_count": tally.corrections, "map_max_m": tally.correction_max_m}
        read = self._scans_read
        welcome = self._uplink.welcome
        dense = self._clouds.tcp_bytes() if self._clouds else TcpBytes()
        going_on = {"continued": {"after_scan": self._after.seq, "replayed": tally.replayed}} if self._after.seq else {}
        return {
            "session_id": welcome.session_id if welcome else "",
            "run_id": self._store.run.value,
            **going_on,
            "stopped": stopped,
            "scans": {"read": read, "sent": tally.sent, "mapped": tally.mapped, "dropped": read - tally.mapped},
            "passed_scans": self._reader.passed_scans,  # before the agent listened
            "recording_s": recording_s,
            **tally.times(),
            **stage_summaries(self._metrics),
            **tally.link(self._uplink.tcp_bytes(), recording_s, counts, self._pipeline.rate, dense),
            "dense": self._clouds.report() if self._clouds else NEVER,
            "jumps": jumps,
            "wheels": self._imu.wheels_report,
            "outages": {**asdict(self._outages.report()), "odometry_ms": self._metrics.odometry.summary_ms()},
            "imu_resets": self._imu.resets,
            "deskew": {"back_end": self._pipeline.image_node.name, "troubles": dict(self._pipeline.image_node.counts)},
            "dropped_by_reason": self._metrics.all_dropped(),
            "clock_steps": dict(self._sequencer.times.steps),
            "check": [finding.as_dict() for finding in self._check.finish()],
            **tally.by_scan(),
        }
