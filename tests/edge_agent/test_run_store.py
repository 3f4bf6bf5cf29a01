"""What outlives an agent: the run it goes on with, the runs it sends besides, and what the service does not take."""

from __future__ import annotations

import json
import time
from pathlib import Path

import pytest

from edge_agent import run_id
from edge_agent.config import AgentConfig, UplinkConfig
from edge_agent.metrics import EdgeMetrics
from edge_agent.run_store import RunStore
from edge_agent.supervisor import SessionOverError
from edge_agent.uplink import Uplink
from splitslam.config import validate
from splitslam.errors import InputError
from splitslam.wire import session_pb2 as pb
from tests.edge_agent.fake_service import FakeService
from tests.edge_agent.test_spool import frame
from tests.edge_agent.test_uplink import PATIENT, seqs
from tests.logs.said import said


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> dict[str, float]:
    now = {"s": 1000.0}
    monkeypatch.setattr(run_id, "_since_boot_s", lambda: now["s"])
    return now


def hello(robot_file: str = "robot: {id: r}") -> pb.Hello:
    return pb.Hello(robot_id="r", robot_file_yaml=robot_file, beam_elevations_rad=[0.1, 0.2], wire_version=1)


class Agent:
    """The parts of an agent between its pipeline and the wire; what it leaves when it is killed is on disk only."""

    def __init__(self, folder: Path, server: str = "127.0.0.1:9", said: pb.Hello | None = None) -> None:
        config = validate(AgentConfig, {
            "robot": "r.yaml", "source": {"recording": "r.bag"}, "server": server, "state_dir": str(folder),
            "uplink": PATIENT.model_dump() | {"reconnect_timeout_s": None},
        }, "test")  # fmt: skip
        self.metrics = EdgeMetrics()
        said = said or hello()
        self.store = RunStore(config, said, self.metrics)
        self.uplink = Uplink(server, said, config.uplink, self.metrics, self.store.spool)

    def make(self, first: int, last: int) -> None:
        for seq in range(first, last + 1):
            self.store.keep(self.uplink.all_on_disk)
            self.uplink.send(frame(seq))
        self.store.keep(self.uplink.all_on_disk)

    def connect(self) -> Agent:
        self.uplink.start()
        assert self.store.leftovers is not None
        self.store.leftovers.start()
        return self

    def die(self) -> None:
        """As by SIGKILL, but for the threads."""
        self.uplink.close()
        self.store.close()


def spool_folders(folder: Path) -> list[str]:
    return sorted(path.name for path in (folder / "spool").iterdir() if path.is_dir())


def wait_until(condition) -> None:
    deadline_s = time.monotonic() + 30.0
    while not condition():
        assert time.monotonic() < deadline_s
        time.sleep(0.02)


def of_before(folder: Path, clock: dict[str, float], frames: int) -> Agent:
    """An agent that has died with so many frames unsent, so long ago that its run is not gone on with."""
    agent = Agent(folder)
    agent.make(1, frames)
    agent.die()
    clock["s"] += 31.0
    return agent


def test_what_is_kept_is_said_and_what_is_not(tmp_path: Path, caplog: pytest.LogCaptureFixture):
    agent = Agent(tmp_path)
    agent.make(1, 3)
    agent.store.tell_kept(agent.uplink.kept, agent.uplink.all_on_disk)
    agent.store.tell_kept(3, on_disk=False)
    run_id = agent.store.run.value
    assert [line for line in said(caplog) if "frames" in line[1]] == [
        ("frames kept for the next start", {"run_id": run_id, "frames": 3}),
        ("frames not stored by the service, and not all of them on disk", {"run_id": run_id, "frames": 3}),
    ]


def test_an_agent_that_restarts_without_a_network_knows_how_far_its_run_has_come_and_replays_it_later(tmp_path: Path):
    with FakeService() as service:
        first = Agent(tmp_path, service.address).connect()
        first.make(1, 12)
        assert first.uplink.wait_answered(12)
        service.stop()
        first.make(13, 20)
        first.die()

        second = Agent(tmp_path, service.address).connect()
        newest = second.store.spooled
        assert newest is not None
        assert (second.store.run.continued, second.store.says_how_far, newest.seq) == (True, True, 20)
        second.make(21, 25)
        service.start()
        assert second.uplink.wait_answered(25)
        assert seqs(second.uplink.take_answers()) == list(range(13, 26))
        second.store.say_bye(25)
        assert second.uplink.finish(25) is not None
        second.store.finished()
        second.die()
    assert sorted(service.applied) == list(range(1, 26))
    assert service.holes == []
    assert service.received.count(5) == 1
    assert spool_folders(tmp_path) == []


