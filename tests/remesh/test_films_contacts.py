"""Repairs of interfaces: particles of interfaces and walls, films that break, contacts that slide."""

import numpy as np
import pytest
from triangulations import areas, border, check, cloud, delaunay, grid, masses, of

from tipfem.mesh.mesh import Mesh, simplex_measure
from tipfem.mesh.relabelled import SideEnergies
from tipfem.remesh.triangles.edge_operations import ACCELERATION, HELD, MASS, SLIDES, VELOCITY
from tipfem.remesh.triangles.triangulation import Triangulation


def test_marks_are_of_interfaces_and_of_the_hull():
    for seed in range(5):
        x = cloud("walls", seed)
        cells = delaunay(x)
        t = of(x, cells, np.random.default_rng(seed).integers(0, 2, len(cells)))
        expected = np.zeros(len(x), dtype=int)
        expected[np.unique(border(t))] += 1
        expected[np.unique(border(t, hull=True))] += 2
        np.testing.assert_array_equal(t.marks(), expected)
        assert set(expected) == {0, 1, 2, 3}


def repaired(t: Triangulation, held, displacement, *, reach=0.0, film=0.0, sliver=0.0) -> tuple[int, int]:
    """How many cells of films break, and how many slivers are absorbed."""
    limits = {"reach": reach, "gap": 0.35, "least_area": 0.02, "film": film, "sliver": sliver}
    return t.repair_interfaces(held, displacement, **limits)


def break_films(t: Triangulation, thin: float) -> int:
    """How many cells break."""
    held, still = np.ones(len(t.state), dtype=np.int32), np.zeros((len(t.state), 2))
    return repaired(t, held, still, film=thin)[0]


def broken(height: float) -> tuple[int, np.ndarray]:
    """How many cells of a flat film between two layers break at a threshold of 0.3, and the fluids."""
    x, cells = grid(np.arange(9), np.array([0, 1, 2, 2 + height, 3 + height, 4 + height]))
    y = x[cells, 1].mean(axis=1)
    t = of(x, cells, np.where((y > 2) & (y < 2 + height), 1, 0), density=[1.0, 50.0])
    number = break_films(t, 0.3)
    np.testing.assert_allclose(t.state[:, MASS], masses(t), rtol=1e-12)
    return number, t.fluid


def test_films_break_below_the_threshold_only():
    number, fluid = broken(0.29)
    assert number == 16
    assert (fluid == 0).all()
    number, fluid = broken(0.33)  # over the longest edge, the diagonal: 0.31
    assert number == 0
    assert (fluid == 1).sum() == 16


def lid_film(height, cosine, cells_wide=4):
    """How many cells break of a film of fluid 1 between a lid and fluid 0, of a tension, and with a wetting of the lid.

    Args:
        height: of the film.
        cosine: of the contact angle in fluid 1: the lid costs this much more where fluid 0 wets it.
        cells_wide: of the film; fluid 1 is thick on both sides of it.
    """
    x, cells = grid(np.arange(9), np.array([0.0, 1.0, 2.0, 2.0 + height]))
    x[(x[:, 1] == 2.0) & (np.abs(x[:, 0] - 4) > 0.5 * cells_wide + 0.1), 1] = 1.5
    fluid = (x[cells, 1].min(axis=1) > 1.2).astype(np.int32)
    wall = (x[:, 0] % 8 == 0) | (x[:, 1] == 0) | (x[:, 1] == 2 + height)
    t = of(x, cells, fluid, wall=wall, density=[50.0, 1.0])
    energies = SideEnergies(np.array([[0.0, 1.0], [1.0, 0.0]]), lambda one, other: np.array([[cosine, 0.0]] * len(one)))
    held, still = np.ones(len(x), dtype=bool), np.zeros_like(x)
    limits = {"reach": 0.0, "gap": 0.35, "least_area": 0.02, "film": 0.3, "sliver": 0.0}
    return t.repair_interfaces(held, still, energies=energies, **limits)[0]


def test_a_film_on_a_lid_breaks_where_that_gives_energy():
    """It gives the tension, and takes the wetting of the lid and the tension at its ends, which are a third as long."""
    assert lid_film(0.2, 0.0) > 0
    assert lid_film(0.2, 0.5) > 0
    assert lid_film(0.2, 1.0) == 0
    assert lid_film(0.2, -1.0) > 0
    assert lid_film(0.08, 1.0) > 0  # it is too thin for a mesh


