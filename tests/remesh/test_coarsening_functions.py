"""The functions that coarsening and refinement are made of, each against a twin in NumPy or a configuration by hand."""

import itertools

import numpy as np
import pytest
import taichi as ti
from triangulations import as_set, border, check, cloud, delaunay, grid, masses, momentum, momentum_scale, of

from tipfem.backend.array_types import Array1, Array2, Periods
from tipfem.backend.launch import kernel, launch
from tipfem.mesh.mesh import simplex_measure
from tipfem.remesh.triangles import coarsen_refine as functions
from tipfem.remesh.triangles import refining
from tipfem.remesh.triangles.coarsen_refine import LIMITS, NEAR_BORDER, NEAR_HULL, NEAR_PARTICLE, SCRATCH
from tipfem.remesh.triangles.edge_operations import (
    ACCELERATION,
    HELD,
    MASS,
    OFF_WALLS,
    SLIDES,
    TARGET,
    VELOCITY,
    Segment,
    TriangleArrays,
    add_mass,
    collect_star,
    distribute_momentum,
    interface_edges,
    ring,
)
from tipfem.remesh.triangles.triangulation import Triangulation

LEAST = 1e-4


def arrays(t: Triangulation) -> tuple[np.ndarray, ...]:
    """Those of `TriangleArrays`."""
    return t.state, t.cells, t.neighbours, t.fluid, t.period.array, t.corner, t.wall, t.density, t._stale


def rough(seed: int, *, walls: bool = True, lightest: float = 1.0) -> Triangulation:
    """A cloud of two fluids, or of a fluid and empty space, with random target spacings and velocities."""
    x = cloud("walls" if seed % 2 else "random", seed)
    cells, rng = delaunay(x), np.random.default_rng(seed)
    fluid = (x[cells, 0].mean(axis=1) > 0.5).astype(int)
    fluid[rng.uniform(size=len(cells)) < 0.1] = 0
    t = of(x, cells, fluid, wall=None if walls else np.zeros(len(x)), density=[lightest, 1000.0])
    t.state[:, TARGET] = rng.uniform(0.1, 0.4, len(x))
    t.state[:, VELOCITY:MASS] = rng.normal(size=(len(x), MASS - VELOCITY))
    return t


@kernel
def flag_all(
    state: Array2,
    cells: Array2,
    neighbours: Array2,
    fluid: Array1,
    period: Periods,
    corner: Array1,
    wall: Array1,
    density: Array1,
    stale: Array1,
    limits: Array1,
    flag: Array1,
    span: Array1,
):
    mesh = ti.static(TriangleArrays(state, cells, neighbours, fluid, period, corner, wall, density, stale))
    ti.loop_config(serialize=True)
    for t in range(cells.shape[0]):
        span[t] = functions.flag_crowding(mesh, limits, flag, t)


def test_flags_say_what_is_near_particles():
    seen = 0
    for seed in range(10):
        t = rough(seed)
        x, target = t.state[:, :2], t.state[:, TARGET]
        limits, flag, span = np.zeros(LIMITS), np.zeros(len(x), dtype=np.int32), np.empty(len(t.cells))
        limits[[functions.TOO_CLOSE, functions.ALONG_INTERFACE]] = 0.3, 0.5
        limits[[functions.TO_INTERFACE, functions.FILM]] = 0.4, 0.3
        launch(flag_all, *arrays(t), limits, flag, span)
        expected, longest = np.zeros(len(x), dtype=int), np.zeros(len(t.cells))
        for cell in range(len(t.cells)):
            for i in range(3):
                a, b, c = np.roll(t.cells[cell], -i)
                o = t.neighbours[cell, i]
                length, wanted = np.linalg.norm(x[b] - x[c]), 0.5 * (target[b] + target[c])
                if length < 0.5 * wanted:
                    expected[[b, c]] |= NEAR_PARTICLE
                at_border = o < 0 or t.fluid[o] != t.fluid[cell]
                height = 2 * simplex_measure(x, t.cells[cell : cell + 1])[0] / length
                if at_border and height < 0.4 * wanted:
                    expected[a] |= NEAR_BORDER
                if o < 0 and height < 0.3 * wanted:
                    expected[a] |= NEAR_HULL
                if at_border or o > cell:
                    longest[cell] = max(longest[cell], (length / wanted) ** 2)
        np.testing.assert_array_equal(flag, expected)
        np.testing.assert_allclose(span, longest, rtol=1e-12)
        seen |= np.bitwise_or.reduce(expected)
    assert seen == NEAR_PARTICLE | NEAR_BORDER | NEAR_HULL


