"""Both programs on one drive: /metrics says what report.json says, and the logs of both name its frames alike."""

from __future__ import annotations

import json
import subprocess
import time
import urllib.request
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import yaml
from prometheus_client.parser import text_string_to_metric_families

from edge_agent.metric_list import EDGE_METRICS
from map_service.metric_list import MAP_METRICS
from splitslam.metrics import BUILD_INFO, Kind, Metric
from splitslam.report.numbers import assemble
from splitslam.run.session_client import session_client
from splitslam.security.settings import ClientTls
from splitslam.stack.process import wait_until
from splitslam.trace import trace_id
from tests.e2e.commands import BIN

SCANS = 100
ROBOT = "rover-7"
Labels = frozenset[tuple[str, str]]


class Page:
    """What /metrics has shown: values by name and labels."""

    def __init__(self, text: str) -> None:
        families = text_string_to_metric_families(text)
        samples = [sample for family in families for sample in family.samples]
        self.values = {(s.name, frozenset(s.labels.items())): s.value for s in samples}

    def value(self, name: str, **labels: str) -> float:
        return self.values[name, frozenset(labels.items())]

    def by(self, name: str, label: str) -> dict[str, float]:
        """What is not zero."""
        found = {dict(labels)[label]: value for (n, labels), value in self.values.items() if n == name}
        return {key: value for key, value in found.items() if value}

    def series(self, metric: Metric) -> set[Labels]:
        name = f"{metric.name}_count" if metric.kind == Kind.HISTOGRAM else metric.shown
        return {labels for n, labels in self.values if n == name}


@dataclass(frozen=True)
class Drive:
    """A finished drive; robots: gauges by robot as they were seen while it went on."""

    edge: Page
    service: Page
    robots: list[Page]
    report: dict[str, Any]
    statistics: dict[str, Any]
    run_id: str
    edge_log: list[dict[str, Any]]
    service_log: list[dict[str, Any]]


def scrape(address: str) -> Page:
    with urllib.request.urlopen(f"http://{address}/metrics", timeout=30) as page:
        return Page(page.read().decode())


def lines(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines() if line.startswith("{")]


@pytest.fixture(scope="module")
def drive(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Drive:
    folder = tmp_path_factory.mktemp("operation")
    log = {"format": "json", "level": "debug"}
    service = {
        "listen": "127.0.0.1:0",
        "store": f"sqlite:///{folder}/map.sqlite",
        "workers": 1,
        "metrics": {"port": 0, "per_robot": True},
        "log": log,
    }
    (folder / "service.yaml").write_text(yaml.safe_dump(service))
    recording = shared_data / "yard1" / "yard1.bag"
    robot = yaml.safe_load(recording.with_suffix(".yaml").read_text())
    robot["robot"] = {"id": ROBOT}
    (folder / "robot.yaml").write_text(yaml.safe_dump(robot))
    with (folder / "service.log").open("w") as service_log, (folder / "edge.log").open("w") as edge_log:
        command = [str(BIN / "map-service"), "serve", "--config", str(folder / "service.yaml")]
        rack = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=service_log, text=True)
        assert rack.stdout is not None
        try:
            started = json.loads(rack.stdout.readline())
            agent = {
                "robot": str(folder / "robot.yaml"),
                "server": started["grpc"],
                "source": {"recording": str(recording), "realtime": True, "max_scans": SCANS},
                "output": {"dir": str(folder / "out")},
                "metrics": {"port": None},
                "log": log,
            }
            (folder / "agent.yaml").write_text(yaml.safe_dump(agent))
            command = [str(BIN / "edge-agent"), "run", "--config", str(folder / "agent.yaml")]
            edge = subprocess.Popen(command, stderr=edge_log)
            robots = []
            while edge.poll() is None:
                robots.append(scrape(started["metrics"]))
                time.sleep(0.5)
            assert edge.returncode == 0, (folder / "edge.log").read_text()
            report = json.loads((folder / "out" / "edge.json").read_text())
            with session_client(started["grpc"], report["session_id"], ClientTls()) as session:
                info, statistics = session.info()
                trajectory = session.trajectory()
            sessions = "splitslam_map_sessions"
            wait_until(lambda: scrape(started["metrics"]).by(sessions, "state") == {}, 30.0, "the session let go")
            time.sleep(1.0)  # two beats of the worker
            page = scrape(started["metrics"])
        finally:
            rack.terminate()
            rack.wait(60)
            rack.stdout.close()
    return Drive(
        edge=Page((folder / "out" / "metrics.prom").read_text()),
        service=page,
        robots=robots,
        report=assemble(report, info, statistics, trajectory),
        statistics=statistics,
        run_id=report["run_id"],
        edge_log=lines(folder / "edge.log"),
        service_log=lines(folder / "service.log"),
    )


def test_the_edges_counts_are_those_of_the_report(drive: Drive) -> None:
    page, report = drive.edge, drive.report
    scans = page.by("splitslam_edge_scans_total", "result")
    assert scans == {name: report["scans"][name] for name in ("read", "sent", "mapped")}
    assert scans["mapped"] > SCANS / 2
    assert page.by("splitslam_edge_dropped_total", "reason") == report["dropped_by_reason"]
    assert page.value("splitslam_edge_tcp_sent_bytes_total") == report["uplink"]["bytes"]
    assert page.value("splitslam_edge_tcp_received_bytes_total") == report["downlink"]["bytes"]
    uplink = page.by("splitslam_edge_uplink_bytes_total", "kind")
    assert report["uplink"]["payload_bytes"] < uplink["frame"] < report["uplink"]["bytes"]
    assert set(page.by("splitslam_edge_downlink_bytes_total", "kind")) == {"welcome", "odometry", "credit", "finished"}
    for stage, times in report["edge_ms"].items():
        assert page.value("splitslam_edge_stage_seconds_count", stage=stage) == scans["sent"]
        seconds = page.value("splitslam_edge_stage_seconds_sum", stage=stage)
        assert seconds == pytest.approx(times["mean"] * 1e-3 * scans["sent"])
    assert page.value("splitslam_edge_round_trip_seconds_count") == scans["mapped"]
    corrections = page.by("splitslam_edge_corrections_total", "cause")
    assert sum(corrections.values()) == report["jumps"]["map_count"]
    assert page.by("splitslam_edge_deskew_troubles_total", "cause") == report["deskew"]["troubles"]
    assert page.value("splitslam_edge_outages_total") == report["outages"]["count"]