@pytest.mark.parametrize("seed", range(3))
def test_what_patches_of_cells_raise_is_the_difference_of_the_energies_of_all_sides(seed):
    rng = np.random.default_rng(seed)
    x, cells = grid(np.arange(7), np.arange(6))
    before = rng.integers(0, 3, len(cells)).astype(np.int32)
    now = np.where(rng.random(len(cells)) < 0.25, rng.integers(0, 3, len(cells)), before).astype(np.int32)
    sigma, wet = rng.random((3, 3)), rng.random((len(x), len(x), 3))
    sigma, wet = np.triu(sigma, 1) + np.triu(sigma, 1).T, wet + wet.transpose(1, 0, 2)
    mesh = Mesh(x, cells.astype(np.int32), now)

    def energy(fluid):
        total = 0.0
        for cell in range(len(cells)):
            for k in range(3):
                a, b = cells[cell, (k + 1) % 3], cells[cell, (k + 2) % 3]
                beyond, length = mesh.neighbours[cell, k], np.linalg.norm(x[a] - x[b])
                total += length * (wet[a, b, fluid[cell]] if beyond < 0 else 0.5 * sigma[fluid[cell], fluid[beyond]])
        return total

    cell, patch, more = SideEnergies(sigma, lambda one, other: wet[one, other]).raised(mesh, before)
    assert cell.tolist() == np.flatnonzero(before != now).tolist()
    assert more.sum() == pytest.approx(energy(now) - energy(before), rel=1e-12)
    for number in range(len(more)):
        alone = before.copy()
        alone[cell[patch == number]] = now[cell[patch == number]]
        assert more[number] == pytest.approx(energy(alone) - energy(before), rel=1e-9, abs=1e-12)
    assert len(more) > 2


def test_a_layer_with_particles_inside_is_no_film():
    x, cells = grid(np.arange(9), np.array([0, 1, 2, 2.1, 2.2, 3.2]))
    y = x[cells, 1].mean(axis=1)
    t = of(x, cells, np.where((y > 2) & (y < 2.2), 1, 0))
    assert break_films(t, 0.3) == 0


@pytest.mark.parametrize("seed", range(6))
def test_thin_cells_side_by_side_do_not_swap_their_fluids_for_ever(seed):
    """Where nothing moves, repairs come to an end, however many thin cells of different fluids are neighbours."""
    rng = np.random.default_rng(seed)
    x, cells = grid(np.arange(9), 0.2 * np.arange(6))
    x[:, 1] += 0.05 * rng.uniform(-1, 1, len(x)) * ((x[:, 1] > 0) & (x[:, 1] < 1))
    t = of(x, cells, rng.integers(0, 2, len(cells)), density=[1.0, 50.0])
    changed = [break_films(t, 0.3) for _ in range(8)]
    assert changed[0] > 10
    assert changed[-1] == 0
    np.testing.assert_allclose(t.state[:, MASS], masses(t), rtol=1e-12)


@pytest.mark.parametrize("ahead", [0, 1])
def test_the_heavier_fluid_gets_a_thin_wedge_beside_a_wall_and_keeps_it(ahead):
    """The front of water rolls onto a wall: its next particle is about to reach it beyond the contact."""
    x = np.array([[0.0, 0.0], [3.1, 0.0], [1.1, 0.05], [1.7, 0.6], [0.4, 1.2], [3.1, 1.5], [0.0, 1.4], [4.0, 1.4]])
    cells = np.array([[0, 1, 2], [2, 1, 3], [2, 3, 4], [0, 2, 4], [3, 1, 5], [4, 3, 5], [0, 4, 6], [1, 7, 5]])
    t = of(x, cells, np.array([ahead, 1, 0, 0, 1, 1, 0, 1]), density=[1000.0, 1.0])
    assert (areas(t) > 0).all()
    assert break_films(t, 0.15) == ahead
    assert t.fluid[0] == 0
    assert break_films(t, 0.15) == 0


def test_a_thin_bubble_between_a_thin_jet_and_a_wall_becomes_water():
    """A tip of water reaches a wall beside a bubble as thin as it; once both are water, they stay so."""
    x = np.array([[0.0, -1.0], [0.0, 2.4], [1.2, 2.1], [1.2, 0.6], [1.2, -1.0], [0.8, 0.05], [0.96, 0.9], [-1.0, 0.7]])
    cells = np.array([[5, 2, 6], [5, 3, 2], [5, 4, 3], [0, 4, 5], [0, 5, 7], [5, 6, 7], [6, 2, 1], [6, 1, 7]])
    water, air = 0, 1
    t = of(x, cells, np.array([water, air, air, air, water, water, air, air]), density=[1000.0, 1.0])
    assert (areas(t) > 0).all()
    assert sum(break_films(t, 0.3) for _ in range(2)) > 0
    assert t.fluid[0] == t.fluid[1] == water
    assert break_films(t, 0.3) == 0


def slide(t: Triangulation, held, reach: float = 2.0, path: float = 10.0) -> None:
    """Let all contacts slide but those held, after a step of length ``path`` of all that is not on a wall."""
    mark = t.marks()
    assert repaired(t, held, np.where(mark < 2, [[path], [0.0]], 0.0).T, reach=reach) == (0, 0)