@kernel
def targets_of_all(
    state: Array2,
    cells: Array2,
    neighbours: Array2,
    fluid: Array1,
    period: Periods,
    corner: Array1,
    wall: Array1,
    density: Array1,
    stale: Array1,
    limits: Array1,
    flag: Array1,
    scratch: Array1,
    result: Array2,
):
    mesh, star = ti.static(
        TriangleArrays(state, cells, neighbours, fluid, period, corner, wall, density, stale), Segment(scratch)
    )
    ti.loop_config(serialize=True)
    for p in range(state.shape[0]):
        count, closed = collect_star(mesh, star, p)
        q, a, along = functions.collapse_target(mesh, limits, flag, star, count, closed, p)
        result[p, 0], result[p, 1] = q, -1
        if along and q >= 0:
            result[p, 1] = a


def around(t: Triangulation, p: int) -> tuple[list[int], list[int], list[int]]:
    """The particles around p, those of them along the hull, and along the interface."""
    cells = t.cells[(t.cells == p).any(axis=1)]
    fluid = t.fluid[(t.cells == p).any(axis=1)]
    link = sorted(set(cells.ravel().tolist()) - {p})
    beside = {r: fluid[(cells == r).any(axis=1)] for r in link}
    return link, [r for r in link if len(beside[r]) == 1], [r for r in link if len(set(beside[r].tolist())) == 2]


def expected_target(t: Triangulation, close: float, chain: float, film: float, flag: int, p: int) -> tuple[int, int]:
    """`collapse_target` by brute force: the neighbour, and the other one on the interface where it is to be kept."""
    x = t.state[:, :2]
    link, hull, chained = around(t, p)

    def gap(q):
        return np.linalg.norm(x[p] - x[q])

    def relative(q):
        return gap(q) / (0.5 * (t.state[p, TARGET] + t.state[q, TARGET]))

    def possible(q):
        own = t.cells[(t.cells == p).any(axis=1) & ~(t.cells == q).any(axis=1)]
        return (2 * simplex_measure(x, np.where(own == p, q, own)) >= LEAST * t.state[p, TARGET] ** 2).all()

    def meets(q):
        beside = (t.cells == p).any(axis=1) & (t.cells == q).any(axis=1)
        return relative(q) < film and (t.density[t.fluid[beside]] == 0).all()

    q, other = -1, -1
    if hull and len(chained) <= 1:
        near = min(hull, key=gap)
        q = near if relative(near) < (film if chained else chain) else -1
    elif not hull and chained:
        near = min(chained, key=gap)
        if len(chained) == 2 and relative(near) < chain:
            q, other = near, next(r for r in chained if r != near)
        elif flag >= NEAR_HULL or any(meets(r) for r in link if t.wall[r]):
            usable = [r for r in link if t.wall[r] and (len(chained) > 2 or r not in chained) and possible(r)]
            q = min(usable, key=gap, default=-1)
    elif not hull:
        usable = [r for r in link if (relative(r) < close or flag >= NEAR_BORDER) and possible(r)]
        q = min(usable, key=gap, default=-1)
    return (q, other) if q >= 0 and possible(q) else (-1, -1)


