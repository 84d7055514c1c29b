"""tipfem/fitted.py and remeshing_kernels.py: what a repair keeps, and what each of its kernels does."""

import numpy as np
import pytest
from test_surgery import as_set, border, check, of

import tipfem as tp
from tipfem import fitted, fitting
from tipfem import remeshing_kernels as kernels
from tipfem.mesh import Mesh, simplex_measure
from tipfem.remeshing import FittedRemesher
from tipfem.surgery import STAR

WATER, AIR = tp.Fluid("water", 998.0, 1e-3), tp.Fluid("air", 1.2, 1.8e-5)
GLYCERIN = tp.Fluid("glycerin", 1261.0, 1.4)
RULE = fitting.FittedRule()


def started(kind: str, h: float, seed: int = 0, keep: bool = True):
    """A remesher, and the particles and mesh that it starts with, in a unit square."""
    tank = tp.tank((1.0, 1.0), h, jitter=0.2, seed=seed).fill(AIR)
    fluids = [WATER, AIR]
    if kind == "layer":
        tank.fill(WATER, box=((0, 0), (1, 0.5)))
    elif kind == "disc":
        tank.fill(WATER, disc=((0.5, 0.4), 0.27))
    else:
        tank.fill(WATER, box=((0, 0), (1, 0.6))).fill(GLYCERIN, box=((0, 0), (0.4, 0.4)))
        fluids = [WATER, AIR, GLYCERIN]
    remesher = FittedRemesher(fluids, [], RULE, keep=keep)
    first = remesher.start(tank.sample(fluids, fitted=True))
    return remesher, first.particles, first.mesh


def stirred(x, waves: int) -> np.ndarray:
    """Velocities of vortices without divergence, along the walls of the unit square."""
    k = np.pi * waves
    return np.stack([np.sin(k * x[:, 0]) * np.cos(k * x[:, 1]), -np.cos(k * x[:, 0]) * np.sin(k * x[:, 1])], axis=1)


def moved(particles, mesh, step) -> tp.Particles:
    """The particles after a step (N, 2), which is halved until no triangle loses more than 0.9 of its area."""
    step = np.where(particles.wall[:, None], 0.0, step)
    while (simplex_measure(particles.position + step, mesh.cells) < 0.1 * mesh.measure).any():
        step = 0.5 * step
    return particles.copy(position=particles.position + step)


@pytest.mark.parametrize("keep", [True, False])
@pytest.mark.parametrize(("kind", "seed"), [("layer", 1), ("disc", 0), ("three", 2)])
def test_a_stirred_mesh_stays_a_mesh(kind, seed, keep):
    """300 repairs in vortices that turn at random; at each, all that a repair promises."""
    h = 0.1
    remesher, particles, mesh = started(kind, h, seed, keep)
    rng = np.random.default_rng(seed)
    fixed = (particles.position % 1.0 == 0).all(axis=1)
    corners = particles.position[fixed]
    volumes = np.bincount(mesh.fluid, weights=mesh.measure)
    error, shortest, placed = [], [], 0
    for k in range(300):
        if k % 15 == 0:
            waves, sign = int(rng.integers(1, 4)), rng.choice([-1, 1])
        noise = 0.2 * rng.normal(size=particles.position.shape)
        after = moved(particles, mesh, 0.1 * h * (sign * stirred(particles.position, waves) + noise))
        before = np.bincount(mesh.fluid, weights=simplex_measure(after.position, mesh.cells), minlength=len(volumes))
        count = len(particles)
        remeshed = remesher.remesh(after, mesh)
        particles, mesh = remeshed.particles, remeshed.mesh
        check(of(particles.position, mesh.cells, mesh.fluid))
        np.testing.assert_array_equal(mesh.across, Mesh(mesh.position, mesh.cells).across)
        assert len(particles) == count
        np.testing.assert_array_equal(particles.position[fixed], corners)
        on_wall = ((particles.position == 0) | (particles.position == 1)).any(axis=1)
        np.testing.assert_array_equal(particles.wall, on_wall)
        assert not particles.velocity[particles.wall].any()
        volume = np.bincount(mesh.fluid, weights=mesh.measure, minlength=len(volumes))
        error.append(np.abs(volume - (volumes if keep else before)).max())
        side = particles.position[mesh.cells] - particles.position[mesh.cells[:, [1, 2, 0]]]
        shortest.append(np.linalg.norm(side, axis=2).min() / h)
        placed += int(remeshed.relocated.sum())
    assert placed > 200
    assert np.median(error) < 1e-11
    # A body that would have to move further than it may in one repair gets the rest in the next; one
    # with no particle off the walls cannot move at all.
    assert np.mean(np.array(error) < 1e-8) > (0.6 if kind == "three" else 0.9)
    assert max(error) < 0.1 * h * h
    assert min(shortest) > 0.05
    assert np.median(shortest) > 0.3