def test_scans_leave_the_robot_within_their_age_and_with_the_bits_a_point_that_their_frames_have(drive: Drive) -> None:
    page, sent = drive.edge, drive.report["scans"]["sent"]
    assert page.value("splitslam_edge_scan_age_seconds_count") == sent
    assert page.value("splitslam_edge_scan_age_seconds_sum") / sent > drive.report["edge_ms"]["total"]["mean"] * 1e-3
    frames = sum(page.value("splitslam_edge_point_bytes_count", frame=kind) for kind in ("dense", "sparse"))
    assert frames == sent
    mean_bits = 8 * page.value("splitslam_edge_point_bytes_sum", frame="dense")
    mean_bits /= page.value("splitslam_edge_point_bytes_count", frame="dense")
    assert 4 < mean_bits < 24


def test_the_services_counts_are_those_of_the_report(drive: Drive) -> None:
    page, report, statistics = drive.service, drive.report, drive.statistics
    mapped = report["scans"]["mapped"]
    assert page.by("splitslam_map_frames_total", "result") == {"mapped": mapped}
    assert page.value("splitslam_map_answer_seconds_count") == mapped
    assert page.value("splitslam_map_keyframes_total") == report["keyframes"]
    assert page.value("splitslam_map_loops_total", result="accepted") == report["loops"]
    gnss = page.by("splitslam_map_gnss_total", "result")
    assert gnss.pop("accepted", 0) == report["gnss_factors"]
    assert gnss == {reason: count for reason, count in report["gnss_rejected"].items() if count}
    assert report["gnss_factors"] > 0
    assert page.by("splitslam_map_corrections_total", "cause") == statistics["corrections"]
    registrations = page.by("splitslam_map_registrations_total", "result")
    assert sum(registrations.values()) == mapped - 1
    assert registrations.get("degenerate", 0) == statistics["degenerate_frames"]
    assert page.value("splitslam_map_registration_iterations_sum") == statistics["registration_iterations"]
    assert page.value("splitslam_map_registration_inlier_ratio_count") == mapped - 1
    seconds = page.value("splitslam_map_stage_seconds_sum", stage="registration")
    assert seconds == pytest.approx(statistics["map_ms"]["registration"]["mean"] * 1e-3 * mapped)
    assert page.value("splitslam_map_commit_bytes_sum") == report["store_bytes"]
    assert page.by("splitslam_map_stream_ends_total", "status") == {"ok": 1}
    assert page.by("splitslam_map_sessions", "state") == {}


def test_a_robots_gauges_are_there_while_it_drives_and_gone_when_its_session_has_ended(drive: Drive) -> None:
    counts = [page.values.get(("splitslam_map_robot_scans", frozenset({("robot", ROBOT)}))) for page in drive.robots]
    seen = [count for count in counts if count is not None]
    assert seen == sorted(seen)
    assert seen[-1] > seen[0]
    while_driving = drive.robots[counts.index(seen[-1])]
    assert while_driving.value("splitslam_map_robot_state", robot=ROBOT) in (2, 3)
    assert 0 <= while_driving.value("splitslam_map_robot_answer_age_seconds", robot=ROBOT) < 10
    assert 0 < while_driving.value("splitslam_map_robot_position_sigma_metres", robot=ROBOT) < 1
    assert not [name for name, labels in drive.service.values if ("robot", ROBOT) in labels]


def test_every_series_there_can_be_is_there_and_no_other(drive: Drive) -> None:
    """Robot and run are told to the service and are no label of it but where they are asked for."""
    given = {"worker": ["0"], "site": ["other"], "robot": []}
    for page, metrics in ((drive.edge, EDGE_METRICS), (drive.service, MAP_METRICS)):
        for metric in metrics:
            expected = {frozenset(zip(metric.label_names, values, strict=True)) for values in metric.series(given)}
            assert page.series(metric) == expected, metric.name
        listed = {metric.name for metric in (*metrics, BUILD_INFO)}
        unlisted = {name for name, _ in page.values if name.startswith("splitslam")}
        unlisted = {n for n in unlisted if not any(n.startswith(name) for name in listed)}
        assert unlisted == set()
        assert len(page.values) < 1000


def test_a_frame_is_found_by_its_trace_id_in_the_logs_of_both_sides(drive: Drive) -> None:
    sent = {line["trace_id"]: line for line in drive.edge_log if line["event"] == "frame sent"}
    answered = {line["trace_id"] for line in drive.edge_log if line["event"] in ("frame answered", "frame slow")}
    mapped = {line["trace_id"]: line for line in drive.service_log if line["event"] in ("frame", "frame slow")}
    count = drive.report["scans"]["sent"]
    assert set(sent) == {trace_id(drive.run_id, seq) for seq in range(1, count + 1)}
    assert set(mapped) == answered == set(sent)
    for trace, line in mapped.items():
        for name in ("run_id", "session_id", "robot_id", "seq"):
            assert line[name] == sent[trace][name]
        assert line["robot_id"] == ROBOT
        assert line["replica"] == "127.0.0.1:0"
