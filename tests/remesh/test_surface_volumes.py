"""What fluids with a free surface keep in remeshing: volume, momentum, angular momentum; and they stay in the tank."""

from __future__ import annotations

import numpy as np
import pytest

import tipfem as tp
from tipfem.mesh.mesh import Mesh, Surface, volume_gradient
from tipfem.remesh.surface_volumes import (
    carried,
    kept_inside,
    mass_factor,
    restore_momenta,
    restore_volumes,
    return_momenta,
    without_spin_of_spray,
)

WATER = tp.Fluid("water", density=998.2, viscosity=1e-3)


def square(count=5, h=0.1):
    """A square of cells off any wall, and a particle above it that flies."""
    line = np.arange(count) * h
    x = np.stack([a.ravel() for a in np.meshgrid(line, line, indexing="ij")], axis=1)
    cells = []
    for i in range(count - 1):
        for j in range(count - 1):
            a, b, c, d = i * count + j, (i + 1) * count + j, (i + 1) * count + j + 1, i * count + j + 1
            cells += [(a, b, c), (a, c, d)]
    x = np.concatenate([x, [[0.2, 0.9]]])
    edge = ((x == 0) | (np.abs(x - line[-1]) < 1e-12)).any(axis=1)
    edge[-1] = False
    loose = np.arange(len(x)) == len(x) - 1
    volume = np.where(loose, h**2, 0.0)
    surface = Surface(edge, loose, loose, volume, np.zeros(len(x)))
    mesh = Mesh(x, np.array(cells, dtype=np.int32), surface=surface)
    rng = np.random.default_rng(1)
    v, a = rng.normal(size=(2, *x.shape))
    particles = tp.Particles(x, np.zeros(len(x)), np.zeros(len(x), bool), v, acceleration=a, spacing=h)
    return mesh, particles


def lumped(mesh, density=1000.0):
    share = np.repeat(density * mesh.measure / 3, 3)
    return np.bincount(mesh.cells.ravel(), share, len(mesh.position)) + density * mesh.surface.volume


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_gradient_of_the_volume_is_its_derivative(dimension):
    rng = np.random.default_rng(2)
    x, cells = rng.normal(size=(dimension + 2, dimension)), np.arange(dimension + 1, dtype=np.int32)[None]
    if Mesh(x, cells).measure[0] < 0:
        cells = cells[:, [1, 0, *range(2, dimension + 1)]]
    got = volume_gradient(Mesh(x, cells), np.ones(len(x), dtype=bool))
    for i in range(len(x)):
        for k in range(dimension):
            step = np.zeros_like(x)
            step[i, k] = 1e-6
            sides = [Mesh(x + sign * step, cells).measure[0] for sign in (1, -1)]
            assert got[i, k] == pytest.approx((sides[0] - sides[1]) / 2e-6, abs=1e-9)


def test_particles_carry_all_that_the_cells_had():
    """Also where particles leave, and where no corner of a cell is left."""
    mesh, particles = square()
    mass, m = 1000.0 * mesh.measure, lumped(mesh)
    leaves = np.zeros(len(m), dtype=bool)
    leaves[[0, 1, 6, 12, -1]] = True
    for gone in (np.zeros_like(leaves), leaves):
        kept = carried(mesh, mass, m, particles, gone)
        assert kept.volume.sum() == pytest.approx(mesh.measure.sum() + 0.01, rel=1e-12)
        assert kept.mass.sum() == pytest.approx(m.sum(), rel=1e-12)
        np.testing.assert_allclose(kept.momentum.sum(axis=0), m @ particles.velocity, rtol=1e-12)
        np.testing.assert_allclose(kept.force.sum(axis=0), m @ particles.acceleration, rtol=1e-12)
        x, v = particles.position, particles.velocity
        assert kept.moment.sum() == pytest.approx((m * (x[:, 0] * v[:, 1] - x[:, 1] * v[:, 0])).sum(), rel=1e-12)
        assert not kept.volume[gone].any()


