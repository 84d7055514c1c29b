"""The functions that repairs of interfaces, flips and relocation are made of, each against a twin or by hand."""

import numpy as np
import pytest
import taichi as ti
from test_coarsening_functions import arrays, expected_target, rough
from triangulations import circle_test, cloud, delaunay, grid, inner_edges, masses, momentum, of

from tipfem.backend.array_types import Array1, Array2, Periods, Template
from tipfem.backend.launch import every_schedule, kernel, launch
from tipfem.geometry.period import no_period
from tipfem.mesh.components import ON_INTERFACE
from tipfem.mesh.mesh import simplex_measure
from tipfem.remesh import gradation, volume_kernels
from tipfem.remesh.triangles import films_contacts, flips, insertion_kernels
from tipfem.remesh.triangles.coarsen_refine import NEAR_BORDER
from tipfem.remesh.triangles.edge_operations import (
    ACCELERATION,
    MASS,
    STAR,
    TARGET,
    VELOCITY,
    Segment,
    TriangleArrays,
    collect_star,
    ring,
)
from tipfem.remesh.triangles.films_contacts import AT_INTERFACE, GAP, IN_FILM, LIMITS, LONG_EDGE, REACH, SCRATCH, SLIVER


@kernel
def film_flags_of_all(
    state: Array2,
    cells: Array2,
    neighbours: Array2,
    fluid: Array1,
    period: Periods,
    corner: Array1,
    wall: Array1,
    density: Array1,
    stale: Array1,
    mark: Array1,
    film: ti.f64,
    flag: Array1,
):
    mesh = ti.static(TriangleArrays(state, cells, neighbours, fluid, period, corner, wall, density, stale))
    for t in range(cells.shape[0]):
        flag[t] = films_contacts.film_flags(mesh, mark, film, t)


def test_films_are_low_cells_without_a_particle_inside():
    seen = np.zeros(4, dtype=int)
    for seed in range(10):
        t = rough(seed)
        mark, flag = t.marks(), np.empty(len(t.cells), dtype=np.int32)
        launch(film_flags_of_all, *arrays(t), mark, 0.5, flag)
        x = np.ascontiguousarray(t.state[:, :2])
        corner = x[t.cells]
        longest = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).max(axis=1)
        low = 2 * simplex_measure(x, t.cells) < 0.5 * t.state[t.cells, TARGET].mean(axis=1) * longest
        film = low & (mark[t.cells] > 0).all(axis=1)
        beside = ((t.neighbours >= 0) & (t.fluid[t.neighbours] != t.fluid[:, None])).any(axis=1)
        np.testing.assert_array_equal(flag, film * IN_FILM + beside * AT_INTERFACE)
        seen += np.bincount(flag, minlength=4)
    assert (seen > 0).all()


@kernel
def break_or_absorb(
    state: Array2,
    cells: Array2,
    neighbours: Array2,
    fluid: Array1,
    period: Periods,
    corner: Array1,
    wall: Array1,
    density: Array1,
    stale: Array1,
    mark: Array1,
    flag: Array1,
    limits: Array1,
    t: ti.i32,
    absorb: ti.i32,
) -> ti.i32:
    mesh = ti.static(TriangleArrays(state, cells, neighbours, fluid, period, corner, wall, density, stale))
    done = 0
    ti.loop_config(serialize=True)
    for _ in range(1):
        if absorb != 0:
            done = films_contacts.absorb_sliver(mesh, mark, flag, limits, t)
        else:
            done = films_contacts.break_film(mesh, flag, t)
    return done


