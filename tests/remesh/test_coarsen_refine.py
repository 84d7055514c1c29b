"""Which particles are removed, where some are inserted, and what becomes of momentum."""

import numpy as np
import pytest
from triangulations import areas, as_set, border, check, cloud, delaunay, grid, masses, momentum, momentum_scale, of

from tipfem.mesh.mesh import Mesh, simplex_measure
from tipfem.remesh.triangles import fitted
from tipfem.remesh.triangles.edge_operations import ACCELERATION, HELD, MASS, OFF_WALLS, SLIDES, VELOCITY
from tipfem.remesh.triangles.triangulation import Crowding, Triangulation


def coarsened(t: Triangulation, too_close, along_interface, to_interface, held=None, *, film=0.0, most=1000):
    """The particles that are removed."""
    held = np.zeros(len(t.state), dtype=bool) if held is None else held
    before = len(t.removed)
    t.coarsen(held, Crowding(too_close, along_interface, to_interface, film, 0.02), most=most)
    return t.removed[before:]


def wavy(wall=None, density=(1.0, 1000.0)):
    """A grid with a wave on its middle line, which is an interface; two of its particles stand close. And these."""
    x, cells = grid(np.arange(9), np.arange(7))
    fluid = (x[cells, 1].mean(axis=1) > 3).astype(int)
    middle = np.flatnonzero(x[:, 1] == 3)
    x[middle, 1] += 0.2 * np.sin(1.1 * x[middle, 0])
    x[middle[4], 0] += 0.3
    x[middle[5], 0] -= 0.3
    t = of(x, cells, fluid, wall=wall, density=density)
    t.state[:, VELOCITY:MASS] = np.random.default_rng(0).normal(size=(len(x), 5))
    return t, middle


def at(t: Triangulation, x, y) -> int:
    """The particle that stands there."""
    return int(np.argmin(np.linalg.norm(t.state[:, :2] - [x, y], axis=1)))


def test_a_coarser_interface_encloses_the_same_area():
    t, middle = wavy()
    state, before = t.state.copy(), areas(t)
    removed = coarsened(t, 0.1, 0.55, 0.1)
    assert len(removed) == 1
    assert removed[0] in middle[4:6]
    stays = middle[4] if removed[0] == middle[5] else middle[5]
    t.compact()
    check(t, removed=1)
    np.testing.assert_allclose(areas(t), before, rtol=1e-14)
    rest = np.setdiff1d(np.arange(len(state)), [*removed, stays])
    np.testing.assert_array_equal(t.state[rest, :2], state[rest, :2])
    np.testing.assert_array_equal(t.state[rest, ACCELERATION:MASS], state[rest, ACCELERATION:MASS])
    # It stands in the middle of the two, and has the acceleration there.
    mean = state[middle[4:6], ACCELERATION : ACCELERATION + 2].mean(axis=0)
    np.testing.assert_allclose(t.state[stays, ACCELERATION : ACCELERATION + 2], mean, rtol=1e-14)
    np.testing.assert_allclose(t.state[:, MASS], masses(t), atol=1e-12 * masses(t).sum())
    assert t.state[removed[0], MASS] == 0
    assert len(border(t)) == 2 * 7


def test_who_is_fixed_stays():
    t, middle = wavy()
    held = np.zeros(len(t.state), dtype=bool)
    held[middle[4]] = True
    place = t.state[middle[4], :2].copy()
    assert coarsened(t, 0.1, 0.55, 0.1, held).tolist() == [middle[5]]
    np.testing.assert_array_equal(t.state[middle[4], :2], place)
    held[middle[5]] = True
    assert len(coarsened(wavy()[0], 0.1, 0.55, 0.1, held)) == 0


