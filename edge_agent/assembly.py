"""The parts of one run, made in the order in which they need each other, and what takes them apart again."""

from __future__ import annotations

import threading
import time
from contextlib import ExitStack
from dataclasses import dataclass

from edge_agent.about import write_about
from edge_agent.check import LiveCheck
from edge_agent.clouds.dense import DenseClouds, open_clouds
from edge_agent.config import AgentConfig
from edge_agent.feed import PoseFeed
from edge_agent.going_on import StartAfter
from edge_agent.imu import make_imu_node
from edge_agent.imu.constant_velocity import ConstantVelocityNode
from edge_agent.imu.node import ImuNode
from edge_agent.kernel_cache import counted
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
from edge_agent.sources import Sequencer, Source
from edge_agent.standing import Standing
from edge_agent.tally import Tally
from edge_agent.uplink import Uplink
from edge_agent.warm_up import warm_up
from edge_agent.wire import EDGE_ONLY, WIRE_VERSION
from splitslam import __version__
from splitslam.codec import CODEC_VERSION
from splitslam.logs import say_always
from splitslam.notify import Notifier
from splitslam.robot import robot_for_service
from splitslam.wire import session_pb2 as pb

_FROM_THE_BEGINNING_NS = -(2**62)


@dataclass(frozen=True, slots=True)
class RunParts:
    """clouds: None: no whole scans are kept. outputs: None: the run's results go nowhere but to the service."""

    config: AgentConfig
    source: Source
    metrics: EdgeMetrics
    outputs: Outputs | None
    imu: ImuNode | ConstantVelocityNode
    pipeline: EdgePipeline
    outages: Outages
    store: RunStore
    uplink: Uplink
    clouds: DenseClouds | None
    after: StartAfter
    queue: EventQueue
    reader: Reader
    sequencer: Sequencer
    check: LiveCheck
    tally: Tally
    standing: Standing
    progress: Progress
    sink: AgentSink


def assemble(
    config: AgentConfig,
    source: Source,
    metrics: EdgeMetrics,
    outputs: Outputs | None,
    notifier: Notifier,
    stop: threading.Event,
    cleanup: ExitStack,
) -> RunParts:
    """Nothing of it runs yet but for the pose feed and the output to a ROS graph. Raises InputError."""
    robot, by_the_clock = source.robot, config.source.by_the_clock
    if config.raw_ring.dir is not None and config.raw_ring.max_bytes:
        ring = RawRing(config.raw_ring.dir, config.raw_ring)
        source.tap = ring.add
        cleanup.callback(ring.close)
    imu = make_imu_node(robot, config.imu)
    pipeline = EdgePipeline(robot, config.pipeline, source.beam_elevations_rad, imu)
    node = pipeline.image_node
    cleanup.callback(node.close)
    notifier.status("compiling kernels, or reading them from the cache")
    with counted() as kernels:
        warm_up(robot, config.pipeline, config.imu, source.beam_elevations_rad, config.odometry)
    clock_ns = time.monotonic_ns if by_the_clock else None
    outages = Outages(config.odometry, node.name not in ("off", "rotation"), clock_ns)
    hello = _hello(config, source, node.name)
    store = RunStore(config, hello, metrics)
    cleanup.callback(store.close)
    write_about(config, robot, kernels, metrics.port)
    say_always(robot_id=robot.robot.id, run_id=store.run.value)
    uplink = Uplink(
        config.server, hello, config.uplink, metrics, store.spool, lambda: store.sends_leftovers, config.tls
    )
    clouds = open_clouds(config, hello, pipeline, uplink, metrics)
    queue = EventQueue(config.source.queue_scans, by_the_clock, metrics)
    after = StartAfter(0, _FROM_THE_BEGINNING_NS, live=source.live_offset_ns is not None)
    began_s, offset_ns = config.source.began_s, source.live_offset_ns
    events = after.events(source.events())
    reader = Reader(events, queue, by_the_clock, began_s, offset_ns, lambda: source.start_ns)
    feed = None
    if config.feed.socket is not None:
        feed = PoseFeed(config.feed, config.feed.socket, robot.T_body_lidar, metrics)
        cleanup.callback(feed.close)
    tally, sequencer = Tally(keep=config.output.dir is not None), Sequencer(robot)
    standing = Standing(source, after, reader, imu, uplink, tally, metrics)
    belief = Belief(imu, lambda: standing.state, lambda: sequencer.offset_ns)
    ros = open_output(config, source, belief, standing.diagnostics, stop, cleanup)
    progress = Progress(config.output.progress)
    sink = AgentSink(
        tally=tally,
        outputs=outputs,
        feed=feed,
        ros=ros,
        by_scan=robot.imu is None,
        progress=progress,
        run_id=store.run.value,
        reader_cpu_s=lambda: reader.cpu_s,
        keep_run=lambda: store.keep(uplink.all_on_disk),
        report_drops=lambda: uplink.report_drops(standing.dropped()),
        clouds=clouds.keeper if clouds else None,
    )
    cleanup.callback(uplink.close)
    if clouds is not None:
        cleanup.callback(clouds.close)
    cleanup.callback(reader.close)
    parts = RunParts(
        config=config,
        source=source,
        metrics=metrics,
        outputs=outputs,
        imu=imu,
        pipeline=pipeline,
        outages=outages,
        store=store,
        uplink=uplink,
        clouds=clouds,
        after=after,
        queue=queue,
        reader=reader,
        sequencer=sequencer,
        check=LiveCheck(robot, metrics),
        tally=tally,
        standing=standing,
        progress=progress,
        sink=sink,
    )
    if ros is not None:
        metrics.drop_sources.append(ros.dropped)
    _show(parts)
    return parts


def _hello(config: AgentConfig, source: Source, deskew: str) -> pb.Hello:
    """As this agent opens its session; run_id is filled in by the run's store."""
    return pb.Hello(
        robot_id=source.robot.robot.id,
        robot_file_yaml=robot_for_service(source.robot),
        beam_elevations_rad=source.beam_elevations_rad.tolist(),
        wire_version=WIRE_VERSION,
        codec_version=CODEC_VERSION,
        site_id=config.site_id,
        map_id=config.map_id,
        agent_version=__version__,
        deskew=deskew,
        disable=[part for part in config.disable if part != EDGE_ONLY],
        lockstep=not config.source.by_the_clock,
    )


def _show(parts: RunParts) -> None:
    """On /metrics, what the parts count themselves."""
    metrics, sequencer, standing, node = parts.metrics, parts.sequencer, parts.standing, parts.pipeline.image_node
    metrics.spool_limit.set(parts.config.spool.max_bytes if parts.config.spools else 0)
    metrics.deskew_from(node.name, node.counts)
    metrics.outages_from(parts.outages.report)
    metrics.certificate_from(parts.uplink.certificate_expires_s)
    metrics.drop_sources += [parts.source.dropped, parts.after.dropped, sequencer.dropped]
    metrics.clock_step_sources.append(sequencer.times.steps)
    metrics.imu_from(standing.imu_gaps, lambda: parts.imu.resets, lambda: sequencer.uncovered)
    metrics.scans_from(standing.scans, lambda: dict(parts.tally.corrections_by_cause))