def test_a_broken_film_goes_to_the_fluid_beyond_its_longest_edge_at_an_interface():
    """If that is longer than those it shares with its own fluid, none of whose cells is in a film."""
    taken = {0: 0, 1: 0}
    for seed in range(10):
        first = rough(seed)
        first.fluid[:] = np.random.default_rng(seed).integers(0, 3, len(first.cells))
        x = first.state[:, :2]
        for cell in range(0, len(first.cells), 7):
            t = rough(seed)
            t.fluid[:], t.density = first.fluid, np.array([1.0, 50.0, 7.0])
            t.state[:, MASS] = masses(t)
            mark, flag = np.zeros(len(x), dtype=np.int32), np.zeros(len(t.cells), dtype=np.int32)
            done = launch(break_or_absorb, *arrays(t), mark, flag, np.zeros(LIMITS), cell, 0)
            sides = [
                (np.linalg.norm(x[b] - x[c]), first.fluid[o] if o >= 0 else -1)
                for o, b, c in zip(t.neighbours[cell], t.cells[cell, [1, 2, 0]], t.cells[cell, [2, 0, 1]], strict=True)
            ]
            own, expected = first.fluid[cell], first.fluid.copy()
            across, fluid = max((side for side in sides if side[1] not in (own, -1)), default=(0.0, own))
            shared = max((length for length, other in sides if other == own), default=0.0)
            hull = max((length for length, other in sides if other == -1), default=0.0)
            if t.density[own] < t.density[fluid]:  # edges on walls count as if they were at the interface
                across = max(across, hull)
            elif shared > 0:
                shared = max(shared, hull)
            if fluid != own and across > shared:
                expected[cell] = fluid
            assert done == (expected[cell] != own)
            taken[done] += 1
            np.testing.assert_array_equal(t.fluid, expected)
            np.testing.assert_allclose(t.state[:, MASS], masses(t), atol=1e-13 * masses(t).sum())
    assert min(taken.values()) > 3


@pytest.mark.parametrize(
    ("height", "length", "along", "inside", "absorbed"),
    [
        (0.04, 1.2, 0.5, True, 1),
        (0.06, 1.2, 0.5, True, 0),
        (0.04, 0.9, 0.5, True, 0),
        (0.04, 1.2, 0.5, False, 0),
        (0.04, 1.2, 1.4, True, 0),
    ],
)
def test_a_sliver_over_a_long_interface_edge_is_absorbed(height, length, along, inside, absorbed):
    """Cell 0 of fluid 1 over an edge of the interface to cell 1, with two more cells beside it.

    If its third particle is over the edge, not beyond its end: there the interface would run to and fro.
    """
    x = np.array([[0.0, 0.0], [length, 0.0], [along * length, height], [0.5 * length, -1.0], [along * length, 1.0]])
    cells = np.array([[0, 1, 2], [1, 0, 3], [1, 4, 2], [4, 0, 2]])
    t = of(x, cells, [1, 0, 1, 1], density=[3.0, 5.0])
    mark, flag, limits = np.array([3, 3, 0 if inside else 1, 2, 2]), np.zeros(4, dtype=np.int32), np.zeros(LIMITS)
    mark = mark.astype(np.int32)
    limits[[SLIVER, LONG_EDGE]] = 0.05, 1.0
    assert launch(break_or_absorb, *arrays(t), mark, flag, limits, 0, 1) == absorbed
    assert t.fluid.tolist() == [1 - absorbed, 0, 1, 1]
    assert mark[2] == (ON_INTERFACE if absorbed or not inside else 0)
    assert flag.tolist() == ([0, AT_INTERFACE, AT_INTERFACE, AT_INTERFACE] if absorbed else [0, 0, 0, 0])
    np.testing.assert_allclose(t.state[:, MASS], masses(t), rtol=1e-12)


@kernel
def slide_one(
    state: Array2,
    cells: Array2,
    neighbours: Array2,
    fluid: Array1,
    period: Periods,
    corner: Array1,
    wall: Array1,
    density: Array1,
    stale: Array1,
    displacement: Array2,
    limits: Array1,
    scratch: Array1,
    w: ti.i32,
    a: ti.i32,
    least: ti.f64,
    result: Array1,
):
    mesh = ti.static(TriangleArrays(state, cells, neighbours, fluid, period, corner, wall, density, stale))
    star, other_star = ti.static(Segment(scratch, 0), Segment(scratch, STAR + 1))
    ti.loop_config(serialize=True)
    for _ in range(1):
        count, _closed = collect_star(mesh, star, w)
        one, other = ring(mesh, star, count, w, 0), ring(mesh, star, count, w, count)
        goal, direction = films_contacts.contact_goal(mesh, displacement, limits, other_star, w, a, one, other)
        result[0], result[1], result[2] = goal, direction[0], direction[1]
        films_contacts.move_along(mesh, star, count, w, goal, direction, least)


