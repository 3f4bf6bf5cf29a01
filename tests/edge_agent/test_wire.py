"""What the agent takes for an answer."""

from __future__ import annotations

import numpy as np

from edge_agent.wire import answer
from splitslam.wire import session_pb2 as pb
from splitslam.wire import types_pb2 as types


def odometry(**fields: object) -> pb.Odometry:
    pose = types.Transform(tx_m=1.0, qw=1.0)
    return pb.Odometry(seq=3, pose_map_lidar=pose, pose_map_odom=pose, **fields)  # type: ignore[arg-type]


def test_an_answer_without_a_covariance_is_taken_only_when_it_is_a_repeated_one():
    again = answer(odometry(duplicate=True), 0.1).reply
    assert (again.rejected, again.T_map_lidar[0, 3]) == ("", 1.0)
    np.testing.assert_array_equal(again.covariance, np.eye(6))
    assert answer(odometry(), 0.1).reply.rejected == "corrupt_answer"


def test_a_repeated_answer_that_the_service_remembers_keeps_its_covariance():
    known = answer(odometry(duplicate=True, covariance=(np.eye(6) * 1e-4).reshape(-1)), 0.1).reply
    np.testing.assert_allclose(known.covariance, np.eye(6) * 1e-4, rtol=1e-6)


def test_an_answer_that_is_not_a_covariance_is_rejected():
    for fields in ({"covariance": [np.nan] * 36}, {"covariance": [1.0] * 35}, {"duplicate": True, "covariance": [1.0]}):
        assert answer(odometry(**fields), 0.1).reply.rejected == "corrupt_answer"