@pytest.mark.slow
def test_a_particle_is_moved_into_the_neighbour_that_brute_force_finds():
    kinds, met = {}, 0
    for seed in range(30):
        t = rough(seed, lightest=seed % 3)
        flag = np.random.default_rng(seed).integers(0, 8, len(t.state)).astype(np.int32)
        limits = np.zeros(LIMITS)
        limits[functions.TOO_CLOSE], limits[functions.ALONG_INTERFACE], limits[functions.FILM] = 0.7, 0.6, 0.5
        limits[functions.LEAST_AREA] = LEAST
        result = np.empty((len(t.state), 2), dtype=np.int32)
        launch(targets_of_all, *arrays(t), limits, flag, np.empty(SCRATCH, dtype=np.int32), result)
        for p in range(len(t.state)):
            expected = expected_target(t, 0.7, 0.6, 0.5, flag[p], p)
            assert tuple(result[p]) == expected
            met += expected != expected_target(t, 0.7, 0.6, 0.0, flag[p], p)
            _, hull, chained = around(t, p)
            kind = (bool(hull), min(len(chained), 3), bool(result[p, 0] >= 0), bool(result[p, 1] >= 0))
            kinds[kind] = kinds.get(kind, 0) + 1
    # On the hull without and with an interface, along one, where some touch, and inside a fluid.
    for wanted in ((True, 0), (True, 1), (False, 2), (False, 0)):
        assert kinds[(*wanted, True, wanted == (False, 2))] > 5
        assert kinds[(*wanted, False, False)] > 5
    assert met > 5  # a contact that is close, or a wall across empty space


@kernel
def collapse_one(
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
    p: ti.i32,
    q: ti.i32,
    a: ti.i32,
    closes: ti.i32,
):
    mesh = ti.static(TriangleArrays(state, cells, neighbours, fluid, period, corner, wall, density, stale))
    room = ti.static(functions.room_in(scratch))
    ti.loop_config(serialize=True)
    for _ in range(1):
        count, closed = collect_star(mesh, room.star, p)
        functions.collapse_conserving_momentum(mesh, room, count, closed, p, q, a, closes != 0, 1e-9)


def test_a_collapse_keeps_mass_and_momentum_and_marks_what_changed():
    went = 0
    for seed in range(10):
        first = rough(seed, walls=False)
        for p in range(4, len(first.state), 3):
            q, _ = expected_target(first, 1e9, 0.0, 0.0, NEAR_BORDER, p)
            if q < 0:
                continue
            t = rough(seed, walls=False)
            t._stale[:] = 0
            before, scale = momentum(t), momentum_scale(t)
            launch(collapse_one, *arrays(t), np.empty(SCRATCH, dtype=np.int32), p, q, -1, 0)
            np.testing.assert_allclose(momentum(t), before, atol=1e-12 * scale)
            np.testing.assert_allclose(t.state[:, MASS], masses(t), atol=1e-12 * masses(t).sum())
            np.testing.assert_array_equal(t.state[:, :2], first.state[:, :2])
            changed = (t.fluid >= 0) & (t.cells != first.cells).any(axis=1)
            beside = t.neighbours[changed]
            assert set(np.flatnonzero(t._stale)) == set(np.flatnonzero(changed)) | set(beside[beside >= 0].tolist())
            t.compact()
            check(t, removed=1)
            went += 1
    assert went > 20


def test_a_collapse_along_an_interface_keeps_the_area_on_either_side():
    x, cells = grid(np.arange(7), np.arange(5))
    middle = np.flatnonzero(x[:, 1] == 2)
    x[middle, 1] += 0.3 * np.sin(2.0 * x[middle, 0])
    fluid = (cells % 5 >= 2).all(axis=1)
    t = of(x, cells, fluid.astype(int), wall=np.zeros(len(x)), density=[1.0, 10.0])
    p, q, a = middle[2], middle[3], middle[1]
    assert {tuple(sorted(e)) for e in border(t).tolist()} == set(itertools.pairwise(middle.tolist()))
    has = np.bincount(t.fluid, weights=simplex_measure(x, t.cells))
    launch(collapse_one, *arrays(t), np.empty(SCRATCH, dtype=np.int32), p, q, a, 0)
    t.compact()
    y = np.ascontiguousarray(t.state[:, :2])
    np.testing.assert_allclose(np.bincount(t.fluid, weights=simplex_measure(y, t.cells)), has, rtol=1e-14)
    assert np.flatnonzero((y != x).any(axis=1)).tolist() == [q]
    # Halfway between the two, but for what the area asks for.
    edge = x[middle[4]] - x[a]
    assert (y[q] - 0.5 * (x[p] + x[q])) @ edge == pytest.approx(0.0, abs=1e-12)