def test_a_repair_of_what_needs_none_changes_nothing():
    remesher, particles, mesh = started("layer", 0.1, keep=False)
    remeshed = remesher.remesh(particles, mesh)
    assert remeshed.particles is particles
    np.testing.assert_array_equal(remeshed.mesh.cells, mesh.cells)
    assert not remeshed.relocated.any()


def test_the_names_of_two_fluids_do_not_matter():
    """Swapped labels: the same triangles, the same places but for round-off."""
    _, particles, mesh = started("disc", 0.1, seed=3)
    fixed = fitting.hull_corners(mesh)
    states = [(particles, mesh), (particles, Mesh(mesh.position, mesh.cells, 1 - mesh.fluid))]
    placed = 0
    for k in range(60):
        step = 0.02 * stirred(states[0][0].position, 1 + k // 20)
        results = [fitted.repair(moved(p, m, step), m, fixed, RULE)[:3] for p, m in states]
        (one, mesh_one, changed), (other, mesh_other, _) = results
        placed += int(changed.sum())
        np.testing.assert_array_equal(mesh_one.cells, mesh_other.cells)
        np.testing.assert_array_equal(mesh_one.fluid, 1 - mesh_other.fluid)
        np.testing.assert_allclose(one.position, other.position, atol=1e-10)
        same = other.copy(position=one.position)  # what round-off does to a walk is not the question
        states = [(one, mesh_one), (same, Mesh(one.position, mesh_other.cells, mesh_other.fluid))]
    assert placed > 20


def grid(x, y) -> tuple[np.ndarray, np.ndarray]:
    """Lattice points on the lines ``x`` and ``y``, and its squares, each cut into two triangles."""
    position = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2).astype(float)
    index = np.arange(len(position)).reshape(len(x), len(y))
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    cells = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)], axis=2).reshape(-1, 3)
    return position, cells


def broken(height: float) -> tuple[int, np.ndarray]:
    """How many cells of a flat film between two layers break at a threshold of 0.3, and the fluids."""
    x, cells = grid(np.arange(9), np.array([0, 1, 2, 2 + height, 3 + height, 4 + height]))
    y = x[cells, 1].mean(axis=1)
    t = of(x, cells, np.where((y > 2) & (y < 2 + height), 1, 0))
    count, flag = np.zeros(2, dtype=np.int32), np.empty(len(cells), dtype=np.int32)
    kernels.break_films(t.state, t.cells, t.across, t.fluid, t.marks(), flag, count, len(cells), 0.3)
    return int(count[0]), t.fluid


def test_films_break_below_the_threshold_only():
    number, fluid = broken(0.29)
    assert number == 16
    assert (fluid == 0).all()
    number, fluid = broken(0.33)  # over the longest edge, the diagonal: 0.31
    assert number == 0
    assert (fluid == 1).sum() == 16


def test_a_layer_with_particles_inside_is_no_film():
    x, cells = grid(np.arange(9), np.array([0, 1, 2, 2.1, 2.2, 3.2]))
    y = x[cells, 1].mean(axis=1)
    t = of(x, cells, np.where((y > 2) & (y < 2.2), 1, 0))
    mark = t.marks()
    count, flag = np.zeros(2, dtype=np.int32), np.empty(len(cells), dtype=np.int32)
    kernels.break_films(t.state, t.cells, t.across, t.fluid, mark, flag, count, len(cells), 0.3)
    assert set(np.flatnonzero(t.fluid != np.where((y > 2) & (y < 2.2), 1, 0))) <= set(
        np.flatnonzero((mark[cells] > 0).all(axis=1))  # at the walls alone
    )
    assert count[0] == 2


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

    def slide(held, reach=2.0):
        kernels.slide_contacts(
            t.state, t.cells, t.across, t.fluid, t.corner, held, t.marks(), np.empty(2 * STAR + 4, dtype=np.int32),
            len(x), reach, 0.35, 0.02,
        )  # fmt: skip

    slide(np.ones(len(x), dtype=np.int32))
    np.testing.assert_array_equal(t.state[contact, 0], x[contact, 0] + shift)
    slide(np.zeros(len(x), dtype=np.int32))
    np.testing.assert_allclose(t.state[contact, :2], x[contact], atol=1e-14)
    np.testing.assert_array_equal(t.state[others, :2], x[others])
    slide(np.zeros(len(x), dtype=np.int32), reach=0.2)
    foot = np.where(x[contact, 1] == 0, 3 + slope, 3 + 4 * slope)
    assert (np.abs(t.state[contact, 0] - foot) < 0.2 + 1e-12).all()


