"""Certificates are replaced while a robot drives: nobody restarts, nothing is lost."""

from __future__ import annotations

import math
import queue
import socket
import ssl
import time
from collections.abc import Iterator
from pathlib import Path

import grpc
import pytest
from cryptography import x509

from edge_agent.config import UplinkConfig
from splitslam.security.authority import Authority, Issued
from splitslam.security.client import Connector
from splitslam.security.identity import Identity
from splitslam.security.settings import ClientTls
from splitslam.stack.process import wait_until
from splitslam.stack.robot import LightRobot
from splitslam.wire import dense_pb2, dense_pb2_grpc
from tests.map_service.harness import new_run
from tests.security.fleet import FLEET, HOST, Client, Fleet, fleet_of
from tests.stack.conftest import REEL

PATIENT = UplinkConfig(welcome_timeout_s=3.0, watchdog_s=5.0)
SETTLED_S = 30.0
QUIET_GAP_S = 0.15  # between two answers at 10 Hz, of a machine with nothing else to do


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    with fleet_of(tmp_path_factory.mktemp("fleet")) as running:
        yield running


def shown_by(address: str, client: Issued, ca: Path) -> int:
    """Serial number of the certificate that a new connection to `address` is shown."""
    context = ssl.create_default_context(cafile=ca)
    context.load_cert_chain(client.path, client.path.with_suffix(".key"))
    host, _, port = address.rpartition(":")
    plain = socket.create_connection((host, int(port)), SETTLED_S)
    with context.wrap_socket(plain, server_hostname=host) as connection:
        shown = connection.getpeercert(binary_form=True)
    assert shown is not None
    return x509.load_der_x509_certificate(shown).serial_number


def test_everybodys_certificate_is_renewed_while_a_stream_runs(fleet: Fleet) -> None:
    authority = fleet.authority
    before = fleet.certificate("robot", "rover-1", "north")
    robot = LightRobot(fleet.envoy.address, REEL, "rover-1", uplink=PATIENT, tls=fleet.tls(before))
    robot.start()
    robot.wait_answers(10)
    calm_s = robot.gap_s()
    expiry = "splitslam_map_certificate_expiry_timestamp_seconds"
    old_expiry = fleet.replica.metrics()[expiry]
    renewed = {
        name: authority.renew(authority.read(authority.folder / f"{name}.pem"), days=3) for name in ("service", "envoy")
    }
    after = authority.renew(before, days=4)
    for address, name in ((fleet.replica.address, "service"), (fleet.envoy.address, "envoy")):
        serial = renewed[name].certificate.serial_number
        wait_until(lambda a=address, s=serial: shown_by(a, after, fleet.ca) == s, SETTLED_S, f"the new one of {name}")
    wait_until(lambda: fleet.envoy.healthy() == {fleet.replica.address}, SETTLED_S, "the service healthy")
    robot.wait_answers(robot.answered + 10)
    assert robot.metrics.registry.get_sample_value("splitslam_edge_reconnects_total", {"cause": "UNAVAILABLE"}) is None
    assert robot.attempt == 0
    assert robot.gap_s() < 2.0 * max(1.0, calm_s / QUIET_GAP_S)  # where undisturbed answers are late, so are these
    # Envoy's next connection to the service, and the robot's own next one, are by the new certificates
    fleet.envoy.kill()
    answered = robot.answered
    fleet.envoy.start()
    robot.wait_answers(answered + 10)
    assert fleet.replica.metrics()[expiry] == pytest.approx(renewed["service"].expires.timestamp())
    assert fleet.replica.metrics()[expiry] < old_expiry
    assert robot._uplink.certificate_expires_s() == pytest.approx(after.expires.timestamp())
    finished = robot.finish()
    assert finished.mapped == robot.sent