@pytest.mark.parametrize(
    ("reach", "path", "gap", "least", "goal", "moved"),
    [
        (2.0, 10.0, 0.1, 0.0, 0.6, 0.6),  # where the line through (3.4, 2) and (3.5, 1) meets the wall
        (0.2, 10.0, 0.1, 0.0, 0.6, 0.6),  # at most that far from (3.5, 0)
        (0.05, 10.0, 0.1, 0.0, 0.55, 0.55),
        (2.0, 0.2, 0.1, 0.0, 0.4, 0.4),  # twice as far as the interface
        (2.0, 10.0, 0.7, 0.0, 0.3, 0.3),  # with a gap to the next particle on the wall
        (2.0, 10.0, 0.1, 0.5, 0.6, 0.18),  # with cells that keep their area
    ],
)
def test_a_contact_goes_to_where_its_interface_points(reach, path, gap, least, goal, moved):
    x, cells = grid(np.arange(7), np.arange(5))
    fluid = (x[cells, 0].mean(axis=1) > 3).astype(int)
    t = of(x, cells, fluid)
    w, a, b = 3 * 5, 3 * 5 + 1, 3 * 5 + 2
    t.state[a, 0], t.state[b, 0] = 3.5, 3.4
    t.state[:, MASS] = masses(t)
    displacement, limits, result = np.zeros_like(x), np.zeros(LIMITS), np.empty(3)
    displacement[a] = path, 0.0
    limits[[REACH, GAP]] = reach, gap
    launch(slide_one, *arrays(t), displacement, limits, np.empty(SCRATCH, dtype=np.int32), w, a, least, result)
    sign = np.sign(result[1])
    np.testing.assert_allclose(result * [sign, sign, 1.0], [goal, 1.0, 0.0], atol=1e-14)
    np.testing.assert_allclose(t.state[w, :2], [3 + moved, 0.0], atol=1e-14)
    np.testing.assert_allclose(t.state[:, MASS], masses(t), rtol=1e-12)


@kernel
def excesses(x: Array2, period: Periods, four: Array2, result: Array1):
    mesh = ti.static(TriangleArrays(x, None, None, None, period))
    for k in range(four.shape[0]):
        result[k] = flips.excess(mesh, four[k, 0], four[k, 1], four[k, 2], four[k, 3])


def test_the_excess_of_an_edge_is_that_by_the_smaller_circle_from_either_side():
    for seed in range(20):
        x = cloud("jittered lattice", seed)
        four = inner_edges(of(x, delaunay(x)))
        x = x + np.random.default_rng(seed).normal(size=x.shape) * 0.02
        other = four[:, [3, 2, 1, 0]]  # the same edge, seen from the other cell
        right = (simplex_measure(x, four[:, :3]) > 0) & (simplex_measure(x, other[:, :3]) > 0)
        four, other = np.ascontiguousarray(four[right]), np.ascontiguousarray(other[right])
        result, of_other = np.empty((2, len(four)))
        launch(excesses, x, no_period(2).array, four, result)
        launch(excesses, x, no_period(2).array, other, of_other)
        np.testing.assert_allclose(result, of_other, atol=1e-14)
        one, two = circle_test(x, four), circle_test(x, other)
        np.testing.assert_allclose(result, np.where(np.abs(one) > np.abs(two), one, two), rtol=1e-9, atol=1e-12)


@kernel
def flip_one(
    state: Array2,
    cells: Array2,
    neighbours: Array2,
    fluid: Array1,
    period: Periods,
    corner: Array1,
    wall: Array1,
    density: Array1,
    stale: Array1,
    scratch: Array1,
    t: ti.i32,
    i: ti.i32,
):
    mesh, four = ti.static(
        TriangleArrays(state, cells, neighbours, fluid, period, corner, wall, density, stale), Segment(scratch)
    )
    ti.loop_config(serialize=True)
    for _ in range(1):
        flips.flip_conserving_momentum(mesh, four, t, i)