@kernel
def masses_and_momentum(
    state: Array2,
    cells: Array2,
    neighbours: Array2,
    fluid: Array1,
    period: Periods,
    corner: Array1,
    wall: Array1,
    density: Array1,
    stale: Array1,
    group: Array1,
    lost: Array1,
    limit: ti.f64,
    change: Array2,
):
    mesh, particles = ti.static(
        TriangleArrays(state, cells, neighbours, fluid, period, corner, wall, density, stale), Segment(group, 1)
    )
    ti.loop_config(serialize=True)
    for t in range(cells.shape[0]):
        gain = add_mass(mesh, t, 1)
        for k in ti.static(range(3)):
            change[t, k] = gain[k]
    ti.loop_config(serialize=True)
    for _ in range(1):
        distribute_momentum(mesh, particles, group.shape[0] - 1, ti.Vector([lost[0], lost[1]]), limit)


@pytest.mark.parametrize(("wall", "part"), [(OFF_WALLS, 1.0), (SLIDES, 1.0), (OFF_WALLS, 0.25), (HELD, 0.0)])
def test_masses_are_thirds_and_lost_momentum_is_given_to_a_group_that_no_wall_holds(wall, part):
    t = rough(3, walls=False)
    t.state[:, MASS], velocity = 0.0, t.state[:, VELOCITY:ACCELERATION].copy()
    group, change = np.array([-1, 5, 6, 9], dtype=np.int32), np.empty((len(t.cells), 3))
    t.wall[6] = wall
    limit = (part or 1.0) * np.hypot(0.3, 0.2) / masses(t)[group[1:]].sum()
    launch(masses_and_momentum, *arrays(t), group, np.array([0.3, -0.2]), limit * (1 + 1e-15), change)
    np.testing.assert_allclose(t.state[:, MASS], masses(t), rtol=1e-13)
    mass = t.density[t.fluid] * simplex_measure(np.ascontiguousarray(t.state[:, :2]), t.cells)
    np.testing.assert_allclose(change[:, 2], mass, rtol=1e-10, atol=1e-15)
    np.testing.assert_allclose(change[:, :2], mass[:, None] * velocity[t.cells].mean(axis=1), atol=1e-13 * mass.max())
    gain = t.state[:, VELOCITY:ACCELERATION] - velocity
    assert (gain[np.setdiff1d(np.arange(len(gain)), group[1:])] == 0).all()
    total = t.state[group[1:], MASS].sum()
    expected = part * np.array([0.3, -0.2]) / total
    np.testing.assert_allclose(gain[group[1:]], np.tile(expected, (3, 1)), atol=1e-15 + 1e-12 / total)


@kernel
def links_of_all(
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
    link: Array2,
    ends: Array2,
):
    mesh, star = ti.static(
        TriangleArrays(state, cells, neighbours, fluid, period, corner, wall, density, stale), Segment(scratch, 3)
    )
    ti.loop_config(serialize=True)
    for p in range(state.shape[0]):
        count, closed = collect_star(mesh, star, p)
        for m in range(count + 1 - closed):
            link[p, m] = ring(mesh, star, count, p, m)
        ends[p, 0], ends[p, 1], ends[p, 2] = interface_edges(mesh, star, count, closed, p)


def test_links_and_interface_edges_are_those_of_the_cells():
    for seed in range(10):
        t = rough(seed)
        link, ends = np.full((len(t.state), 64), -1, dtype=np.int32), np.empty((len(t.state), 3), dtype=np.int32)
        launch(links_of_all, *arrays(t), np.empty(70, dtype=np.int32), link, ends)
        for p in range(len(t.state)):
            expected, hull, chained = around(t, p)
            found = link[p][link[p] >= 0].tolist()
            assert sorted(found) == expected
            assert not hull or sorted((found[0], found[-1])) == hull
            assert ends[p, 0] == len(chained)
            assert set(ends[p, 1:][: len(chained)].tolist()) <= set(chained)
            assert len(set(ends[p, 1:].tolist())) == (1 if not chained else 2)


@kernel
def rooms(
    state: Array2,
    cells: Array2,
    neighbours: Array2,
    fluid: Array1,
    period: Periods,
    corner: Array1,
    wall: Array1,
    density: Array1,
    stale: Array1,
    n: ti.i32,
    room: ti.f64,
    result: Array2,
):
    mesh = ti.static(TriangleArrays(state, cells, neighbours, fluid, period, corner, wall, density, stale))
    ti.loop_config(serialize=True)
    for t in range(cells.shape[0]):
        for i in range(3):
            refining.interpolate_midpoint(mesh, n, cells[t, (i + 1) % 3], cells[t, (i + 2) % 3])
            result[t, i] = refining.has_room(mesh, t, i, n, room)


