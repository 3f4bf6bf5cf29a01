"""What the wire says is looked at before it is believed."""

from __future__ import annotations

import pytest

from map_service.messages import fixes_from_wire
from splitslam.wire import types_pb2 as pb

GOOD = {"stamp_ns": 5, "latitude_deg": 48.0, "longitude_deg": 11.0, "altitude_m": 520.0, "covariance_enu_m2": [1.0] * 9}


@pytest.mark.parametrize(
    "wrong",
    [
        {"latitude_deg": 90.1},
        {"longitude_deg": -180.1},
        {"altitude_m": 1.1e5},
        {"altitude_m": -1e30},
        {"altitude_m": float("nan")},
        {"covariance_enu_m2": [1.0] * 8},
        {"covariance_enu_m2": [*[1.0] * 8, float("inf")]},
    ],
)
def test_a_fix_that_cannot_be_on_earth_is_counted_and_not_used(wrong: dict) -> None:
    fixes, unusable = fixes_from_wire([pb.GnssFix(**GOOD), pb.GnssFix(**(GOOD | wrong))])
    assert ([fix.altitude_m for fix in fixes], unusable) == ([520.0], 1)
