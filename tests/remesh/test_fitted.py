"""tipfem/fitted.py: what a repair keeps."""

from dataclasses import replace

import numpy as np
import pytest
from states import first_state, moved_to
from triangulations import check, grid, of

import tipfem as tp
from tipfem.mesh.mesh import Mesh, simplex_measure
from tipfem.remesh.remeshers import FittedRemesher
from tipfem.remesh.triangles import fitted
from tipfem.remesh.triangles import fitted as fitting
from tipfem.remesh.triangles.edge_operations import MASS, TARGET

WATER, AIR = tp.Fluid("water", 998.0, 1e-3), tp.Fluid("air", 1.2, 1.8e-5)
GLYCERIN = tp.Fluid("glycerin", 1261.0, 1.4)
RULE = fitting.FittedRule()
DENSITY = np.array([998.0, 1.2])


def started(kind: str, h: float, seed: int = 0, keep: bool = True):
    """A remesher, and the state that it starts with, in a unit square."""
    tank = tp.tank((1.0, 1.0), h, jitter=0.2, seed=seed).fill(AIR)
    fluids = [WATER, AIR]
    if kind == "layer":
        tank.fill(WATER, box=((0, 0), (1, 0.5)))
    elif kind == "disc":
        tank.fill(WATER, disc=((0.5, 0.4), 0.27))
    else:
        tank.fill(WATER, box=((0, 0), (1, 0.6))).fill(GLYCERIN, box=((0, 0), (0.4, 0.4)))
        fluids = [WATER, AIR, GLYCERIN]
    remesher = FittedRemesher(fluids, RULE, walls_have_fluids=False, keep=keep)
    return remesher, first_state(remesher, tank.sample(fluids, fitted=True))


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


@pytest.mark.slow(but=("three-2-False",))
@pytest.mark.parametrize("keep", [True, False])
@pytest.mark.parametrize(("kind", "seed"), [("layer", 1), ("disc", 0), ("three", 2)])
def test_a_stirred_mesh_stays_a_mesh(kind, seed, keep):
    """300 repairs in vortices that turn at random; at each, all that a repair promises."""
    h = 0.1
    remesher, state = started(kind, h, seed, keep)
    particles, mesh = state.particles, state.mesh
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
        state = remesher.remesh(moved_to(state, after))
        particles, mesh = state.particles, state.mesh
        check(of(particles.position, mesh.cells, mesh.fluid))
        np.testing.assert_array_equal(mesh.neighbours, Mesh(mesh.position, mesh.cells).neighbours)
        assert len(particles) == count
        np.testing.assert_array_equal(particles.position[fixed], corners)
        on_wall = ((particles.position == 0) | (particles.position == 1)).any(axis=1)
        np.testing.assert_array_equal(particles.wall, on_wall)
        assert not particles.velocity[particles.wall].any()
        volume = np.bincount(mesh.fluid, weights=mesh.measure, minlength=len(volumes))
        error.append(np.abs(volume - (volumes if keep else before)).max())
        side = particles.position[mesh.cells] - particles.position[mesh.cells[:, [1, 2, 0]]]
        shortest.append(np.linalg.norm(side, axis=2).min() / h)
        assert state.relocations == state.relocated.sum()
        placed += state.relocations
    assert placed > 200
    assert np.median(error) < 1e-11
    # A body that would have to move further than it may in one repair gets the rest in the next; one
    # with no particle off the walls cannot move at all.
    assert np.mean(np.array(error) < 1e-8) > (0.6 if kind == "three" else 0.9)
    assert max(error) < 0.1 * h * h
    assert min(shortest) > 0.05
    assert np.median(shortest) > 0.3


def test_a_repair_of_what_needs_none_changes_nothing():
    remesher, state = started("layer", 0.1, keep=False)
    remeshed = remesher.remesh(moved_to(state, state.particles))
    for name in ("position", "velocity", "acceleration", "pressure", "wall"):
        assert getattr(remeshed.particles, name) is getattr(state.particles, name)
    np.testing.assert_array_equal(remeshed.particles.fluid, state.particles.fluid)
    np.testing.assert_array_equal(remeshed.mesh.cells, state.mesh.cells)
    assert not remeshed.relocated.any()


