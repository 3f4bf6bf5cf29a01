"""Every drive by name."""

from __future__ import annotations

from dataclasses import replace

from splitslam.sim.places import corridor, park, street
from splitslam.sim.spec import DEMO, DriveSpec, HeadTurn, LidarSpec, PathSpec, SpeedChange, WorldSpec
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
CAMPUS = replace(DEMO, name="campus", what="on foot round a pavilion between buildings and trees, and the start again")
DRIVES = {spec.name: spec for spec in (CAMPUS, PARK, CORRIDOR, STREET, MOVING_START)}
