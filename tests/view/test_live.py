"""A viewer at a running service: late comers, corrections, moves between replicas, services that come and go."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from splitslam.run.processes import RunFailedError
from splitslam.security.client import Connector
from splitslam.security.settings import ClientTls
from splitslam.view.live import LiveView
from splitslam.view.scene import Scene
from splitslam.wire import session_pb2 as pb
from tests.map_service.fakes import FINAL_SHIFT_M, KEYFRAME_EVERY, POINTS_LIDAR, payload
from tests.map_service.harness import Robot7, Service, frame, hello, new_run
from tests.tolerances import VIEW_M
from tests.view.logged import Logged

Connect = Callable[..., Robot7]
WAIT_S = 60.0


class Viewer:
    """A view whose steps the test takes."""

    def __init__(self, address: str) -> None:
        self.logged, self.notes = Logged(), []
        scene = Scene(self.logged, voxel_m=0.0)  # type: ignore[arg-type]
        self.view = LiveView(scene, Connector(address, ClientTls()), self.notes.append)

    def until(self, done: Callable[[], bool], what: str) -> None:
        deadline_s = time.monotonic() + WAIT_S
        self.view.run(lambda: not done() and time.monotonic() < deadline_s)
        assert done(), f"not within {WAIT_S:g} s: {what}"

    def map(self, robot: str = "rover-7") -> np.ndarray:
        """Points of the map, (N, 3), as they lie now, by x."""
        drawn = self.logged.map_of(robot)
        return drawn[np.argsort(drawn[:, 0], kind="stable")]


def along(*at_m: float) -> np.ndarray:
    """The points of keyframes there, by x."""
    return np.sort(np.concatenate([POINTS_LIDAR[:, 0] + x_m for x_m in at_m]))


@contextmanager
def viewer(service: Service) -> Iterator[Viewer]:
    made = Viewer(service.address)
    try:
        yield made
    finally:
        made.view.close()


def test_who_comes_late_sees_what_was_mapped_before(service: Service, connect: Connect) -> None:
    robot = connect(service)
    before = 2 * KEYFRAME_EVERY + 2
    for seq in range(1, before + 1):
        robot.ask(frame(seq))
    robot.wait_durable(before)
    with viewer(service) as shown:
        shown.until(shown.view.connected.is_set, "connected")
        robot.ask(frame(before + 1))
        shown.until(lambda: len(shown.map()) == 3 * len(POINTS_LIDAR), "three keyframes")
        np.testing.assert_allclose(shown.map()[:, 0], along(1.0, 6.0, 11.0), atol=0.02)
        shown.until(lambda: len(shown.logged.way_of("rover-7")) >= 3, "the way until now")
        (cloud,) = shown.logged.of("world/rover-7/map/0", "Points3D")
        assert cloud.stamp_ns == frame(2 * KEYFRAME_EVERY + 1).stamp_ns, "at the time when the last of it was taken"


def test_the_end_of_a_run_corrects_what_is_shown_by_transforms_alone(service: Service, connect: Connect) -> None:
    with viewer(service) as shown:
        shown.until(shown.view.connected.is_set, "connected")
        robot = connect(service)
        for seq in range(1, 8):
            robot.ask(frame(seq))
        shown.until(lambda: shown.view.counts.scans == 7, "seven scans")
        before = shown.map()
        robot.send(pb.Bye(last_seq=7))
        robot.next("finished")
        shown.until(lambda: np.abs(shown.map() - before).max() > FINAL_SHIFT_M - 1.0, "the correction")
        np.testing.assert_allclose(shown.map(), before + np.array([FINAL_SHIFT_M, 0.0, 0.0]), atol=VIEW_M)
        for k in range(2):
            assert len(shown.logged.of(f"world/rover-7/map/newest/{k}", "Points3D")) == 1
        said = [entry.fields["text"][0] for entry in shown.logged.of("events/rover-7")]
        assert f"2 keyframes moved, by {FINAL_SHIFT_M:.2f} m at most" in said


def test_robots_are_shown_side_by_side_and_another_run_of_one_apart(service: Service) -> None:
    with viewer(service) as shown:
        shown.until(shown.view.connected.is_set, "connected")
        runs = [("rover-7", new_run()), ("rover-8", new_run()), ("rover-7", new_run())]
        for robot_id, run in runs:
            robot = Robot7(service.address, hello(run, robot_id=robot_id))
            robot.ask(frame(1))
            robot.close()
        shown.until(lambda: shown.view.counts.scans == 3, "three scans")
        assert shown.view.counts.robots == 3
        for name in ("rover-7", "rover-8", f"rover-7\\ {runs[2][1][:8]}"):
            assert shown.logged.of(f"world/{name}/lidar")


def test_a_service_that_is_not_there_yet_is_waited_for(start_service: Callable[..., Service]) -> None:
    service = start_service()
    service.kill()
    with viewer(service) as shown:
        shown.until(lambda: bool(shown.notes), "a note")
        assert shown.notes[0].startswith("map service: unavailable:")
        service.start()
        shown.until(shown.view.connected.is_set, "connected")
        service.kill()
        service.start()
        robot = Robot7(service.address, hello(new_run()))
        robot.next("welcome")
        seq = 0
        deadline_s = time.monotonic() + WAIT_S
        while not shown.view.counts.scans and time.monotonic() < deadline_s:
            seq += 1
            robot.ask(frame(seq))
            shown.view.run(_for(0.1))
        robot.close()
        assert shown.view.counts.scans


def test_a_service_that_cannot_be_watched_says_so_at_once(start_service: Callable[..., Service]) -> None:
    from concurrent.futures import ThreadPoolExecutor

    import grpc

    old = grpc.server(ThreadPoolExecutor(1))  # of a release without ViewService
    port = old.add_insecure_port("127.0.0.1:0")
    old.start()
    shown = Viewer(f"127.0.0.1:{port}")
    with pytest.raises(RunFailedError, match="WatchScans: unimplemented"):
        shown.view.run(_for(WAIT_S))
    shown.view.close()
    old.stop(None)


def test_a_message_that_does_not_hold_together_is_dropped_and_counted(service: Service, connect: Connect) -> None:
    from splitslam.wire import view_pb2

    with viewer(service) as shown:
        bad = view_pb2.WatchScansResponse(session_id="rover-7/1")
        bad.scan.answer.seq, bad.scan.corners_lidar = 1, b"1234567"
        shown.view._seen(bad)
        assert shown.view.counts.bad == 1
        assert not shown.logged.of("world/rover-7/lidar")
        shown.until(shown.view.connected.is_set, "connected")
        connect(service).ask(frame(1, payload()))
        shown.until(lambda: shown.view.counts.scans == 1, "a good one")


def _for(seconds: float) -> Callable[[], bool]:
    end_s = time.monotonic() + seconds
    return lambda: time.monotonic() < end_s
