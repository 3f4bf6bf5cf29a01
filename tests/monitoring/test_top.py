"""`splitslam top`: what it reads, what it says of what cannot be read, and what it shows."""

from __future__ import annotations

import http.server
import io
import json
import math
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import pytest
from prometheus_client import CollectorRegistry, generate_latest
from rich.console import Console

from edge_agent.metrics import EdgeMetrics
from map_service.config import ServiceConfig
from map_service.metrics import ServiceMetrics
from splitslam.errors import InputError
from splitslam.stack.process import free_port
from splitslam.top.command import Top
from splitslam.top.endpoint import Endpoint
from splitslam.top.page import Page, Span
from splitslam.top.rows import ReplicaRow, RobotRow, Silent, row_of
from splitslam.top.trouble import GRAVE, Event, Journal, Watch
from splitslam.top.view import Screen, render
from tests.commands.test_cli import finished

Serve = Callable[[Callable[[], tuple[int, bytes]]], str]


@pytest.fixture
def serve() -> Iterator[Serve]:
    """serve(answer): HOST:PORT of a server whose every page is what `answer` says: status and text."""
    servers: list[http.server.ThreadingHTTPServer] = []

    def start(answer: Callable[[], tuple[int, bytes]]) -> str:
        class Handler(http.server.BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                status, text = answer()
                self.send_response(status)
                self.end_headers()
                self.wfile.write(text)

            def log_message(self, *_: object) -> None:
                pass

        server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        servers.append(server)
        threading.Thread(target=server.serve_forever, daemon=True).start()
        return f"127.0.0.1:{server.server_port}"

    yield start
    for server in servers:
        server.shutdown()
        server.server_close()


def page(text: str, at_s: float = 0.0) -> Page:
    return Page.parse(text, at_s)


def buckets(counts: dict[str, int]) -> str:
    return "# TYPE t histogram\n" + "".join(f't_bucket{{le="{le}"}} {n}\n' for le, n in counts.items())


def as_text(screen: Screen, width: int = 120) -> str:
    console = Console(width=width, record=True, file=io.StringIO())
    console.print(render(screen))
    return console.export_text()


def serve_registry(serve: Serve, registry: CollectorRegistry) -> str:
    return serve(lambda: (200, generate_latest(registry)))


def test_rates_are_over_the_time_between_two_pages_and_survive_a_restart() -> None:
    before = page('a_total{x="1"} 100\na_total{x="2"} 5\n', 10.0)
    span = Span(before, page('a_total{x="1"} 130\na_total{x="2"} 5\n', 12.0))
    assert span.rate("a_total") == 15.0
    assert span.rate("a_total", x="2") == 0.0
    assert span.increases("a_total", "x") == {"1": 30.0, "2": 0.0}
    again = Span(before, page('a_total{x="1"} 7\na_total{x="2"} 0\n', 12.0))
    assert again.increase("a_total") == 7.0
    assert math.isnan(span.rate("b_total"))
    assert math.isnan(Span(None, before).rate("a_total"))


def test_quantiles_are_those_of_promql() -> None:
    """Worked by hand: 100 observations, rank 90 is the 10th of the 30 between 0.1 and 0.5."""
    span = Span(None, page(buckets({"0.1": 80, "0.5": 110, "+Inf": 110})))
    assert span.quantile("t", 90 / 110) == pytest.approx(0.1 + 0.4 * 10 / 30)
    assert span.quantile("t", 40 / 110) == pytest.approx(0.05)
    beyond = Span(None, page(buckets({"0.1": 50, "+Inf": 100})))
    assert beyond.quantile("t", 0.99) == 0.1, "the last bound that is known"
    assert math.isnan(Span(None, page(buckets({"0.1": 0, "+Inf": 0}))).quantile("t", 0.5))
    assert math.isnan(span.quantile("u", 0.5))


def test_what_cannot_be_read_is_a_row_that_says_why(serve: Serve) -> None:
    pages = {
        "connection refused": f"127.0.0.1:{free_port()}",
        "HTTP 503": serve(lambda: (503, b"")),
        "not a metrics page": serve(lambda: (200, b"<html>hello</html>")),
        "not a SplitSLAM program": serve(lambda: (200, b"up 1\n")),
    }
    top = Top(tuple(pages.values()))
    top.read()
    assert [(row.name, row.problem) for row in top.rows if isinstance(row, Silent)] == [
        (a, p) for p, a in pages.items()
    ]
    text = as_text(top.screen())
    assert all(problem in text for problem in pages)
    top.read()
    assert as_text(top.screen()).count("HTTP 503") == 2, "in its row, and once among what happened"


@dataclass
class Kept:
    """What a robot still owes."""

    frames: int
    bytes: int

    def __len__(self) -> int:
        return self.frames


def test_a_robot_and_a_replica_are_told_apart_and_shown_with_their_figures(serve: Serve) -> None:
    edge = EdgeMetrics()
    edge.state.set(2)
    edge.drop("buffer_full", 3)
    edge.kept_from(Kept(70, 190_000), None)
    service = ServiceMetrics(ServiceConfig())
    service.streams.set(4)
    top = Top((serve_registry(serve, edge.registry), serve_registry(serve, service.registry)))
    top.read()
    edge.round_trip.observe_s(0.7)
    edge.sent("frame", 20_000)
    top.read()
    robot, replica = top.rows
    assert isinstance(robot, RobotRow)
    assert isinstance(replica, ReplicaRow)
    assert (robot.state, robot.dropped, robot.waiting, robot.alone) == ("tracking", 3.0, 70.0, False)
    assert 0.5 < robot.round_trip_p50_s < 1.0
    assert robot.uplink_kbps > 0.0
    assert (replica.streams, replica.restarts) == (4.0, 0.0)
    text = as_text(top.screen())
    assert "1 of 1 robots tracking" in text
    assert "1 replica," in text


def test_what_happens_between_two_readings_is_said_once_and_added_up(serve: Serve) -> None:
    edge = EdgeMetrics()
    edge.state.set(2)
    endpoint = Endpoint(serve_registry(serve, edge.registry))
    watch, journal = Watch(endpoint), Journal(4)
    edge.drop("nan", 5)  # before anybody looked
    said = []
    for change in (lambda: None, lambda: edge.drop("nan", 2), lambda: edge.drop("nan"), lambda: edge.state.set(6)):
        change()
        endpoint.read()
        said.append(watch.events())
        for event in said[-1]:
            journal.add("12:00:00", event)
    who = endpoint.address
    assert said[:3] == [[], [Event(who, "lost: nan", GRAVE, 2)], [Event(who, "lost: nan", GRAVE)]]
    assert said[3] == [Event(who, "tracking → lost", GRAVE)]
    assert [event.text for _, event in journal.lines] == ["lost: nan × 3", "tracking → lost"]


def test_an_endpoint_that_comes_back_says_so(serve: Serve) -> None:
    edge, down = EdgeMetrics(), [False]
    endpoint = Endpoint(serve(lambda: (503, b"") if down[0] else (200, generate_latest(edge.registry))))
    watch, said = Watch(endpoint), []
    for down[0] in (False, True, True, False):
        endpoint.read()
        said.append([event.what for event in watch.events()])
    assert said == [[], ["HTTP 503"], [], ["answers again"]]
    assert isinstance(row_of(endpoint), RobotRow)


@pytest.mark.parametrize("address", ["rover", "rover:port", "ftp://rover:9464/metrics", "http://:80"])
def test_an_address_that_is_none_is_one_line(address: str) -> None:
    with pytest.raises(InputError, match="expected HOST:PORT or a URL"):
        Endpoint(address)


def test_in_a_script_it_prints_once_and_its_exit_code_tells(serve: Serve) -> None:
    edge = EdgeMetrics()
    good, bad = serve_registry(serve, edge.registry), f"127.0.0.1:{free_port()}"
    exit_code, out, err = finished("top", good, "--json", "--every", "0.1")
    assert (exit_code, err) == (0, "")
    (row,) = json.loads(out)
    assert (row["kind"], row["name"], row["dropped"]) == ("robot", good, 0.0)
    exit_code, out, _ = finished("top", good, bad, "--once", "--every", "0.1")
    assert exit_code == 1
    assert good in out
    assert "connection refused" in out
    assert finished("top", good, "--every", "0")[0] == 2