def test_there_is_room_where_all_particles_beside_an_edge_are_far_enough():
    """Over long edges of the hull they need not be as far."""
    seen = set()
    for seed in range(10):
        t = rough(seed)
        n, count = len(t.state), len(t.cells)
        t.provide(1)
        result = np.empty((count, 3), dtype=np.int32)
        launch(rooms, *arrays(t), n, 0.6, result)
        x = t.state[:, :2]
        for cell in range(count):
            for i in range(3):
                a, b, c = np.roll(t.cells[cell], -i)
                middle, least = 0.5 * (x[b] + x[c]), 0.6 * 0.5 * (t.state[b, TARGET] + t.state[c, TARGET])
                o, long = t.neighbours[cell, i], np.linalg.norm(x[b] - x[c]) / (least / 0.6)
                least *= min(1.0, (1.8 / long) ** 2) if o < 0 else 1.0
                far = np.linalg.norm(middle - x[a]) > least and np.linalg.norm(middle - x[b]) > 0.8 * least
                if o >= 0:
                    d = next(r for r in t.cells[o] if r not in (b, c))
                    far = far and np.linalg.norm(middle - x[d]) > least
                assert bool(result[cell, i]) == far
                seen.add((far, o >= 0))
        a, b, c = np.roll(t.cells[-1], -2)
        np.testing.assert_array_equal(t.state[n, :MASS], 0.5 * (t.state[b, :MASS] + t.state[c, :MASS]))
        assert t.state[n, TARGET] == 0.5 * (t.state[b, TARGET] + t.state[c, TARGET])
    assert len(seen) == 4


@kernel
def insert_one(
    state: Array2,
    cells: Array2,
    neighbours: Array2,
    fluid: Array1,
    period: Periods,
    corner: Array1,
    wall: Array1,
    density: Array1,
    stale: Array1,
    touched: Array1,
    t: ti.i32,
    i: ti.i32,
    n: ti.i32,
    unused: ti.i32,
) -> ti.i32:
    mesh = ti.static(TriangleArrays(state, cells, neighbours, fluid, period, corner, wall, density, stale))
    used = 0
    ti.loop_config(serialize=True)
    for _ in range(1):
        refining.interpolate_midpoint(mesh, n, cells[t, (i + 1) % 3], cells[t, (i + 2) % 3])
        used = refining.insert(mesh, touched, t, i, n, unused, unused + 1)
    return used


@pytest.mark.parametrize("on_hull", [False, True])
def test_an_inserted_particle_has_its_mass_and_belongs_to_the_wall_it_is_on(on_hull):
    t = rough(5)
    n, count = len(t.state), len(t.cells)
    t.provide(1)
    cell, i = (found[0] for found in np.nonzero((t.neighbours < 0) == on_hull))
    old, o, before = t.cells.copy(), t.neighbours[cell, i], momentum(t)
    for name, fill in (("cells", 0), ("neighbours", -1)):
        setattr(t, name, np.concatenate([getattr(t, name), np.full((2, 3), fill, dtype=np.int32)]))
    t.fluid = np.concatenate([t.fluid, np.full(2, -1, dtype=np.int32)])
    touched = np.zeros(count + 2, dtype=np.int8)
    assert launch(insert_one, *arrays(t), touched, cell, i, n, count) == (1 if on_hull else 2)
    assert t.wall[n] == on_hull
    expected = {cell, count} if on_hull else {cell, o, count, count + 1}
    assert set(np.flatnonzero(touched)) == expected
    np.testing.assert_allclose(t.state[:, MASS], masses(t), atol=1e-13 * masses(t).sum())
    np.testing.assert_allclose(momentum(t), before, atol=1e-12 * np.abs(before).max())
    t.removed = t.removed[:0]
    t.compact()
    check(t)
    kept = np.setdiff1d(np.arange(count), [cell, o])
    assert as_set(old[kept]) <= as_set(t.cells)