def test_the_surface_moves_until_the_volume_is_that_of_the_particles():
    mesh, particles = square()
    kept = carried(mesh, 1000.0 * mesh.measure, lumped(mesh), particles, np.zeros(len(particles), dtype=bool))
    fewer = Mesh(mesh.position, mesh.cells[1:], surface=mesh.surface)  # a corner is cut off: particle 1 stays in others
    new = restore_volumes(fewer, particles.wall, kept.volume, 0.1)
    assert new.measure.sum() == pytest.approx(mesh.measure.sum(), rel=1e-13)
    assert np.abs(new.surface.deficit).sum() < 1e-15
    assert new.surface.volume[-1] == pytest.approx(0.01)
    moved = np.linalg.norm(new.position - mesh.position, axis=1)
    assert not moved[~mesh.surface.front].any()
    assert 0 < moved.max() < 0.02
    # What cannot be restored at once is remembered.
    more = restore_volumes(fewer, particles.wall, 2 * kept.volume, 0.1)
    assert more.measure.sum() + more.surface.deficit.sum() == pytest.approx(2 * mesh.measure.sum(), rel=1e-12)
    assert more.surface.deficit.sum() > 0
    # It weighs, too: the cells are heavier by as much.
    factor = mass_factor(more)
    assert (factor * more.measure).sum() == pytest.approx(2 * mesh.measure.sum(), rel=1e-12)
    assert mass_factor(new) is None or (mass_factor(new) == 1).all()
    held = restore_volumes(fewer, np.ones(len(particles), dtype=bool), kept.volume, 0.1)
    np.testing.assert_array_equal(held.position, mesh.position)


def test_particles_with_too_little_fluid_for_a_cell_are_spray():
    """Two landed drops of next to nothing over a face of the wall: no shift makes their cells as small."""
    mesh, _ = square()
    far = np.array([[3.0, 0.0], [3.1, 0.0], [3.0, 0.1], [3.1, 0.1]])
    x = np.concatenate([mesh.position, far])
    n = len(mesh.position)
    cells = np.concatenate([mesh.cells, np.array([(n, n + 1, n + 3), (n, n + 3, n + 2)], dtype=np.int32)])
    wall = np.arange(n + 4) >= n
    wall[-2:] = False
    s = mesh.surface

    def extended(values, new):
        return np.concatenate([values, np.full(4, new)])

    surface = Surface(
        extended(s.front, True),
        extended(s.pinned, False),
        extended(s.loose, False),
        extended(s.volume, 0.0),
        extended(s.deficit, 0.0),
    )
    whole = Mesh(x, cells, surface=surface)
    share = np.bincount(mesh.cells.ravel(), np.repeat(mesh.measure / 3, 3), n) + s.volume
    volume = np.concatenate([share, [1e-5, 0.0, 2e-5, 1e-5]])
    new = restore_volumes(whole, wall, volume, 0.1)
    np.testing.assert_array_equal(new.cells, mesh.cells)
    assert new.surface.loose[n:].tolist() == [False, False, True, True]
    assert new.surface.pinned[n:].all()
    np.testing.assert_allclose(new.surface.volume[n:], [0.0, 0.0, 2.5e-5, 1.5e-5], rtol=1e-12)
    np.testing.assert_array_equal(new.position[n:], far)
    assert not new.surface.deficit[n:].any()
    np.testing.assert_array_equal(new.surface.used, new.used)


def test_momenta_are_kept_by_a_rigid_motion():
    mesh, particles = square()
    m = lumped(mesh)
    kept = carried(mesh, 1000.0 * mesh.measure, m, particles, np.zeros(len(m), dtype=bool))
    cells = mesh.cells.copy()
    cells[0], cells[1] = (0, 5, 1), (1, 5, 6)  # a flip
    flipped = Mesh(mesh.position, cells, surface=mesh.surface)
    assert (flipped.measure > 0).all()
    new = lumped(flipped)
    done = restore_momenta(particles, flipped, new, kept)
    np.testing.assert_allclose(new @ done.velocity, m @ particles.velocity, rtol=1e-12)
    np.testing.assert_allclose(new @ done.acceleration, m @ particles.acceleration, rtol=1e-12)
    x = particles.position

    def moment(mass, v):
        return (mass * (x[:, 0] * v[:, 1] - x[:, 1] * v[:, 0])).sum()

    assert moment(new, done.velocity) == pytest.approx(moment(m, particles.velocity), rel=1e-12)
    # Rigid: a translation and a rotation.
    change = (done.velocity - particles.velocity)[:-1]
    spin = np.column_stack([np.tile(np.eye(2), (len(change), 1)), np.stack([-x[:-1, 1], x[:-1, 0]], axis=1).ravel()])
    assert np.linalg.lstsq(spin, change.ravel(), rcond=None)[1] < 1e-25
    wall = particles.shallow_copy(wall=np.arange(len(m)) == 3)
    at_wall = restore_momenta(wall, flipped, new, kept)
    np.testing.assert_allclose(at_wall.velocity, particles.velocity, rtol=1e-14)