def test_no_more_go_than_asked_for_and_corners_never():
    x, cells = grid(0.5 * np.arange(13), 0.5 * np.arange(13))
    corners = fitted.hull_corners(Mesh(x, cells))
    assert corners.sum() == 4
    assert len(coarsened(of(x, cells), 0.6, 0.55, 0.2, corners, most=5)) == 5
    t = of(x, cells)
    removed = coarsened(t, 0.6, 0.55, 0.2, corners)
    assert not corners[removed].any()
    t.compact()
    check(t, removed=len(removed))
    assert simplex_measure(x, t.cells).sum() == pytest.approx(36.0, rel=1e-14)


def test_of_a_crowd_every_other_stays():
    """Whoever goes has somebody left to crowd: no hole is torn."""
    x, cells = grid(0.5 * np.arange(13), 0.5 * np.arange(13))
    removed = coarsened(of(x, cells), 0.6, 0.55, 0.2, fitted.hull_corners(Mesh(x, cells)))
    stays = np.delete(x, removed, axis=0)
    assert len(removed) > 40
    assert np.linalg.norm(x[removed, None] - stays, axis=2).min(axis=1).max() < 0.75


def test_a_neighbour_that_took_a_particle_in_stays():
    """A row of seven, each too close to the next, far from all others: whoever goes leaves the one it went to."""
    lines = np.concatenate([np.arange(4), 4 + 0.5 * np.arange(7), 8 + np.arange(4)])
    x, cells = grid(lines, np.arange(7))
    wall = ((x == 0) | (x == [lines[-1], 6])).any(axis=1)
    removed = coarsened(of(x, cells), 0.6, 0.1, 0.05, wall | (x[:, 1] != 3))
    stays = np.setdiff1d(lines, x[removed, 0])
    assert len(removed) >= 2
    assert np.abs(x[removed, 0][:, None] - stays).min(axis=1).max() == 0.5
    assert np.diff(stays).max() <= 1.5


def rough(seed: int, wall: bool, density=(1.0, 1000.0)) -> Triangulation:
    """A jittered lattice with two fluids and random velocities, whose hull is of walls, or not."""
    x = 8 * cloud("jittered lattice", seed)
    cells = delaunay(x)
    fluid = (x[cells, 0].mean(axis=1) > 4).astype(int)
    t = of(x, cells, fluid, wall=None if wall else np.zeros(len(x)), density=density)
    t.state[:, VELOCITY:MASS] = np.random.default_rng(seed).normal(size=(len(x), 5))
    return t


@pytest.mark.parametrize("seed", range(5))
def test_a_collapse_gives_momentum_back_to_the_particles_around(seed):
    """But for collapses along the interface, all in one fluid or beside the other, and none at a wall."""
    t = rough(seed, wall=False)
    hull = np.unique(border(t, hull=True))
    held = np.zeros(len(t.state), dtype=bool)
    held[hull] = held[border(t)] = True
    before, scale = momentum(t), momentum_scale(t)
    velocity = t.state[:, VELOCITY:ACCELERATION].copy()
    removed = coarsened(t, 0.85, 0.1, 0.2, held)
    assert len(removed) >= 3
    assert (t.state[:, VELOCITY:ACCELERATION] != velocity).any()
    np.testing.assert_allclose(momentum(t), before, atol=1e-12 * scale)
    np.testing.assert_allclose(t.state[:, MASS], masses(t), atol=1e-12 * masses(t).sum())


@pytest.mark.parametrize("seed", range(3))
def test_a_collapse_beside_a_wall_changes_no_velocity(seed):
    t = rough(seed, wall=True)
    t.wall[:] = 1
    velocity = t.state[:, VELOCITY:MASS].copy()
    held = np.zeros(len(t.state), dtype=bool)
    held[:4] = True
    assert len(coarsened(t, 0.85, 0.1, 0.2, held)) >= 3
    np.testing.assert_array_equal(t.state[:, VELOCITY:MASS], velocity)


@pytest.mark.parametrize("density", [(1.0, 1.0), (1.0, 1000.0)])
def test_a_collapse_along_an_interface_keeps_momentum_too(density):
    t, _ = wavy(wall=np.zeros(63), density=density)
    before, scale = momentum(t), momentum_scale(t)
    assert len(coarsened(t, 0.1, 0.55, 0.1)) == 1
    np.testing.assert_allclose(momentum(t), before, atol=1e-12 * scale)