def test_the_authority_itself_is_replaced_by_way_of_a_file_with_both(fleet: Fleet) -> None:
    """New trust first, then new certificates, then the old trust goes (docs/security.md)."""
    old, new = fleet.authority, Authority.make(fleet.folder / "next", FLEET, 10)
    robot = new.issue(Identity(FLEET, "robot", "rover-5", "north"), 5)
    both = old.folder / "both.pem"
    both.write_bytes((old.folder / "ca.pem").read_bytes() + (new.folder / "ca.pem").read_bytes())
    client = Client(fleet.envoy.address, ClientTls(cert=robot.path, key=robot.path.with_suffix(".key"), ca=both))
    assert client.drive("rover-5") != "", "it is trusted before anybody was told"
    both.rename(old.folder / "ca.pem")
    own = ClientTls(cert=robot.path, key=robot.path.with_suffix(".key"), ca=old.folder / "ca.pem")
    client = Client(fleet.envoy.address, own)
    wait_until(lambda: client.drive("rover-5") == "", SETTLED_S, "the new authority trusted")


def test_a_half_replaced_pair_of_files_changes_nothing(fleet: Fleet) -> None:
    certificate = fleet.authority.read(fleet.authority.folder / "service.pem")
    robot = fleet.certificate("robot", "rover-6", "north")
    key = certificate.path.with_suffix(".key")
    kept = key.read_bytes()
    key.write_bytes(robot.path.with_suffix(".key").read_bytes())
    try:
        serial = certificate.certificate.serial_number
        assert shown_by(fleet.replica.address, robot, fleet.ca) == serial
        assert "expected the key of" in fleet.replica.log.read_text()
    finally:
        key.write_bytes(kept)


def test_a_certificate_that_is_revoked_loses_its_open_stream(fleet: Fleet) -> None:
    issued = fleet.certificate("robot", "rover-7", "north")
    robot = LightRobot(fleet.envoy.address, REEL, "rover-7", uplink=PATIENT, tls=fleet.tls(issued))
    robot.start()
    robot.wait_answers(5)
    fleet.authority.revoke(issued)
    wait_until(lambda: robot.failure is not None, SETTLED_S, "the stream ended")
    robot.close()
    assert "revoked" in str(robot.failure)


def test_a_certificate_that_is_revoked_sends_no_more_whole_scans_on_an_open_stream(fleet: Fleet) -> None:
    issued = fleet.certificate("robot", "rover-9", "north")
    connector = Connector(fleet.envoy.address, fleet.tls(issued))
    requests: queue.SimpleQueue[dense_pb2.UploadRequest | None] = queue.SimpleQueue()
    requests.put(dense_pb2.UploadRequest(open=dense_pb2.UploadOpen(robot_id="rover-9", run_id=new_run())))
    offer = dense_pb2.UploadRequest(offer=dense_pb2.CloudOffer(seq=1, stamp_ns=1, size=1))
    with connector.channel() as channel:
        stub = dense_pb2_grpc.DenseServiceStub(channel)
        call = stub.Upload(iter(requests.get, None), metadata=connector.metadata(), timeout=2 * SETTLED_S)
        assert next(call).verdict == dense_pb2.CLOUD_VERDICT_WANTED
        requests.put(offer)
        assert next(call).verdict == dense_pb2.CLOUD_VERDICT_NO_SESSION
        fleet.authority.revoke(issued)

        def is_refused() -> bool:
            requests.put(offer)
            return next(call, None) is None

        with pytest.raises(grpc.RpcError, match="revoked"):
            wait_until(is_refused, SETTLED_S, "the stream ended")
        requests.put(None)


def test_an_expired_certificate_is_named_by_the_robot_that_has_it(fleet: Fleet) -> None:
    issued = fleet.authority.issue(Identity(FLEET, "robot", "rover-8", "north"), -0.0001)
    impatient = UplinkConfig(connect_timeout_s=0.5)
    robot = LightRobot(fleet.envoy.address, REEL, "rover-8", uplink=impatient, tls=fleet.tls(issued))
    assert robot._uplink.certificate_expires_s() < time.time()
    robot.start()
    wait_until(lambda: robot.failure is not None, SETTLED_S, "the robot gave up")
    robot.close()
    assert "the certificate expired on 20" in str(robot.failure)


def test_without_tls_there_is_no_expiry_to_show(tmp_path: Path) -> None:
    robot = LightRobot(f"{HOST}:1", REEL, "rover-9")
    assert math.isnan(robot._uplink.certificate_expires_s())