def test_a_patch_gets_back_what_it_lost_and_no_more_energy():
    mesh, particles = square()
    cells = mesh.cells.copy()
    cells[10], cells[11] = (6, 11, 7), (7, 11, 12)
    flipped, m = Mesh(mesh.position, cells, surface=mesh.surface), lumped(mesh)
    new, v = lumped(flipped), particles.velocity
    nowhere = np.zeros(len(m), dtype=bool)
    old_cells, new_cells = (mesh.cells, 1000.0 * mesh.measure), (cells, 1000.0 * flipped.measure)
    done = return_momenta(particles, v, old_cells, new_cells, nowhere).velocity
    changed = np.flatnonzero((done != v).any(axis=1))
    energy, before = (new * (done**2).sum(axis=1)).sum(), (m * (v**2).sum(axis=1)).sum()
    without = (new * (v**2).sum(axis=1)).sum()
    assert energy <= max(before, without) * (1 + 1e-12)
    if len(changed):
        assert changed.tolist() == [6, 7, 11, 12]
    lost = m @ v - new @ v
    assert np.linalg.norm(m @ v - new @ done) <= np.linalg.norm(lost) * (1 + 1e-12)
    steady = return_momenta(particles, 0 * v + 1.0, old_cells, new_cells, nowhere)
    uniform = particles.shallow_copy(velocity=np.ones_like(v))
    np.testing.assert_allclose(
        return_momenta(uniform, uniform.velocity, old_cells, new_cells, nowhere).velocity, 1.0, rtol=1e-14
    )
    assert steady.velocity.shape == v.shape
    nowhere[6] = True
    np.testing.assert_array_equal(return_momenta(particles, v, old_cells, new_cells, nowhere).velocity, v)


def test_components_are_numbered_without_gaps():
    mesh, _ = square()
    apart = Mesh(mesh.position, mesh.cells[[0, 31]])
    count, label = apart.connected
    assert count == 2
    assert sorted(set(label)) == [-1, 0, 1]


def test_what_passes_through_a_wall_is_set_in_front_of_it():
    tank = tp.tank((1.0, 0.6), 0.1).fill(WATER)
    p = tank.sample([WATER])
    inside = np.flatnonzero(~p.wall)[:3]
    p.position[inside] = [[1.02, 0.3], [-0.01, 0.62], [0.5, 0.3]]
    p.velocity[inside] = [[2.0, 1.0], [-3.0, 4.0], [5.0, 5.0]]
    kept = kept_inside(p)
    np.testing.assert_allclose(kept.position[inside], [[0.995, 0.3], [0.005, 0.595], [0.5, 0.3]])
    np.testing.assert_allclose(kept.velocity[inside], [[0.0, 1.0], [0.0, 0.0], [5.0, 5.0]], atol=1e-12)
    others = np.setdiff1d(np.arange(len(p)), inside)
    np.testing.assert_array_equal(kept.position[others], p.position[others])


def free_drop(spacing, velocity, steps, time_step, **numerics):
    """A disc of water in flight, without gravity; its simulation after some steps."""
    tank = tp.tank((1, 1), spacing).fill(WATER, disc=((0.5, 0.5), 0.25), velocity=velocity)
    case = tp.Case(tank, [WATER], (0, 0), free_surface=True, numerics=tp.Numerics(**numerics))
    simulation = tp.Simulation(case, time_step=time_step)
    for _ in range(steps):
        simulation.step()
    return simulation


@pytest.mark.parametrize("tight", [{}, {"newton_tolerance": 1e-12, "acceleration_tolerance": 1e-10}])
def test_a_rotating_drop_keeps_its_volume_and_momentum(tight):
    """Half a radian of rigid rotation, whatever the tolerances, until instability shapes the surface anew."""

    def rigid(x):
        return np.stack([0.5 - x[:, 1], x[:, 0] - 0.5], axis=1)

    simulation = free_drop(0.05, rigid, 25, 0.02, **tight)
    history = simulation.history
    start = simulation.state.wanted_volume[0]
    assert abs(simulation.volume("water") / start - 1) < 1e-13
    momentum = np.array([[row["momentum_x"], row["momentum_y"]] for row in history[1:]])
    scale = WATER.density * start * 0.25
    assert np.abs(np.diff(momentum, axis=0)).max() < 1e-9 * scale