@pytest.mark.parametrize(("gap", "film", "goes"), [(0.25, 0.3, True), (0.25, 0.2, False), (0.4, 0.3, False)])
def test_a_contact_close_to_a_corner_passes_on_to_it(gap, film, goes):
    """The corner is fixed: it is the wall particle where the interface ends that goes."""
    x, cells = grid(np.concatenate([[0.0, gap], 1 + np.arange(7)]), np.arange(7))
    fluid = (x[cells, 0].mean(axis=1) > gap).astype(int)
    top = x[:, 1] > 3
    x[top & (x[:, 0] == gap), 0] = 0.6
    t = of(x, cells, fluid)
    contact, before = at(t, gap, 0), areas(t)
    held = np.ones(len(x), dtype=bool)
    held[contact] = False
    removed = coarsened(t, 0.1, 0.55, 0.05, held, film=film)
    assert removed.tolist() == ([contact] if goes else [])
    t.compact()
    check(t, removed=len(removed))
    assert (at(t, 0, 0) in border(t)) == goes
    assert (np.abs(areas(t) - before) <= 0.5 * gap + 1e-12).all()


def test_a_wall_particle_without_an_interface_goes_by_the_distance_along_the_wall():
    x, cells = grid(np.concatenate([[0.0, 0.4], 1 + np.arange(7)]), np.arange(7))
    t = of(x, cells)
    held = np.ones(len(x), dtype=bool)
    held[at(t, 0.4, 0)] = False
    assert coarsened(t, 0.1, 0.55, 0.05, held, film=0.3).tolist() == [at(of(x, cells), 0.4, 0)]


@pytest.mark.parametrize(("height", "goes"), [(0.25, True), (0.35, False)])
def test_an_interface_that_comes_close_to_a_wall_meets_it(height, goes):
    x, cells = grid(np.arange(9), np.arange(7))
    fluid = (x[cells, 1].mean(axis=1) > 1).astype(int)
    tip = 4 * 7 + 1
    x[tip, 1] = height
    t = of(x, cells, fluid)
    held = t.wall.astype(bool)
    removed = coarsened(t, 0.1, 0.1, 0.05, held, film=0.3)
    assert removed.tolist() == ([tip] if goes else [])
    t.compact()
    check(t, removed=len(removed))
    assert (at(t, 4, 0) in border(t)) == goes
    assert areas(t).sum() == pytest.approx(48.0, rel=1e-14)
    np.testing.assert_allclose(t.state[:, MASS], masses(t), atol=1e-12)
    np.testing.assert_array_equal(t.state[held, :2], x[held])


@pytest.mark.parametrize("width", [6, 12])
def test_a_drop_meets_a_wall_of_wide_empty_space(width):
    """From its tip just above the floor, needles lead to all particles there, which would be flat without the tip."""
    floor = np.arange(width + 1)
    tip, left, right, top_right, top_left = width + 1 + np.arange(5)
    around = [[4.03, 0.02], [3.5, 1.5], [4.6, 1.5], [width, 6.0], [0.0, 6.0]]
    x = np.concatenate([np.stack([floor, 0.0 * floor], axis=1), around])
    cells = [[tip, right, left], *([i, i + 1, tip] for i in floor[:-1]), [0, tip, top_left], [tip, left, top_left]]
    cells += [[left, right, top_left], [right, top_right, top_left], [tip, top_right, right], [tip, width, top_right]]
    wall = np.ones(len(x))
    wall[[tip, left, right]] = 0
    t = of(x, np.array(cells), np.array([0] + [1] * (len(cells) - 1)), wall=wall, density=[1000.0, 0.0])
    removed = coarsened(t, 0.1, 0.1, 0.05, wall.astype(bool), film=0.3)
    assert removed.tolist() == [tip]
    t.compact()
    check(t, removed=1)
    assert 4 in border(t)
    assert areas(t).sum() == pytest.approx(6.0 * width, rel=1e-14)
    np.testing.assert_allclose(t.state[:, MASS], masses(t), atol=1e-12)