def test_an_agent_whose_disk_failed_asks_the_service_how_far_the_run_has_come(tmp_path: Path):
    first = Agent(tmp_path)
    first.make(1, 3)
    assert first.store.spool is not None
    first.store.spool._log._write = lambda fd, data: 0
    first.make(4, 5)
    first.die()
    second = Agent(tmp_path)
    assert second.store.run.continued
    assert not second.store.says_how_far
    second.die()


@pytest.mark.parametrize("cause", ["gap", "boot", "robot_file"])
def test_a_run_that_does_not_go_on_is_sent_and_finished_beside_the_new_one(
    tmp_path: Path, clock: dict[str, float], monkeypatch: pytest.MonkeyPatch, cause: str
):
    first = Agent(tmp_path)
    first.metrics.drop("few_points", 2)
    first.make(1, 9)
    first.die()
    if cause == "gap":
        clock["s"] += 31.0
    if cause == "boot":
        monkeypatch.setattr(run_id, "_boot_id", lambda: "another")
    with FakeService() as service:
        said = hello("robot: {id: r} # mended" if cause == "robot_file" else "robot: {id: r}")
        second = Agent(tmp_path, service.address, said)
        assert not second.store.run.continued
        assert second.store.leftovers is not None
        second.store.leftovers.start()
        wait_until(lambda: service.finished)
        wait_until(lambda: not second.store.sends_leftovers)
        second.die()
    assert sorted(service.applied) == list(range(1, 10))
    assert service.hellos[0].run_id == first.store.run.value
    assert service.reports[-1].dropped_by_reason == {"few_points": 2}
    assert spool_folders(tmp_path) == [second.store.run.value]


def test_leftovers_that_are_interrupted_go_on_at_the_next_start(tmp_path: Path, clock: dict[str, float]):
    Agent(tmp_path).die()  # made no frame: nothing of it stays
    of_before(tmp_path, clock, frames=40)
    with FakeService(answer_delay_s=0.05) as service:
        second = Agent(tmp_path, service.address).connect()
        wait_until(lambda: len(service.applied) > 5)
        second.die()
        assert not service.finished
        service.answer_delay_s = 0.0
        third = Agent(tmp_path, service.address)
        assert third.store.leftovers is not None
        third.store.leftovers.start()
        wait_until(lambda: service.finished)
        third.die()
    assert sorted(service.applied) == list(range(1, 41))
    assert service.holes == []


def test_a_run_that_the_service_has_finished_without_its_bye_is_set_aside_and_counted(
    tmp_path: Path, clock: dict[str, float]
):
    first = of_before(tmp_path, clock, frames=7)
    with FakeService(finished=True) as service:
        second = Agent(tmp_path, service.address)
        assert second.store.leftovers is not None
        second.store.leftovers.start()
        wait_until(lambda: not second.store.sends_leftovers)
        assert second.store.leftovers.errors == {"refused": 7}
        second.die()
    assert (tmp_path / "spool" / "refused" / first.store.run.value / "hello").exists()
    assert first.store.run.value not in spool_folders(tmp_path)
    shown = [s for m in second.metrics.registry.collect() for s in m.samples if s.name.endswith("spool_errors_total")]
    assert [(s.labels["kind"], s.value) for s in shown if s.value] == [("refused", 7.0)]


def test_a_run_whose_last_word_was_bye_is_complete_when_the_service_calls_it_finished(tmp_path: Path):
    first = Agent(tmp_path)
    first.make(1, 7)
    first.store.say_bye(7)
    first.die()
    with FakeService(finished=True) as service:
        second = Agent(tmp_path, service.address)
        assert not second.store.run.continued
        assert second.store.leftovers is not None
        second.store.leftovers.start()
        wait_until(lambda: not second.store.sends_leftovers)
        assert second.store.leftovers.errors == {}
        second.die()
    assert spool_folders(tmp_path) == [second.store.run.value]