@pytest.mark.slow
@pytest.mark.parametrize(("count", "corner"), [(3, False), (3, True), (6, False)])
def test_a_block_that_lands_keeps_its_volume(count, corner):
    """A few particles, at 4 m/s, on the floor and in a corner: the same volume at any time, and in the tank.

    What the cells have no room for is spray, and all of it has its mass.
    """
    left, h = (0.033, 0.01) if corner else (0.2, 0.01)
    velocity = (-1.5, -4.0) if corner else (0.3, -4.0)
    box = ((left, 0.05), (left + count * h, 0.05 + count * h))
    tank = tp.tank((0.6, 0.4), h).fill(WATER, box=box, velocity=velocity)
    case = tp.Case(tank, [WATER], (0, -9.81), free_surface=True, interface="interpolated")
    simulation = tp.Simulation(case, time_step=1e-3)
    start, landed = simulation.state.wanted_volume[0], False
    while simulation.time < 0.055:
        simulation.step(0.055)
        position, surface = simulation.particles.position, simulation.mesh.surface
        assert (position >= -1e-12).all()
        assert (position <= np.array([0.6, 0.4]) + 1e-12).all()
        landed |= bool((surface.deficit > 1e-3 * h**2).any())
        row = simulation.history[-1]
        assert row["spray_volume_water"] == pytest.approx(surface.spray.sum(), rel=1e-12)
        cells = simulation.mesh.measure.sum()
        assert row["volume_water"] == pytest.approx(cells + row["spray_volume_water"], rel=1e-12)
        assert (surface.volume + surface.deficit)[surface.loose].min(initial=1.0) > 0
        whole = cells + surface.volume.sum() + surface.deficit.sum()
        assert whole == pytest.approx(start, rel=1e-12)
        assert simulation.state.mass.sum() == pytest.approx(WATER.density * whole, rel=1e-12)
    volumes = np.array([row["volume_water"] for row in simulation.history]) / start
    assert np.abs(volumes - 1).max() < 1e-10
    assert np.abs([row["source_volume_water"] for row in simulation.history]).max() == 0
    assert landed  # else nothing was tested


def test_spray_does_not_take_the_spin_of_the_cells_it_had():
    mesh, particles = square()
    m = lumped(mesh)
    kept = carried(mesh, 1000.0 * mesh.measure, m, particles, np.arange(len(m)) == 23)
    torn = mesh.surface.loose.copy()
    torn[24] = True  # which leaves the cells
    s = mesh.surface
    gone = (mesh.cells == 24).any(axis=1)
    front = s.front.copy()
    front[mesh.cells[gone]] = True
    front[24] = False
    surface = Surface(front, s.pinned, torn, np.where(torn, kept.volume, 0.0), s.deficit)
    other = Mesh(mesh.position, mesh.cells[~gone], surface=surface)
    given = without_spin_of_spray(kept, particles.position, other)
    x, p = particles.position[torn], given.momentum[torn]
    np.testing.assert_allclose(given.moment[torn, 0], x[:, 0] * p[:, 1] - x[:, 1] * p[:, 0], rtol=1e-12)
    assert abs(kept.moment[24, 0] - given.moment[24, 0]) > 1e-3 * abs(kept.moment[24, 0])
    assert given.moment.sum() == pytest.approx(kept.moment.sum(), rel=1e-12)


@pytest.mark.parametrize("spin", [0.0, 0.5, 2.0])
def test_a_free_drop_keeps_its_angular_momentum_to_round_off(spin):
    """Under pressure or torn apart."""
    case = tp.Case(
        tp.tank((1.2, 1.2), 0.025).fill(
            tp.Fluid("drop", density=1000.0, viscosity=0.01),
            disc=((0.6, 0.6), 0.2),
            velocity=lambda x: (x - 0.6) @ np.array([[1.0, spin], [-spin, -1.0]]),
        ),
        [tp.Fluid("drop", density=1000.0, viscosity=0.01)],
        (0, 0),
        free_surface=True,
    )
    simulation = tp.Simulation(case, time_step=0.02)
    found = []
    for _ in range(25):
        m, x, v = simulation.state.mass, simulation.particles.position, simulation.particles.velocity
        centre, mean = m @ x / m.sum(), m @ v / m.sum()
        y, w = x - centre, v - mean
        found.append([m @ (y[:, 0] * w[:, 1] - y[:, 1] * w[:, 0]), mean[0], mean[1]])
        simulation.step()
    drift = np.ptp(np.array(found), axis=0)
    assert drift[0] < 1e-11 * m.sum() * 0.2**2
    assert drift[1:].max() < 1e-12