@pytest.mark.parametrize("slope", [0.0, 0.3, -0.7])
@pytest.mark.parametrize("shift", [0.3, -0.3])
def test_a_straight_interface_meets_the_wall_where_it_points_to(slope, shift):
    """Wall particles that were pushed aside slide back onto the line of their interface, to round-off."""
    x, cells = grid(np.arange(7), np.arange(6))
    wall = (x[:, 1] == 0) | (x[:, 1] == 5)
    fluid = (x[cells, 0].mean(axis=1) > 3).astype(int)
    x[:, 0] += slope * x[:, 1]
    t = of(x, cells, fluid)
    contact = np.intersect1d(border(t), np.flatnonzero(wall))
    assert len(contact) == 2
    t.state[contact, 0] += shift
    assert (simplex_measure(t.state[:, :2], t.cells) > 0).all()
    others = np.setdiff1d(np.arange(len(x)), contact)

    slide(t, np.ones(len(x), dtype=np.int32))
    np.testing.assert_array_equal(t.state[contact, 0], x[contact, 0] + shift)
    slide(t, np.zeros(len(x), dtype=np.int32))
    np.testing.assert_allclose(t.state[contact, :2], x[contact], atol=1e-14)
    np.testing.assert_array_equal(t.state[others, :2], x[others])
    slide(t, np.zeros(len(x), dtype=np.int32), reach=0.2)
    foot = np.where(x[contact, 1] == 0, 3 + slope, 3 + 4 * slope)
    assert (np.abs(t.state[contact, 0] - foot) < 0.2 + 1e-12).all()


def upright(shift: float, wall=None) -> tuple[Triangulation, np.ndarray]:
    """An upright interface whose ends on the walls were pushed aside, random velocities off the walls; these ends."""
    x, cells = grid(np.arange(7), np.arange(6))
    fluid = (x[cells, 0].mean(axis=1) > 3).astype(int)
    contact = np.flatnonzero((x[:, 0] == 3) & ((x[:, 1] == 0) | (x[:, 1] == 5)))
    x[contact, 0] += shift
    t = of(x, cells, fluid, wall=wall, density=[1.0, 1000.0])
    t.state[:, VELOCITY:ACCELERATION] = np.random.default_rng(4).normal(size=(len(x), 2)) * (t.marks() < 2)[:, None]
    return t, contact


@pytest.mark.parametrize("shift", [0.3, -0.3])
def test_a_contact_that_slides_changes_no_velocity_where_walls_hold_particles(shift):
    t, contact = upright(shift)
    velocity, total = t.state[:, VELOCITY:ACCELERATION].copy(), areas(t).sum()
    slide(t, np.zeros(len(t.state), dtype=np.int32))
    np.testing.assert_allclose(t.state[contact, 0], 3.0, atol=1e-14)
    np.testing.assert_array_equal(t.state[:, VELOCITY:ACCELERATION], velocity)
    np.testing.assert_allclose(t.state[:, MASS], masses(t), rtol=1e-12)
    assert areas(t).sum() == pytest.approx(total, rel=1e-14)
    check(t)


@pytest.mark.parametrize("path", [0.0, 0.04, 0.1])
def test_a_contact_goes_at_most_twice_as_far_as_the_interface_above_it_went(path):
    t, contact = upright(0.3)
    slide(t, np.zeros(len(t.state), dtype=np.int32), path=path)
    np.testing.assert_allclose(t.state[contact, 0], 3.3 - 2 * path, atol=1e-14)


@pytest.mark.parametrize("slips", [False, True])
def test_what_a_broken_film_becomes_moves_with_the_water(slips):
    """Water that takes the place of fast air along a wall has the speed of the water beside it, if the wall slips."""
    x, cells = grid(np.arange(9), np.array([0, 1, 2, 2.2]))
    t = of(x, cells, (x[cells, 1].mean(axis=1) > 2).astype(int), density=[1000.0, 1.0])
    film = x[:, 1] == 2.2
    t.wall[:] = film * (SLIDES if slips else HELD)
    for column, slow, fast in ((VELOCITY, 2.0, 40.0), (ACCELERATION, 3.0, 60.0)):
        t.state[:, column] = np.where(film, fast, slow)
    mass = t.state[:, MASS].copy()
    held = np.ones(len(x), dtype=np.int32)
    limits = {"reach": 0.0, "gap": 0.35, "least_area": 0.02, "film": 0.3, "sliver": 0.0}
    assert t.repair_interfaces(held, np.zeros_like(x), **limits) == (16, 0)
    gained = t.state[film, MASS] - mass[film]
    assert (gained > 100 * mass[film]).all()
    for column, slow, fast in ((VELOCITY, 2.0, 40.0), (ACCELERATION, 3.0, 60.0)):
        np.testing.assert_allclose(t.state[~film, column], slow, rtol=1e-14)
        expected = (fast * mass[film] + slow * gained) / t.state[film, MASS] if slips else fast
        np.testing.assert_allclose(t.state[film, column], expected, rtol=1e-12)