@pytest.mark.parametrize("walls", [False, True])
def test_a_flip_keeps_masses_and_momentum_and_marks_what_changed(walls):
    x = np.array([[0.0, 0.0], [1.0, -0.6], [2.0, 0.0], [1.0, 0.4]])
    t = of(x, np.array([[0, 1, 3], [2, 3, 1]]), wall=np.full(4, walls), density=[3.0])
    t.state[:, VELOCITY:ACCELERATION] = velocity = np.random.default_rng(1).normal(size=(4, 2))
    t._stale[:] = 0
    before = momentum(t)
    launch(flip_one, *arrays(t), np.array([0, 1, 3, 2], dtype=np.int32), 0, 0)
    assert {tuple(sorted(cell)) for cell in t.cells.tolist()} == {(0, 1, 2), (0, 2, 3)}
    np.testing.assert_allclose(t.state[:, MASS], masses(t), rtol=1e-14)
    assert t._stale.tolist() == [1, 1]
    if walls:
        np.testing.assert_array_equal(t.state[:, VELOCITY:ACCELERATION], velocity)
    else:
        np.testing.assert_allclose(momentum(t), before, rtol=1e-13)
        np.testing.assert_allclose(
            np.ptp(t.state[:, VELOCITY:ACCELERATION] - velocity, axis=0), 0.0, atol=1e-14
        )  # one velocity for all


@kernel
def nearest_of_all(
    state: Array2,
    cells: Array2,
    neighbours: Array2,
    fluid: Array1,
    period: Periods,
    corner: Array1,
    wall: Array1,
    density: Array1,
    stale: Array1,
    scratch: Array1,
    result: Array1,
):
    mesh, star = ti.static(
        TriangleArrays(state, cells, neighbours, fluid, period, corner, wall, density, stale), Segment(scratch)
    )
    ti.loop_config(serialize=True)
    for p in range(state.shape[0]):
        count, closed = collect_star(mesh, star, p)
        result[p] = -1
        if closed == 1:
            result[p] = insertion_kernels.nearest_target(mesh, star, count, p, 1e-4 * state[p, TARGET] ** 2)


def test_a_relocated_particle_leaves_by_its_shortest_edge_that_may_collapse():
    found = 0
    for seed in range(10):
        t = rough(seed)
        t.fluid[:] = 0
        result = np.empty(len(t.state), dtype=np.int32)
        launch(nearest_of_all, *arrays(t), np.empty(insertion_kernels.SCRATCH, dtype=np.int32), result)
        for p in np.flatnonzero(t.marks() == 0):
            assert result[p] == expected_target(t, 1e9, 0.0, 0.0, NEAR_BORDER, p)[0]
            found += 1
        assert (result[t.marks() > 0] == -1).all()
    assert found > 50


@kernel
def find_edge(
    state: Array2,
    cells: Array2,
    neighbours: Array2,
    fluid: Array1,
    period: Periods,
    corner: Array1,
    wall: Array1,
    density: Array1,
    stale: Array1,
    scratch: Array1,
    start: ti.i32,
    end: ti.i32,
    p: ti.i32,
    result: Array1,
):
    mesh, star = ti.static(
        TriangleArrays(state, cells, neighbours, fluid, period, corner, wall, density, stale), Segment(scratch)
    )
    ti.loop_config(serialize=True)
    for _ in range(1):
        result[0], result[1] = insertion_kernels.edge_under(mesh, star, start, end, p)


def test_the_edge_under_a_site_is_found_from_its_start():
    x, cells = grid(np.arange(4), np.arange(4))
    t = of(x, cells)
    p, result, scratch = 0, np.empty(2, dtype=np.int32), np.empty(insertion_kernels.SCRATCH, dtype=np.int32)
    for start, end, part, there in ((5, 9, 0.4, True), (9, 5, 0.6, True), (5, 10, 0.3, True), (5, 9, 1.2, False)):
        t.state[p, :2] = (1 - part) * x[start] + part * x[end]
        launch(find_edge, *arrays(t), scratch, start, end, p, result)
        cell, i = result
        assert (cell >= 0) == there
        if there:
            assert {t.cells[cell, (i + 1) % 3], t.cells[cell, (i + 2) % 3]} == {start, end}
    t.state[p, :2] = [1.4, 1.1]  # on no edge
    launch(find_edge, *arrays(t), scratch, 5, 9, p, result)
    assert result[0] == -1