@pytest.mark.parametrize("slips", [True, False])
def test_water_that_meets_a_wall_slides_on_with_its_own_speed(slips):
    """A tip of water meets a wall in air at rest: the mass that the wall's particle gains keeps its velocity there."""
    x, cells = grid(np.arange(9), np.arange(7))
    t = of(x, cells, (x[cells, 1].mean(axis=1) > 1).astype(int), density=[1.0, 1000.0])
    tip, foot = at(t, 4, 1), at(t, 4, 0)
    t.state[tip, 1] = 0.25
    t.state[:, MASS] = masses(t)
    t.state[x[:, 1] > 0, VELOCITY] = 3.0
    held = t.wall.astype(bool)
    t.wall[held] = SLIDES if slips else HELD
    before, had = t.state.copy(), momentum(t)[0]
    assert coarsened(t, 0.1, 0.1, 0.05, held, film=0.3).tolist() == [tip]
    if slips:
        assert t.state[foot, MASS] > 100 * before[foot, MASS]
        assert t.state[foot, VELOCITY] == pytest.approx(3.0, rel=0.02)
        # What the water gains in volume moves as the particles around it did on average.
        gained = masses(t).sum() - before[:, MASS].sum()
        assert momentum(t)[0] - had == pytest.approx(3.0 * gained, rel=0.02)
        np.testing.assert_allclose(t.state[t.corner >= 0, VELOCITY + 1], 0.0, atol=1e-15)
    else:
        np.testing.assert_array_equal(t.state[:, VELOCITY:MASS], before[:, VELOCITY:MASS])


def refined(t: Triangulation, new: int) -> int:
    """Put ``new`` particles on the longest edges; how many found room."""
    t.provide(new)
    edges, _ = t.longest_edges(0.5)
    t.refine(edges, 0.2)
    t.compact()
    return new - len(t.removed)


@pytest.mark.parametrize("seed", range(5))
def test_splits_change_no_momentum(seed):
    """Neither inside a fluid, nor on the interface or the walls; whoever was there keeps its velocity."""
    t = rough(seed, wall=True)
    n, before, mass = len(t.state), momentum(t), masses(t).sum()
    state, scale, had = t.state.copy(), momentum_scale(t), areas(t)
    placed = refined(t, 30)
    assert placed > 15
    check(t, removed=30 - placed)
    np.testing.assert_array_equal(t.state[:n, :MASS], state[:, :MASS])
    np.testing.assert_allclose(momentum(t), before, atol=1e-13 * scale)
    np.testing.assert_allclose(t.state[:, MASS], masses(t), atol=1e-13 * mass)
    np.testing.assert_allclose(areas(t), had, rtol=1e-13)
    hull = np.zeros(len(t.state), dtype=bool)
    hull[border(t, hull=True)] = True
    np.testing.assert_array_equal(t.wall[: n + placed] == HELD, hull[: n + placed])


def test_a_particle_inserted_beside_one_that_slides_slides_too():
    t = rough(0, wall=True)
    n = len(t.state)
    right = t.state[:, 0].max()
    t.wall[t.state[:, 0] == right] = SLIDES
    placed = refined(t, 30)
    x, wall = t.state[n : n + placed, 0], t.wall[n : n + placed]
    assert (wall[np.isclose(x, right)] == SLIDES).all()
    assert (wall[x < 0.5 * right] != SLIDES).all()
    assert set(wall) == {OFF_WALLS, HELD, SLIDES}