def test_when_the_live_session_is_over_its_frames_are_set_aside_and_the_next_start_is_a_new_run(tmp_path: Path):
    with FakeService(finished=True) as service:
        first = Agent(tmp_path, service.address)
        first.make(1, 4)
        first.connect()
        with pytest.raises(SessionOverError, match="finished"):
            first.uplink.wait_welcome()
        first.store.over()
        first.die()
    assert first.store.spool is not None
    assert first.store.spool.errors == {"refused": 4}
    assert len(list((tmp_path / "spool" / "refused" / first.store.run.value).glob("*.seg"))) == 1
    second = Agent(tmp_path)
    assert not second.store.run.continued
    assert second.store.leftovers is not None
    assert second.store.leftovers._runs == []
    second.die()


def test_what_the_service_may_take_another_day_stays(tmp_path: Path, clock: dict[str, float]):
    first = of_before(tmp_path, clock, frames=7)
    refused = pb.Refused(reason=pb.REFUSED_REASON_VERSION, detail="codec version 2: this service decodes 1")
    with FakeService(hello_replies=[pb.StreamResponse(refused=refused)]) as service:
        second = Agent(tmp_path, service.address)
        assert second.store.leftovers is not None
        second.store.leftovers.start()
        wait_until(lambda: not second.store.sends_leftovers)
        assert second.store.leftovers.errors == {"refused": 7}
        second.die()
    assert first.store.run.value in spool_folders(tmp_path)


def test_refused_runs_make_room_when_it_is_short(tmp_path: Path):
    (tmp_path / "spool" / "refused" / "old").mkdir(parents=True)
    (tmp_path / "spool" / "refused" / "old" / "00000001.seg").write_bytes(bytes(300_000))
    config = {"robot": "r", "source": {"recording": "r"}, "state_dir": str(tmp_path), "spool": {"max_bytes": 500_000}}
    store = RunStore(validate(AgentConfig, config, "test"), hello(), EdgeMetrics())
    store.close()
    assert not (tmp_path / "spool" / "refused" / "old").exists()


def test_what_a_run_has_lost_is_counted_on_by_the_next_agent(tmp_path: Path, clock: dict[str, float]):
    first = Agent(tmp_path)
    first.metrics.drop("few_points", 3)
    clock["s"] += 2.0
    first.make(1, 2)
    first.die()
    second = Agent(tmp_path)
    second.metrics.drop("few_points")
    assert second.metrics.all_dropped() == {"few_points": 4}
    second.die()


def test_two_agents_cannot_use_one_spool(tmp_path: Path):
    first = Agent(tmp_path)
    with pytest.raises(InputError, match=r"^spool .*: in use; expected a directory of its own for each agent"):
        Agent(tmp_path)
    first.die()
    Agent(tmp_path).die()


def test_a_directory_that_cannot_be_used_is_one_line(tmp_path: Path):
    (tmp_path / "file").write_text("")
    config = {"robot": "r", "source": {"recording": "r"}, "spool": {"dir": str(tmp_path / "file")}}
    with pytest.raises(InputError, match=r"^spool .*file: .*; expected a directory that can be written$"):
        RunStore(validate(AgentConfig, config, "test"), hello(), EdgeMetrics())


def test_the_state_file_is_written_over_in_place(tmp_path: Path, clock: dict[str, float]):
    agent = Agent(tmp_path)
    inode = (tmp_path / "run.json").stat().st_ino
    clock["s"] += 5.0
    agent.make(1, 1)
    saved = json.loads((tmp_path / "run.json").read_text())
    assert (saved["since_boot_s"], saved["spooled"]) == (1005.0, True)
    assert (tmp_path / "run.json").stat().st_ino == inode
    agent.die()


def test_leftovers_take_a_share_of_a_limited_uplink_and_live_frames_leave_it_to_them(
    tmp_path: Path, clock: dict[str, float]
):
    of_before(tmp_path, clock, frames=3)
    values = {"robot": "r", "source": {"recording": "r"}, "state_dir": str(tmp_path), "uplink": {"max_kbps": 100}}
    config = validate(AgentConfig, values, "test")
    store = RunStore(config, hello(), EdgeMetrics())
    uplink = Uplink(config.server, hello(), UplinkConfig(), EdgeMetrics(), None, lambda: store.sends_leftovers)
    assert not uplink.backlog
    assert store.leftovers is not None
    assert store.leftovers._settings.max_kbps == 30.0
    store.leftovers.start()
    assert uplink.backlog
    store.close()
    assert not uplink.backlog