def coarsened(t, close, chain, edge, held=None, most=1000, interfaces=1) -> np.ndarray:
    """The particles that go."""
    n = len(t.state)
    held = np.zeros(n, dtype=np.int32) if held is None else held.astype(np.int32)
    freed, count = np.empty(n, dtype=np.int32), np.zeros(2, dtype=np.int32)
    kernels.coarsen(
        t.state, t.cells, t.across, t.fluid, t.corner, held, np.empty(2 * STAR + 4, dtype=np.int32),
        np.empty(max(n, len(t.cells)), dtype=np.int32), freed, count, len(t.cells), n, close, chain, edge, 0.02, most,
        interfaces,
    )  # fmt: skip
    return freed[: count[0]]


def areas(t) -> np.ndarray:
    """Of each fluid."""
    return np.bincount(t.fluid, weights=simplex_measure(t.state[:, :2], t.cells))


def wavy():
    """A grid with a wave on its middle line, which is an interface; two of its particles stand close. And these."""
    x, cells = grid(np.arange(9), np.arange(7))
    fluid = (x[cells, 1].mean(axis=1) > 3).astype(int)
    middle = np.flatnonzero(x[:, 1] == 3)
    x[middle, 1] += 0.2 * np.sin(1.1 * x[middle, 0])
    x[middle[4], 0] += 0.3
    x[middle[5], 0] -= 0.3
    return of(x, cells, fluid), middle


def test_a_coarser_interface_encloses_the_same_area():
    t, middle = wavy()
    t.state[:, 2:] = np.random.default_rng(0).normal(size=(len(t.state), 5))
    state, before = t.state.copy(), areas(t)
    assert list(coarsened(t, 0.1, 0.55, 0.1, interfaces=0)) == []
    gone = coarsened(t, 0.1, 0.55, 0.1)
    assert len(gone) == 1
    assert gone[0] in middle[4:6]
    stays = middle[4] if gone[0] == middle[5] else middle[5]
    t.compact()
    check(t, gone=1)
    np.testing.assert_allclose(areas(t), before, rtol=1e-14)
    np.testing.assert_allclose(t.state[stays, 2:], 0.5 * (state[middle[4], 2:] + state[middle[5], 2:]), rtol=1e-14)
    rest = np.setdiff1d(np.arange(len(state)), [*gone, stays])
    np.testing.assert_array_equal(t.state[rest], state[rest])
    assert len(border(t)) == 2 * 7


def test_who_is_fixed_stays():
    t, middle = wavy()
    held = np.zeros(len(t.state), dtype=bool)
    held[middle[4]] = True
    place = t.state[middle[4]].copy()
    assert coarsened(t, 0.1, 0.55, 0.1, held).tolist() == [middle[5]]
    np.testing.assert_array_equal(t.state[middle[4]], place)
    held[middle[5]] = True
    assert len(coarsened(wavy()[0], 0.1, 0.55, 0.1, held)) == 0


def test_no_more_go_than_asked_for_and_corners_never():
    x, cells = grid(0.5 * np.arange(13), 0.5 * np.arange(13))
    corners = fitting.hull_corners(Mesh(x, cells))
    assert corners.sum() == 4
    assert len(coarsened(of(x, cells), 0.6, 0.55, 0.2, corners, most=5)) == 5
    t = of(x, cells)
    gone = coarsened(t, 0.6, 0.55, 0.2, corners)
    assert not corners[gone].any()
    t.compact()
    check(t, gone=len(gone))
    assert simplex_measure(x, t.cells).sum() == pytest.approx(36.0, rel=1e-14)


@pytest.mark.xfail(strict=True, reason="a particle that another was collapsed into goes next, and so on to the wall")
def test_of_a_crowd_every_other_stays():
    """Whoever goes has somebody left to crowd: no hole is torn."""
    x, cells = grid(0.5 * np.arange(13), 0.5 * np.arange(13))
    gone = coarsened(of(x, cells), 0.6, 0.55, 0.2, fitting.hull_corners(Mesh(x, cells)))
    stays = np.delete(x, gone, axis=0)
    assert np.linalg.norm(x[gone, None] - stays, axis=2).min(axis=1).max() < 0.75