def test_the_longest_edges_come_first_and_long_borders_before_them():
    t, _ = wavy()
    edges, needed = t.longest_edges(1.05)
    cell, i = edges // 3, edges % 3
    ends = np.stack([t.cells[cell, (i + 1) % 3], t.cells[cell, (i + 2) % 3]], axis=1)
    assert len(as_set(ends)) == len(edges) == len(Mesh(t.state[:, :2], t.cells).edges)
    length = np.linalg.norm(t.state[ends[:, 0], :2] - t.state[ends[:, 1], :2], axis=1)
    borders = as_set(np.concatenate([border(t), border(t, hull=True)]))
    must = [tuple(sorted(pair)) in borders and d > 1.05 for pair, d in zip(ends.tolist(), length, strict=True)]
    first = int(np.sum(must))
    assert 0 < first < len(borders)
    np.testing.assert_array_equal(must, np.arange(len(edges)) < first)
    assert (np.diff(length[:first]) <= 0).all()
    assert (np.diff(length[first:]) <= 0).all()
    assert needed == first + (length[first:] > 1.4 * 1.05).sum()


@pytest.mark.parametrize("every", [False, True])
def test_a_coarsening_finds_the_edges_that_a_look_at_all_cells_does(every):
    """On rough clouds, of which some particles go; none of them where they may not."""
    for seed in range(5):
        for most in (0, 1000):
            t = rough(seed, wall=True)
            t.make_delaunay(1e-3)
            held = t.wall.astype(bool)
            edges, needed = t.coarsen(held, Crowding(0.9, 0.8, 0.4, 0.0, 0.02, 1.1), most=most, every_edge=every)
            assert (len(t.removed) > 0) == (most > 0)
            assert len(edges) > 0
            if every:
                np.testing.assert_array_equal(edges, t.long_edges(1.1))
            else:
                expected, number = t.longest_edges(1.1, t.candidates())
                np.testing.assert_array_equal(edges, expected)
                assert needed == number


def test_a_particle_between_touching_interfaces_goes_into_the_wall_it_lies_on():
    """Two interfaces meet at it, a film's width from a wall: four of its edges are theirs, and it is in no chain."""
    x = np.array([[-0.79, 0], [0.1, 0], [0.12, 1.32], [-0.29, 1.49], [-1.5, 0.84], [0, 2e-4]])
    cells = np.array([[5, k, (k + 1) % 5] for k in range(5)])
    held, wall = np.arange(6) < 5, (x[:, 1] == 0).astype(np.int32)
    fluid = np.array([0, 1, 0, 1, 0])
    assert coarsened(of(x, cells, fluid, wall=wall), 0.1, 0.55, 0.05, held, film=0.0).tolist() == []
    t = of(x, cells, fluid, wall=wall)
    assert coarsened(t, 0.1, 0.55, 0.05, held, film=0.3).tolist() == [5]
    t.compact()
    assert as_set(t.cells) == as_set(np.array([[1, 2, 3], [1, 3, 4], [1, 4, 0]]))
    np.testing.assert_allclose(t.state[:, MASS], masses(t), atol=1e-12 * masses(t).sum())


@pytest.mark.parametrize(
    ("tip", "corner", "collapses"), [(SLIDES, HELD, True), (HELD, HELD, False), (SLIDES, SLIDES, False)]
)
def test_the_tip_of_a_jet_that_runs_along_a_wall_is_moved_into_the_corner_ahead(tip, corner, collapses):
    """It touches the wall in one particle, with air before and behind it; nothing else would let it pass the corner."""
    x = np.array([[-1.0, 0.0], [-0.05, 0.0], [0.0, 0.0], [-1.0, 1.0], [-0.5, 1.0], [0.0, 1.0]])
    cells = np.array([[0, 1, 3], [1, 4, 3], [1, 5, 4], [1, 2, 5]])
    t = of(x, cells, [0, 1, 0, 0], wall=[HELD, tip, corner, HELD, HELD, HELD], density=(1.0, 1000.0))
    coarsened(t, 0.5, 0.5, 0.0, held=np.array([1, 0, 1, 1, 1, 1], dtype=bool), film=0.3)
    assert list(t.removed) == ([1] if collapses else [])
    if collapses:
        t.compact()
        assert as_set(t.cells[t.fluid == 1]) == as_set([[2, 4, 3]])
