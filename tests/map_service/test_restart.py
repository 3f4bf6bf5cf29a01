"""A long session after a restart: it goes on as it was, and only the clouds around the robot are loaded."""

from __future__ import annotations

from concurrent.futures import Future
from pathlib import Path

import numpy as np
import pytest

from map_service.closing import LoopCloser
from map_service.loops import LoopJob, LoopResult
from map_service.pipeline import MapPipeline
from map_service.rows import SessionCommit
from map_service.settings import LoopSettings, PipelineSettings
from map_service.store import Store
from splitslam.robot import Robot
from tests.map_pipeline.made_drives import Odometry, ToldTracker, ahead, frames
from tests.map_service.entries import OPENING

METRES = 320
COMMIT_EVERY = 40
SAME_M = 1e-6
# nothing looks alike: a candidate that is verified while the service ends needs its clouds again
SETTINGS = PipelineSettings(loops=LoopSettings(likeness=2.0))


class RefusingVerifier:
    """No loop fits."""

    def submit(self, job: LoopJob) -> Future[LoopResult]:
        done: Future[LoopResult] = Future()
        none = np.eye(6)
        done.set_result(LoopResult(job.older, job.newer, np.eye(4), none, False, "refused", 0.0, 0.0, job.by_looks))
        return done


def test_a_restart_loads_the_clouds_around_the_robot_alone_and_describes_no_place_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    parts = (Robot(imu=None, gnss=None), SETTINGS, RefusingVerifier(), frozenset(), "off")
    odometry = Odometry()
    straight = MapPipeline(*parts)
    straight.tracker = ToldTracker(odometry)
    store = Store(f"sqlite:///{tmp_path}/map.db")
    opened = store.open_session(OPENING)
    drive = frames(ahead(METRES, 5.0), odometry)
    T_map_odom = {}
    for frame in drive[:-20]:
        T_map_odom[frame.seq] = straight.process(frame).T_map_odom
        if frame.seq % COMMIT_EVERY == 0 or frame is drive[-21]:
            store.commit(opened.key, 1, SessionCommit(straight.take_commit(), T_map_odom))
            T_map_odom = {}
    described: list[int] = []
    describe = LoopCloser._describe

    def counted(closer: LoopCloser, *arguments):
        described.append(len(closer.places))
        return describe(closer, *arguments)

    monkeypatch.setattr(LoopCloser, "_describe", counted)
    restored = MapPipeline.restore(*parts, store.load(opened.key))
    positions = np.array([restored.keyframes.T_local(i)[:3, 3] for i in range(len(restored.keyframes))])
    off_m = np.linalg.norm(positions - positions[-1], axis=1)
    near = int((off_m < parts[1].tracker.local_map.radius_m).sum())
    assert len(restored.keyframes) == len(straight.keyframes) > 2.5 * near
    assert restored.keyframes.clouds.loaded <= near + 2
    assert described == []
    assert restored.closer is not None
    assert straight.closer is not None
    stored = [straight.closer.places.packed(i) for i in range(len(straight.closer.places))]
    assert [restored.closer.places.packed(i) for i in range(len(restored.closer.places))] == stored
    assert len(stored) > 100
    told = ToldTracker(odometry)
    told.state, told.local_map = restored.tracker.state, restored.tracker.local_map
    restored.tracker = told
    for frame in drive[-20:]:
        a, b = straight.process(frame), restored.process(frame)
        np.testing.assert_allclose(a.T_map_lidar, b.T_map_lidar, atol=SAME_M)
    assert restored.statistics()["mapped"] == straight.statistics()["mapped"] == len(drive)
    loaded = restored.keyframes.clouds.loaded
    far = restored.keyframes.submap(3, 3, 3, restored.graph.poses)
    np.testing.assert_allclose(far, straight.keyframes.submap(3, 3, 3, straight.graph.poses), atol=0.006)
    assert restored.keyframes.clouds.loaded == loaded + 7
    store.close()


def test_a_session_whose_places_were_not_stored_describes_them_again(tmp_path: Path) -> None:
    parts = (Robot(imu=None, gnss=None), SETTINGS, RefusingVerifier(), frozenset(), "off")
    odometry = Odometry()
    straight = MapPipeline(*parts)
    straight.tracker = ToldTracker(odometry)
    for frame in frames(ahead(60, 5.0), odometry):
        straight.process(frame)
    store = Store(f"sqlite:///{tmp_path}/map.db")
    opened = store.open_session(OPENING)
    commit = straight.take_commit()
    T_map_odom = {frame.seq: np.eye(4) for frame in commit.frames}
    middle = len(commit.places) // 2
    del commit.places[middle]
    store.commit(opened.key, 1, SessionCommit(commit, T_map_odom))
    restored = MapPipeline.restore(*parts, store.load(opened.key))
    assert restored.closer is not None
    again = restored.closer.take_places()
    assert [place for place, _ in again] == list(range(middle, len(commit.places) + 1))
    store.close()
