"""Feature frames of a recording as the edge makes them, with the map service's answers, in this process."""

from __future__ import annotations

from collections.abc import Iterator

from benchmarks.drives import Files
from edge_agent.imu import ImuSettings, make_imu_node
from edge_agent.pipeline import EdgePipeline
from edge_agent.settings import PipelineSettings as EdgeSettings
from edge_agent.sources import Sequencer, open_recording
from edge_agent.sources.sequencer import Item
from edge_agent.types import OdometryReply
from map_service.pipeline import MapPipeline
from map_service.settings import PipelineSettings as MapSettings
from splitslam import codec
from splitslam.check.odometry import NoLoops
from splitslam.errors import DataError
from splitslam.features import FeatureFrame
from splitslam.robot import load_robot
from splitslam.scan import ImuSamples, ScanPacket

FINE_STEP_M = 0.0005  # the frames are decoded ones: this far from what the edge computed, at most
_LAG = 2  # scans until an answer is back
_OFF = frozenset({"gnss", "loops", "wheels"})


class FrameSource:
    """Frames of a recording, in order. beam_elevations_rad, columns: of its sensor."""

    def __init__(self, files: Files, max_scans: int | None) -> None:
        robot = load_robot(files.robot).model_copy(update={"gnss": None, "wheels": None})
        self._recording = open_recording(files.bag, robot, max_scans=max_scans)
        self._robot = self._recording.robot
        self.beam_elevations_rad = self._recording.beam_elevations_rad
        self.columns = self._robot.lidar.columns

    def frames(self) -> Iterator[FeatureFrame]:
        imu = make_imu_node(self._robot, ImuSettings())
        edge = EdgePipeline(self._robot, EdgeSettings(step_m=FINE_STEP_M), self.beam_elevations_rad, imu)
        service = MapPipeline(self._robot, MapSettings(), NoLoops(), _OFF, edge.image_node.name)
        held: list[OdometryReply] = []
        for item in self._items():
            if isinstance(item, ImuSamples):
                imu.add_imu(item)
            if not isinstance(item, ScanPacket):
                continue
            while held and held[0].seq <= edge.seq + 1 - _LAG:
                imu.on_odometry(held.pop(0))
            try:
                sent = edge.process(item)
            except DataError:
                continue
            frame = codec.decode(sent.payload, sent.seq, sent.stamp_ns, sent.dense, self.beam_elevations_rad)
            a = service.process(frame)
            reply = (a.seq, a.stamp_ns, a.T_map_lidar, a.T_map_odom, a.covariance, int(a.state), a.degenerate_axes)
            held.append(OdometryReply(*reply))
            yield frame

    def _items(self) -> Iterator[Item]:
        sequencer = Sequencer(self._robot)
        for _, event in self._recording.events():
            yield from sequencer.push(event)
        yield from sequencer.finish()
        self._recording.close()
