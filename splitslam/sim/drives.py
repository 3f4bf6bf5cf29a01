"""Every drive by name."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np

from splitslam.sim.places import corridor, park, quarter, street, twins
from splitslam.sim.places.ways import Waypoints
from splitslam.sim.spec import DriveSpec, HeadTurn, LidarSpec, PathSpec, SpeedChange, WorldSpec
from splitslam.sim.trajectory import MARGIN_S

_Leg = tuple[float, float, float]


def _speeds(path: PathSpec, legs: tuple[_Leg, ...], stop_s: float = 1.5) -> PathSpec:
    """`path` with speed changes by distance: (at_m, to_mps, over_s); after a stop the next follows in `stop_s`."""
    speed = path.speed_mps
    moving = path.accel_s == 0.0
    t_s, at_m = (-MARGIN_S, 0.0) if moving else (path.stand_s + path.accel_s, speed * path.accel_s / 2)
    changes: list[SpeedChange] = []
    for from_m, to_mps, over_s in legs:
        if speed > 0.0:
            t_s, at_m = t_s + (from_m - at_m) / speed, from_m
        else:
            t_s += stop_s
        changes.append(SpeedChange(t_s, to_mps, over_s))
        t_s, at_m, speed = t_s + over_s, at_m + over_s * (speed + to_mps) / 2, to_mps
    return replace(path, speed_changes=tuple(changes))


_CAR = PathSpec(
    waypoints_m=street.round_the_block(), speed_mps=9.0, stand_s=2.0, accel_s=3.5, height_m=1.75, gait=0.0,
    dive_deg_per_mps2=0.35,
)  # fmt: skip
_ROUND_THE_BLOCK: tuple[_Leg, ...] = (  # slow in the corners; a child on the road after the second
    *((66.0, 5.0, 2.0), (95.5, 9.0, 2.5), (131.0, 5.0, 2.0), (161.0, 9.0, 2.5), (190.0, 0.0, 2.4)),
    *((200.8, 9.0, 3.0), (234.0, 5.0, 2.0), (264.0, 9.0, 2.5), (300.0, 5.0, 2.0), (330.0, 9.0, 2.5), (372.0, 0.0, 2.6)),
)
STREET = DriveSpec(
    name="street",
    what="a vehicle round a block of houses at 9 m/s, with hard starts and stops",
    duration_s=60.0,
    world=WorldSpec("street"),
    path=_speeds(_CAR, _ROUND_THE_BLOCK),
)
MOVING_START = replace(
    STREET,
    name="moving_start",
    what="the same streets, at 9 m/s already at the first scan",
    duration_s=58.0,
    path=_speeds(replace(_CAR, stand_s=0.0, accel_s=0.0), _ROUND_THE_BLOCK),
)
CORRIDOR = DriveSpec(
    name="corridor",
    what="a smooth tunnel of 126 m, about 22 s without anything to see along it, then a hall",
    duration_s=60.0,
    world=WorldSpec("corridor"),
    path=_speeds(
        PathSpec(waypoints_m=corridor.through_the_tunnel(), closed=False, speed_mps=3.0, stand_s=2.0, accel_s=2.0,
                 height_m=0.85, gait=0.0),
        ((134.0, 1.5, 1.5), (158.0, 0.0, 1.5)),
    ),
    lidar=LidarSpec(max_range_m=30.0),  # dusty air, and walls at grazing incidence: far surfaces do not answer
    gnss=None,
)  # fmt: skip
PARK = DriveSpec(
    name="park",
    what="on foot over a hill among trees and bushes, head turns of 200 deg/s",
    duration_s=55.0,
    world=WorldSpec("park"),
    path=PathSpec(
        waypoints_m=park.short_round(),
        speed_mps=1.4,
        head_turns=(
            *(HeadTurn(7.0, 88.0, 1.55), HeadTurn(13.5, -85.0, 1.5), HeadTurn(21.0, 95.0, 1.65)),
            *(HeadTurn(28.0, -80.0, 1.4), HeadTurn(36.5, 84.0, 1.45), HeadTurn(45.0, -90.0, 1.6)),
        ),
    ),
)
TWINS = DriveSpec(
    name="twins",
    what="three identical corridors with identical rooms, then the first again: only that is a loop",
    duration_s=60.0,
    world=WorldSpec("twins"),
    path=_speeds(
        PathSpec(waypoints_m=twins.through_all_corridors(), closed=False, speed_mps=2.0, stand_s=2.0, accel_s=1.5,
                 height_m=0.85, gait=0.0),
        ((103.0, 0.0, 1.5),),
    ),
    gnss=None,
)  # fmt: skip


def _long_form(name: str, place: str, waypoints: Waypoints, scans: int, length_m: float, turn_deg: float) -> DriveSpec:
    """A drive on foot with the figures of a row of the paper's Table I."""
    duration_s, stand_s, accel_s = scans / 10.0, 2.5, 1.5
    head_turns = [
        HeadTurn(t_s, float(sign * turn_deg), 2.0)
        for t_s, sign in zip(np.arange(12.0, duration_s - 5.0, 17.0).tolist(), itertools.cycle((1, -1)), strict=False)
    ]
    speed_mps = length_m / (duration_s - stand_s - accel_s / 2)
    path = PathSpec(waypoints_m=waypoints, speed_mps=speed_mps, stand_s=stand_s, accel_s=accel_s, gait=0.6,
                    head_turns=tuple(head_turns))  # fmt: skip
    what = f"on foot, with the figures of the paper's {name.removeprefix('paper_').capitalize()} data (Table I)"
    return DriveSpec(name=name, what=what, duration_s=duration_s, world=WorldSpec(place), path=path)


PAPER_WALKING = _long_form("paper_walking", "quarter", quarter.walking_way(), 6502, 799.0, 67.0)
PAPER_CAMPUS = _long_form("paper_campus", "quarter", quarter.campus_way(), 9865, 1434.0, 55.0)
PAPER_PARK = _long_form("paper_park", "park", park.long_round(), 24691, 2867.0, 123.0)

CAMPUS = DriveSpec(
    name="campus",
    what="on foot from a yard through a gate to a street, back over a green, and past the start",
    duration_s=60.0,
    path=PathSpec(
        waypoints_m=(
            *((-8.6, 2.0), (-8.0, -2.0), (-6.4, -6.2), (-4.4, -9.8), (-3.6, -13.2), (-5.6, -15.3), (-11.0, -15.4)),
            *((-18.0, -15.3), (-25.0, -15.4), (-29.5, -15.6), (-31.4, -14.2), (-30.2, -11.2), (-25.5, -9.2)),
            *((-20.8, -9.2), (-18.4, -11.2), (-14.4, -10.6), (-10.8, -8.0), (-9.2, -3.8), (-8.8, 1.0)),
            *((-7.0, 4.6), (-2.5, 5.6), (2.5, 5.6), (5.5, 8.0), (0.0, 8.2), (-6.0, 7.4)),
        ),
        speed_mps=1.65,
        head_turns=(
            *(HeadTurn(8.0, 50.0, 2.0), HeadTurn(17.0, -60.0, 2.2), HeadTurn(27.0, 62.0, 1.9)),
            *(HeadTurn(37.0, -55.0, 1.8), HeadTurn(48.0, 60.0, 2.0)),
        ),
    ),
)

DRIVES = {
    spec.name: spec
    for spec in (
        *(CAMPUS, PARK, CORRIDOR, TWINS, STREET, MOVING_START),
        *(PAPER_WALKING, PAPER_CAMPUS, PAPER_PARK),
    )
}
