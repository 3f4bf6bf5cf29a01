"""A service that all share, and who asks it."""

from __future__ import annotations

from collections.abc import Iterator

import grpc
import pytest

from splitslam.map_client import MapClient
from splitslam.wire import pose_pb2_grpc as rpc
from tests.map_service.harness import Service


@pytest.fixture
def service(shared_service: Service) -> Service:
    """One for all that leave it as it is; what is asked for without a name is asked for by site."""
    return shared_service


@pytest.fixture
def client(service: Service) -> Iterator[MapClient]:
    with MapClient(service.address) as made:
        yield made


@pytest.fixture
def stub(service: Service) -> Iterator[rpc.PoseServiceStub]:
    with grpc.insecure_channel(service.address) as channel:
        yield rpc.PoseServiceStub(channel)