@kernel
def unite_all(label: Array1, pairs: Array2, serial: Template):
    ti.loop_config(serialize=serial)
    for k in range(pairs.shape[0]):
        volume_kernels.unite(label, pairs[k, 0], pairs[k, 1])
    ti.loop_config(serialize=serial)
    for i in range(label.shape[0]):
        label[i] = volume_kernels.root_of(label, i)


def test_united_components_have_their_lowest_cell_as_root():
    """However many threads unite them: there are several times 512 pairs, which a thread has at least."""
    rng = np.random.default_rng(0)
    pairs, expected = rng.integers(0, 6000, (4000, 2)).astype(np.int32), np.arange(6000)
    for one, other in pairs:
        a, b = expected[one], expected[other]
        expected[(expected == a) | (expected == b)] = min(a, b)
    assert 2000 < len(np.unique(expected)) < 4000
    for _ in every_schedule():
        label = np.arange(6000, dtype=np.int32)
        launch(unite_all, label, pairs, work=(len(pairs), 1.0))
        np.testing.assert_array_equal(label, expected)


@kernel
def hold(
    x: Array2,
    cells: Array2,
    period: Periods,
    near: Array1,
    nodes: Array1,
    measure: Array1,
    shift: Array2,
    counts: Array1,
):
    ti.loop_config(serialize=True)
    for _ in range(1):
        counts[0] = volume_kernels.place_shifted(x, nodes, shift, False)
        counts[1] = volume_kernels.hold_back(x, cells, period, near, measure, shift)


def test_particles_of_a_cell_that_is_halved_are_held_back():
    x, cells = grid(np.arange(4.0), np.arange(4.0))
    cells = cells.astype(np.int32)
    measure, before = simplex_measure(x, cells), x.copy()
    nodes, shift, counts = np.array([5, 10], dtype=np.int32), np.zeros((16, 4)), np.empty(2, dtype=np.int32)
    shift[:, 2:] = x
    shift[5, :2], shift[10, :2] = [0.6, 0.0], [0.01, 0.02]
    near = np.flatnonzero(np.isin(cells, nodes).any(axis=1)).astype(np.int32)
    launch(hold, x, cells, no_period(2).array, near, nodes, measure, shift, counts)
    np.testing.assert_allclose(x[nodes], before[nodes] + [[0.6, 0.0], [0.01, 0.02]])
    np.testing.assert_array_equal(np.delete(x, nodes, axis=0), np.delete(before, nodes, axis=0))
    halved = near[simplex_measure(x, cells)[near] < 0.5 * measure[near]]
    assert counts.tolist() == [2, len(halved)]
    held = np.zeros(16, dtype=bool)
    held[cells[halved]] = True
    assert held[5]
    np.testing.assert_array_equal((shift[:, :2] == 0).all(axis=1), held | ~np.isin(np.arange(16), nodes))


@kernel
def lower_one(x: Array2, cells: Array2, period: Periods, spacing: Array1, lowered: Array1, growth: ti.f64) -> ti.i32:
    changed = 0
    ti.loop_config(serialize=True)
    for t in range(1):
        changed = gradation.lower_targets(x, cells, period, spacing, lowered, t, growth, 7, 2)
    return changed


def test_targets_of_a_cell_are_lowered_until_they_grow_slowly_enough():
    x, cells = np.array([[0.0, 0.0], [3.0, 0.0], [0.0, 4.0]]), np.array([[0, 1, 2]], dtype=np.int32)
    spacing, lowered = np.array([1.0, 2.0, 1.3]), np.zeros(3, dtype=np.int32)
    assert launch(lower_one, x, cells, no_period(2).array, spacing, lowered, 0.1) == 1
    np.testing.assert_allclose(spacing, [1.0, 1.3, 1.3], rtol=1e-14)
    assert lowered.tolist() == [0, 7, 0]
    assert launch(lower_one, x, cells, no_period(2).array, spacing, lowered, 0.1) == 0