def test_the_names_of_two_fluids_do_not_matter():
    """Swapped labels: the same triangles, the same places but for round-off."""
    state = started("disc", 0.1, seed=3)[1]
    particles, mesh = state.particles, state.mesh
    fixed = fitting.hull_corners(mesh)
    densities = [np.array([998.0, 1.2]), np.array([1.2, 998.0])]
    states = [(particles, mesh), (particles, Mesh(mesh.position, mesh.cells, 1 - mesh.fluid))]
    placed = 0
    for k in range(60):
        step = 0.02 * stirred(states[0][0].position, 1 + k // 20)
        results = [
            fitted.repair(moved(p, m, step), m, d, fixed, RULE) for (p, m), d in zip(states, densities, strict=True)
        ]
        (one, mesh_one, changed, *_), (other, mesh_other, *_) = results
        placed += int(changed.sum())
        np.testing.assert_array_equal(mesh_one.cells, mesh_other.cells)
        np.testing.assert_array_equal(mesh_one.fluid, 1 - mesh_other.fluid)
        np.testing.assert_allclose(one.position, other.position, atol=1e-10)
        same = other.copy(position=one.position)  # what round-off does to a walk is not the question
        states = [(one, mesh_one), (same, Mesh(one.position, mesh_other.cells, mesh_other.fluid))]
    assert placed > 20


def momentum(particles, mesh, density) -> np.ndarray:
    """(2,) of all particles."""
    t = of(particles.position, mesh.cells, mesh.fluid, density=density)
    return t.state[:, MASS] @ particles.velocity


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("fluids", [1, 2])
def test_a_repair_away_from_the_walls_keeps_momentum(fluids, seed):
    """Some particles inside a fluid crowd others and leave gaps: flips, collapses and splits, far from the walls."""
    rng = np.random.default_rng(seed)
    x, cells = grid(np.arange(17), np.arange(17))
    wall = ((x == 0) | (x == 16)).any(axis=1)
    fluid = (x[cells, 1].mean(axis=1) > 4).astype(np.int32) * (fluids - 1)
    mesh = Mesh(x, cells.astype(np.int32), fluid)
    pushed = (x >= 7).all(axis=1) & (x <= 13).all(axis=1)
    step = np.where(pushed[:, None], rng.uniform(-0.45, 0.45, x.shape), 0.0)
    while (simplex_measure(x + step, mesh.cells) < 0.05).any():
        step *= 0.95
    x = x + step
    mesh = Mesh(x, mesh.cells, fluid)
    velocity = np.where(wall[:, None], 0.0, rng.normal(size=x.shape))
    particles = tp.Particles(x, np.zeros(len(x)), wall, velocity=velocity, spacing=1.0)
    density = DENSITY[:fluids]
    after, repaired, changed = fitted.repair(particles, mesh, density, fitting.hull_corners(mesh), RULE)[:3]
    scale = np.abs(of(x, mesh.cells, fluid, density=density).state[:, MASS:TARGET] * velocity).sum()
    assert changed.sum() >= 2
    assert (repaired.cells != mesh.cells).any()
    assert (after.velocity[~changed] != velocity[~changed]).any()
    np.testing.assert_allclose(
        momentum(after, repaired, density), momentum(particles, mesh, density), atol=1e-12 * scale
    )


def test_a_motion_as_one_stays_one_in_every_repair():
    """Walls included: no flip, collapse, split, slide or broken film finds a momentum to give back."""
    remesher, state = started("disc", 0.1, seed=2)
    state.particles.velocity[:] = [0.7, -0.3]
    placed = 0
    for k in range(60):
        particles, mesh = state.particles, state.mesh
        after = moved(particles, mesh, 0.02 * stirred(particles.position, 1 + k // 20))
        stirred_state = replace(state, particles=after, mesh=mesh)
        state = remesher.remesh(moved_to(stirred_state, after))
        placed += state.relocations
    assert placed > 20
    velocity = state.particles.velocity
    np.testing.assert_allclose(velocity, np.tile([0.7, -0.3], (len(velocity), 1)), atol=1e-11)


def test_particles_that_are_freed_fill_the_gaps():
    """Crowded on the left, wide on the right: as many as crowd go over, states are means of the ends."""
    lines = np.concatenate([np.linspace(0, 1.5, 6), np.linspace(1.5, 5.1, 3)[1:]])
    x, cells = grid(lines, np.arange(6))
    wall = (x[:, 1] == 0) | (x[:, 1] == 5) | (x[:, 0] == 0) | (x[:, 0] == lines[-1])
    velocity = np.where(wall[:, None], 0.0, np.stack([x[:, 0], x[:, 1]], axis=1))
    particles = tp.Particles(x, np.zeros(len(x)), wall, velocity=velocity, pressure=x[:, 0], spacing=1.0)
    mesh = Mesh(x, cells.astype(np.int32), np.zeros(len(cells), dtype=np.int32))
    after, repaired, changed = fitted.repair(particles, mesh, np.ones(1), fitting.hull_corners(mesh), RULE)[:3]
    check(of(after.position, repaired.cells))
    assert changed.sum() >= 8
    np.testing.assert_allclose(after.pressure, after.position[:, 0], atol=1e-12)  # linear fields are handed on
    on_wall = ((after.position == 0) | (after.position == [5.1, 5])).any(axis=1)
    np.testing.assert_array_equal(after.wall, on_wall)
    assert (after.position[changed, 0] > 1.5).sum() >= 8
    np.testing.assert_array_equal(after.position[~changed], x[~changed])
    side = after.position[repaired.cells] - after.position[repaired.cells[:, [1, 2, 0]]]
    assert np.linalg.norm(side, axis=2).min() > 0.4


def test_a_broken_film_leaves_the_volumes_as_they_were():
    x, cells = grid(np.arange(9), np.array([0, 1, 2, 3, 3.25, 4.25, 5.25, 6.25]))
    y = x[cells, 1].mean(axis=1)
    fluid = np.where(((y > 3) & (y < 3.25)) | (y < 1), 1, 0).astype(np.int32)
    wall = (x[:, 0] == 0) | (x[:, 0] == 8) | (x[:, 1] == 0) | (x[:, 1] == 6.25)
    particles = tp.Particles(x, np.zeros(len(x)), wall, spacing=1.0)
    mesh = Mesh(x, cells.astype(np.int32), fluid)
    volume = np.bincount(fluid, weights=mesh.measure)
    result, fixed = mesh, fitting.hull_corners(mesh)
    for _ in range(12):  # a particle moves by 0.1 spacings at most in each
        particles, result = fitted.repair(particles, result, DENSITY, fixed, RULE, total=volume)[:2]
    assert (particles.position[result.cells[result.fluid == 1], 1] < 3).all()
    np.testing.assert_allclose(np.bincount(result.fluid, weights=result.measure), volume, rtol=1e-12)


def test_what_a_repair_changes_of_volumes_it_restores_nearby():
    """The tip of a long surface meets a wall; the surface far from it stays."""
    x, cells = grid(np.arange(41), np.arange(5))
    x[np.flatnonzero((x[:, 0] == 20) & (x[:, 1] == 1)), 1] = 0.2
    fluid = (x[cells, 1].max(axis=1) > 1).astype(np.int32)
    wall = (x[:, 0] % 40 == 0) | (x[:, 1] % 4 == 0)
    particles = tp.Particles(x, np.zeros(len(x)), wall, spacing=1.0)
    mesh = Mesh(x, cells.astype(np.int32), fluid)
    repaired = fitted.repair(particles, mesh, DENSITY, wall.astype(np.int32), RULE)
    assert repaired.relocated.sum() == 1
    volume = [np.bincount(m.fluid, weights=m.measure) for m in (mesh, repaired.mesh)]
    np.testing.assert_allclose(*volume, rtol=1e-9)
    kept = ~repaired.relocated
    shift = np.linalg.norm(repaired.particles.position - x, axis=1) * kept
    assert shift.max() > 1e-3
    assert shift[np.abs(x[:, 0] - 20) > 6].max() < 1e-10


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
    rule = fitting.FittedRule(thin_film=0.0)
    after = fitted.repair(particles, mesh, DENSITY, fitting.hull_corners(mesh), rule, total=wanted)[1]
    np.testing.assert_allclose(np.bincount(after.fluid, weights=after.measure), wanted, rtol=1e-10)