def test_particles_that_are_freed_fill_the_gaps():
    """Crowded on the left, wide on the right: as many as crowd go over, states are means of the ends."""
    lines = np.concatenate([np.linspace(0, 1.5, 6), np.linspace(1.5, 5.1, 3)[1:]])
    x, cells = grid(lines, np.arange(6))
    wall = (x[:, 1] == 0) | (x[:, 1] == 5) | (x[:, 0] == 0) | (x[:, 0] == lines[-1])
    velocity = np.where(wall[:, None], 0.0, np.stack([x[:, 0], x[:, 1]], axis=1))
    particles = tp.Particles(x, np.zeros(len(x)), wall, velocity=velocity, pressure=x[:, 0], spacing=1.0)
    mesh = Mesh(x, cells.astype(np.int32), np.zeros(len(cells), dtype=np.int32))
    after, repaired, changed = fitted.repair(particles, mesh, fitting.hull_corners(mesh), RULE)[:3]
    check(of(after.position, repaired.cells))
    assert changed.sum() >= 8
    np.testing.assert_allclose(after.pressure, after.position[:, 0], atol=1e-12)  # linear fields are handed on
    on_wall = ((after.position == 0) | (after.position == [5.1, 5])).any(axis=1)
    np.testing.assert_array_equal(after.wall, on_wall)
    assert (after.position[changed, 0] > 1.5).sum() >= 8
    np.testing.assert_array_equal(after.position[~changed], x[~changed])
    side = after.position[repaired.cells] - after.position[repaired.cells[:, [1, 2, 0]]]
    assert np.linalg.norm(side, axis=2).min() > 0.4


def test_the_longest_edges_come_first_and_long_borders_before_them():
    t, _ = wavy()
    edges, first = t.longest_edges(1.05)
    cell, i = edges // 3, edges % 3
    ends = np.stack([t.cells[cell, (i + 1) % 3], t.cells[cell, (i + 2) % 3]], axis=1)
    assert len(as_set(ends)) == len(edges) == len(Mesh(t.state[:, :2], t.cells).edges)
    x = t.state[:, :2]
    length = np.linalg.norm(x[ends[:, 0]] - x[ends[:, 1]], axis=1)
    assert (np.diff(length[:first]) <= 0).all()
    assert (np.diff(length[first:]) <= 0).all()
    borders = as_set(np.concatenate([border(t), border(t, hull=True)]))
    must = [tuple(sorted(pair)) in borders and d > 1.05 for pair, d in zip(ends.tolist(), length, strict=True)]
    np.testing.assert_array_equal(must, np.arange(len(edges)) < first)
    assert 0 < first < len(borders)


def test_a_broken_film_leaves_the_volumes_as_they_were():
    x, cells = grid(np.arange(9), np.array([0, 1, 2, 3, 3.25, 4.25, 5.25, 6.25]))
    y = x[cells, 1].mean(axis=1)
    fluid = np.where(((y > 3) & (y < 3.25)) | (y < 1), 1, 0).astype(np.int32)
    wall = (x[:, 0] == 0) | (x[:, 0] == 8) | (x[:, 1] == 0) | (x[:, 1] == 6.25)
    particles = tp.Particles(x, np.zeros(len(x)), wall, spacing=1.0)
    mesh = Mesh(x, cells.astype(np.int32), fluid)
    volume = np.bincount(fluid, weights=mesh.measure)
    position, result = x, mesh
    for _ in range(12):  # a particle moves by 0.1 spacings at most in each
        particles, result = fitted.repair(particles, result, fitting.hull_corners(mesh), RULE, volume)[:2]
        position = particles.position
    assert (position[result.cells[result.fluid == 1], 1] < 3).all()
    np.testing.assert_allclose(np.bincount(result.fluid, weights=result.measure), volume, rtol=1e-12)


@pytest.mark.xfail(strict=True, reason="what a body cannot take up is spread over all bodies, not those of its fluid")
def test_a_body_that_cannot_move_costs_its_fluid_no_volume():
    """A triangle in a corner of the tank, all of whose particles are on walls, beside a layer of the same fluid."""
    x, cells = grid(np.arange(9), np.arange(9))
    fluid = (x[cells, 1].mean(axis=1) > 5).astype(np.int32)
    turned = np.array([[8, 0], [8, 1], [7, 0]]) @ [9, 1]  # the lower right corner, cut off by an edge
    corner = np.isin(cells, [*turned, 7 * 9 + 1])
    square = np.flatnonzero(corner.all(axis=1))
    cells[square] = [[turned[2], turned[0], turned[1]], [turned[2], turned[1], 7 * 9 + 1]]
    fluid[square[0]] = 1
    wall = ((x == 0) | (x == 8)).any(axis=1)
    particles = tp.Particles(x, np.zeros(len(x)), wall, spacing=1.0)
    mesh = Mesh(x, cells.astype(np.int32), fluid)
    assert (mesh.measure > 0).all()
    volume = np.bincount(fluid, weights=mesh.measure)
    wanted = volume + [-0.05, 0.05]
    rule = fitting.FittedRule(film=0.0)
    after = fitted.repair(particles, mesh, fitting.hull_corners(mesh), rule, wanted)[1]
    np.testing.assert_allclose(np.bincount(after.fluid, weights=after.measure), wanted, rtol=1e-10)
