"""What the LiDAR's faults do to beams, each against the geometry it comes from."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from splitslam.sim.beams import Beams
from splitslam.sim.lidar import FIRING_NS, LASERS, Sweep, Vlp16, packets
from splitslam.sim.mesh import Mesh
from splitslam.sim.place import Place
from splitslam.sim.places.materials import GLASS, PLASTER, STONE
from splitslam.sim.spec import DriveSpec, Perturbations
from splitslam.sim.trajectory import Trajectory, drive_trajectory, make_trajectory
from splitslam.sim.world import World, make_world
from tests.sim.drives import SHORT

Array = NDArray[np.float64]

FLAT = 5.0  # the nearer surface of the made walls, m
BEHIND = 5.5


def _world(mesh: Mesh) -> World:
    return World(Place(*mesh.arrays(), ground_m=lambda x, y: np.zeros_like(x), walkways=()))


def _wall(mesh: Mesh, x_m: float, y: tuple[float, float], reflectivity: int = PLASTER) -> None:
    corners = [[x_m, y[0], -9.0], [x_m, y[1], -9.0], [x_m, y[1], 9.0], [x_m, y[0], 9.0]]
    mesh.quads(np.array([corners]), reflectivity=reflectivity)


def _fan(half_deg: float, count: int) -> tuple[Array, Array, Array]:
    """Beams from the origin into the horizontal plane round +x: times, origins, directions."""
    azimuth = np.radians(np.linspace(-half_deg, half_deg, count))
    directions = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(count)], axis=1)
    return np.zeros(count), np.zeros((count, 3)), directions


def _beams(world: World, **faults: float) -> Beams:
    spec = replace(SHORT, perturbations=replace(Perturbations(), **faults))
    return Beams(spec, world, make_trajectory(spec.path, world.place, spec.duration_s))


def test_at_an_edge_wide_beams_report_ranges_between_the_two_surfaces() -> None:
    mesh = Mesh()
    _wall(mesh, FLAT, (-9.0, 0.0))
    _wall(mesh, BEHIND, (-9.0, 9.0))
    fan = _fan(0.5, 4_001)
    sharp = _beams(_world(mesh)).cast(0, *fan).range_m
    wide = _beams(_world(mesh), mixed_pixels_mrad=3.0).cast(0, *fan).range_m
    azimuth_rad = np.radians(np.linspace(-0.5, 0.5, 4_001))
    between = (wide > FLAT + 0.02) & (wide < BEHIND - 0.02)
    assert not ((sharp > FLAT + 0.02) & (sharp < BEHIND - 0.02)).any()
    assert between.sum() > 50
    assert np.abs(azimuth_rad[between]).max() <= 1.5e-3, "only beams whose width reaches over the edge are split"
    np.testing.assert_array_equal(wide[np.abs(azimuth_rad) > 1.5e-3], sharp[np.abs(azimuth_rad) > 1.5e-3])


def test_surfaces_farther_apart_than_a_pulse_give_one_or_the_other() -> None:
    mesh = Mesh()
    _wall(mesh, FLAT, (-9.0, 0.0))
    _wall(mesh, FLAT + 2.0, (-9.0, 9.0))
    wide = _beams(_world(mesh), mixed_pixels_mrad=3.0).cast(0, *_fan(0.1, 2_001)).range_m
    assert (np.minimum(np.abs(wide - FLAT), np.abs(wide - FLAT - 2.0)) < 1e-3).all()


def test_wide_beams_change_nothing_on_a_tilted_plane() -> None:
    mesh = Mesh()
    mesh.quads(np.array([[[2.0, -9, -9], [20.0, 9, -9], [20.0, 9, 9], [2.0, -9, 9]]], float), reflectivity=STONE)
    world, fan = _world(mesh), _fan(20.0, 2_000)
    wide = _beams(world, mixed_pixels_mrad=3.0).cast(0, *fan)
    np.testing.assert_array_equal(wide.range_m, _beams(world).cast(0, *fan).range_m)


def test_clean_glass_is_seen_through_and_dirty_glass_is_seen() -> None:
    mesh = Mesh()
    _wall(mesh, FLAT, (-9.0, 9.0), GLASS)
    _wall(mesh, BEHIND, (-9.0, 9.0))
    fan = _fan(30.0, 601)
    straight = fan[2][:, 0]
    np.testing.assert_allclose(_beams(_world(mesh)).cast(0, *fan).range_m * straight, FLAT, atol=1e-4)
    clean = _beams(_world(mesh), glass=1.0).cast(0, *fan).range_m * straight
    aside = np.abs(np.linspace(-30.0, 30.0, 601)) > 4.0
    np.testing.assert_allclose(clean[aside], BEHIND, atol=1e-4)
    assert clean[300] == pytest.approx(FLAT, abs=1e-4), "square on, a pane shines back"


def test_glass_before_nothing_mirrors_what_stands_before_it() -> None:
    mesh = Mesh()
    _wall(mesh, FLAT, (-9.0, 9.0), GLASS)
    _wall(mesh, -3.0, (-9.0, 9.0))
    fan = _fan(30.0, 61)
    seen = _beams(_world(mesh), glass=1.0).cast(0, *fan).range_m * fan[2][:, 0]
    aside = np.abs(np.linspace(-30.0, 30.0, 61)) > 4.0
    np.testing.assert_allclose(seen[aside], FLAT + (FLAT + 3.0), atol=1e-3)


def test_glass_before_nothing_drops_the_beam() -> None:
    mesh = Mesh()
    _wall(mesh, FLAT, (-9.0, 9.0), GLASS)
    echo = _beams(_world(mesh), glass=1.0).cast(0, *_fan(30.0, 61)).strength
    assert (echo[[0, 10, 50, 60]] < SHORT.lidar.detection).all()
    assert echo[30] > SHORT.lidar.detection


@pytest.fixture(scope="module")
def standing() -> tuple[DriveSpec, World, Trajectory]:
    """A second of standing in the campus with a sensor without noise."""
    spec = replace(SHORT, duration_s=1.0, lidar=replace(SHORT.lidar, range_noise_m=0.0))
    world = make_world(spec.world)
    return spec, world, make_trajectory(replace(spec.path, stand_s=9.0), world.place, spec.duration_s)


def _sweeps(standing: tuple[DriveSpec, World, Trajectory], **faults: float) -> Iterator[Sweep]:
    spec, world, trajectory = standing
    return Vlp16(replace(spec, perturbations=replace(Perturbations(), **faults)), world, trajectory).sweeps()


def test_a_laser_bias_is_in_the_packets_one_constant_a_laser(standing: tuple[DriveSpec, World, Trajectory]) -> None:
    clean, biased = (_sent_m(next(_sweeps(standing, laser_bias_m=bias))) for bias in (0.0, 0.02))
    both = (clean > 0) & (biased > 0)
    error = [np.unique(np.rint((biased - clean)[both[:, laser], laser] / 0.002)) for laser in range(LASERS)]
    assert max(len(steps) for steps in error) <= 2, "constant to the packet's step of 2 mm"
    middle_m = np.array([steps.mean() for steps in error]) * 0.002
    assert 0.01 < middle_m.std() < 0.03


def test_the_incidence_bias_grows_with_the_tilt(standing: tuple[DriveSpec, World, Trajectory]) -> None:
    spec, world, trajectory = standing
    clean, biased = next(_sweeps(standing)), next(_sweeps(standing, incidence_bias_m=0.05))
    _, origins, directions = Vlp16(spec, world, trajectory).rays(np.arange(len(clean.range_m)))
    tilt_deg = np.degrees(np.arccos(world.cast(origins, directions).cos_incidence)).reshape(-1, LASERS)
    seen = (clean.range_m > 0) & (biased.range_m > 0)
    error_m, tilt_deg = (biased.range_m - clean.range_m)[seen], tilt_deg[seen]
    assert error_m[tilt_deg < 10.0].max() < 0.002
    assert error_m[(tilt_deg > 44.0) & (tilt_deg < 46.0)].mean() == pytest.approx(
        0.05 / np.tan(np.radians(80)), rel=0.1
    )
    assert error_m[tilt_deg > 80.0] == pytest.approx(0.05)


def test_half_the_view_is_blocked_and_the_other_half_is_as_before(
    standing: tuple[DriveSpec, World, Trajectory],
) -> None:
    clean, half = next(_sweeps(standing)), next(_sweeps(standing, blocked_deg=180.0))
    dark = half.range_m == 0.0
    np.testing.assert_array_equal(half.range_m[~dark], clean.range_m[~dark])
    firings = dark.all(axis=1)
    assert firings.mean() == pytest.approx(0.5, abs=0.01)
    turn = 1.0 / (SHORT.lidar.rate_hz * FIRING_NS * 1e-9)
    assert firings[int(0.26 * turn) : int(0.74 * turn)].all(), "the half behind the sensor"


def test_lost_scans_are_lost_at_random_and_the_others_are_as_before(
    standing: tuple[DriveSpec, World, Trajectory],
) -> None:
    all_of_them = {sweep.first_firing: sweep for sweep in _sweeps(standing)}
    left = list(_sweeps(standing, scans_lost=0.4))
    assert 3 <= len(left) < len(all_of_them)
    for sweep in left:
        np.testing.assert_array_equal(sweep.range_m, all_of_them[sweep.first_firing].range_m)


def test_a_kidnapped_sensor_is_metres_away_after_one_blind_scan() -> None:
    faults = Perturbations(kidnap_m=5.0, kidnap_at_s=(2.05,))
    spec = replace(SHORT, perturbations=faults)
    world = make_world(spec.world)
    moved, usual = drive_trajectory(spec, world.place), make_trajectory(spec.path, world.place, spec.duration_s)
    t_s = np.array([2.04, 2.06])
    apart_m = np.linalg.norm(moved.poses(t_s)[1] - usual.poses(t_s)[1], axis=1)
    assert apart_m[0] == 0.0
    assert 4.0 < apart_m[1] <= 5.0
    seen = [np.count_nonzero(sweep.range_m) for sweep in Vlp16(spec, world, moved).sweeps()]
    assert [k for k, count in enumerate(seen) if count == 0] == [20]


def _sent_m(sweep: Sweep) -> Array:
    """Ranges (F, 16) as they are in the packets of a sweep; columns are laser ids."""
    blocks = np.concatenate([np.frombuffer(data[:1200], np.uint8) for _, data in packets(sweep, 10.0, 0)])
    returns = np.ascontiguousarray(blocks.reshape(-1, 100)[:, 4:].reshape(-1, 3)[:, :2])
    return returns.view("<u2").reshape(-1, LASERS) * 0.002
