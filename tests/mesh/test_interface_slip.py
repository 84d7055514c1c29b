"""Where liquids slide along each other, and with which velocities."""

from __future__ import annotations

import math

import numpy as np
import pytest

import tipfem as tp
from tipfem.case.fluid import ranks
from tipfem.mesh.components import ON_INTERFACE
from tipfem.mesh.delaunay import triangulate
from tipfem.physics.sliding_liquids.slip import FREE, HeldSheets, InterfaceSlip, find_slip, may_slide
from tipfem.remesh.triangles.fitted import with_fluids

SPACING, GRAVITY = 0.05, np.array([0.0, -9.81])
LOWER, UPPER = tp.Fluid("water", 1000.0, 1e-3), tp.Fluid("oil", 800.0, 1e-3)


def layers(fluids=(LOWER, UPPER), **kwargs):
    """Particles at rest and the mesh of two layers, the interface at a height of 0.5."""
    tank = tp.tank((1.0, 1.0), SPACING, **kwargs).fill(fluids[0], box=((0, 0), (1, 0.5)))
    particles = tank.fill(fluids[1], box=((0, 0.5), (1, 1))).sample(fluids)
    return particles, with_fluids(triangulate(particles.position, particles.wall, SPACING), particles, ranks(fluids))


def found(particles, mesh, fluids=(LOWER, UPPER), gravity=GRAVITY) -> InterfaceSlip:
    slip = find_slip(mesh, particles, np.array([f.density for f in fluids]), gravity)
    assert slip is not None
    return slip


def test_particles_between_layers_slide_and_those_on_walls_do_not():
    particles, mesh = layers()
    slip, on = found(particles, mesh), (mesh.components.mark & ON_INTERFACE) > 0
    assert np.count_nonzero(on & particles.wall) == 2
    np.testing.assert_array_equal(np.sort(slip.owner), np.flatnonzero(on & ~particles.wall))
    np.testing.assert_allclose(np.abs(slip.tangent), [[1.0, 0.0]] * len(slip.owner), atol=1e-12)
    # The lighter liquid lies on the right-hand side of the tangent.
    assert (slip.tangent[:, 0] < 0).all()
    assert (slip.part == 1).all()
    level = particles.position[on, 1].mean()
    np.testing.assert_allclose(particles.position[on, 1], level)
    assert (particles.position[slip.beside, 1] > level + 0.4 * SPACING).all()


def test_nothing_slides_without_a_particle_beside_the_interface():
    """Of a bubble so small that all of its particles are on its surface."""
    tank = tp.tank((1.0, 1.0, 2.0), 0.2, jitter=0.2).fill(LOWER).fill(UPPER, disc=((0.5, 0.5, 0.5), 0.25))
    state = tp.Simulation(tp.Case(tank, [LOWER, UPPER], (0, 0, -9.81))).state
    inside = np.unique(state.mesh.cells[np.asarray(state.mesh.fluid) == 1])
    assert len(inside) > 3
    assert (state.mesh.components.mark[inside] & ON_INTERFACE).all()
    density = np.array([LOWER.density, UPPER.density])
    assert find_slip(state.mesh, state.particles, density, np.array([0, 0, -9.81])) is None


def test_in_space_they_slide_along_both_tangents_of_a_tilted_interface():
    """A plane through a ball's worth of particles: normals, slips of a jump, and turned tanks alike."""
    normal = np.array([0.2, -0.3, 1.0]) / np.linalg.norm([0.2, -0.3, 1.0])
    tank = tp.tank((1.0, 1.0, 1.0), 0.1, jitter=0.15, seed=2).fill(UPPER)
    case = tp.Case(tank.fill(LOWER, where=lambda x: (x - 0.5) @ normal < 0), [LOWER, UPPER], tuple(-9.81 * normal))
    state = tp.Simulation(case).state
    mesh, particles = state.mesh, state.particles
    slip = found(particles, mesh, gravity=-9.81 * normal)
    first, other = slip.tangent[::2], slip.tangent[1::2]
    np.testing.assert_array_equal(slip.owner[::2], slip.owner[1::2])
    np.testing.assert_allclose((first * other).sum(axis=1), 0, atol=1e-12)
    np.testing.assert_allclose(np.abs(np.cross(first, other) @ normal), 1, atol=0.02)
    assert len(first) > 30
    assert not particles.wall[slip.owner].any()
    assert ((particles.position[slip.beside] - 0.5) @ normal > 0.02).all()
    jump = np.where((particles.position - 0.5) @ normal > 0.02, 1.0, 0.0)[:, None] * np.array([0.03, 0.02, 0.0])
    vectors = slip.slip(jump)[:, None] * slip.tangent
    each = vectors[::2] + vectors[1::2]
    along = np.cross(first, other)
    wanted = jump.max(axis=0) - along * (along @ jump.max(axis=0))[:, None]
    np.testing.assert_allclose(each, slip.part[::2, None] * wanted, atol=1e-12)


def test_a_jump_of_the_velocity_is_the_slip_and_mean_places_lie_on_the_normal():
    particles, mesh = layers(jitter=0.2, seed=3)
    slip = found(particles, mesh)
    sum_of_weights = np.add.reduceat(slip.weight, slip.offsets[:-1])
    np.testing.assert_allclose(sum_of_weights, 1.0, rtol=1e-13)
    assert (slip.weight > 0).all()
    above = (particles.fluid == 1) & ((mesh.components.mark & ON_INTERFACE) == 0)
    jump = np.where(above, 0.3, 0.0)[:, None] * [1.0, 0.0]
    np.testing.assert_allclose(slip.slip(jump), 0.3 * slip.tangent[:, 0], rtol=1e-12)
    # The mean place of the particles beside lies on the normal, unless that took a weight below 0.
    beside_normal = np.abs(slip.slip(particles.position)) < 1e-12
    assert beside_normal.mean() > 0.5


def test_changes_without_momentum_have_none_with_what_slides():
    particles, mesh = layers(jitter=0.2, seed=3)
    slip, change = found(particles, mesh), np.random.default_rng(2).standard_normal((len(particles), 2))
    density = np.array([LOWER.density, UPPER.density])[mesh.fluid] * mesh.measure
    mass = np.bincount(mesh.cells.ravel(), np.repeat(density / 3, 3))
    change -= mass @ change / mass.sum()
    assert np.abs(slip.total(change)).max() > 1e-3 * mass.sum()
    completed = slip.without_momentum(change, mass)
    np.testing.assert_allclose(mass @ completed + slip.total(completed), 0.0, atol=1e-13 * mass.sum())
    assert (np.flatnonzero((completed != change).any(axis=1))[:, None] == slip.owner).any(axis=1).all()


@pytest.mark.parametrize("lumping", [1.0, 0.25])
def test_sums_are_those_of_two_fields(lumping):
    """Of the velocity that the lighter liquid has at its own corners, summed over the cells."""
    particles, mesh = layers(jitter=0.2, seed=3)
    slip, rng = found(particles, mesh), np.random.default_rng(1)
    a, b = rng.standard_normal((2, len(particles), 2))
    density = np.array([LOWER.density, UPPER.density])

    def of_cells(field):
        slid = field.copy()
        slid[slip.owner] += slip.slip(field)[:, None] * slip.tangent
        light = np.asarray(mesh.fluid) == 1
        return np.where(light[:, None, None], slid[mesh.cells], field[mesh.cells])

    def product(one, two):
        mass = density[mesh.fluid] * mesh.measure
        own, mean = (one * two).sum(axis=(1, 2)) / 3, (one.mean(axis=1) * two.mean(axis=1)).sum(axis=1)
        return (mass * (lumping * own + (1 - lumping) * mean)).sum()

    more = product(of_cells(a), of_cells(b)) - product(a[mesh.cells], b[mesh.cells])
    assert slip.product(a, b, lumping) == pytest.approx(more, rel=1e-10)
    assert slip.product(b, a, lumping) == pytest.approx(more, rel=1e-10)
    mass = density[mesh.fluid] * mesh.measure
    added = (mass[:, None] * (of_cells(a) - a[mesh.cells]).mean(axis=1)).sum(axis=0)
    np.testing.assert_allclose(slip.total(a), added, rtol=1e-10)
    uniform = np.tile([0.3, -2.0], (len(particles), 1))
    assert slip.work(uniform, a, lumping) == pytest.approx(slip.total(a) @ uniform[0], rel=1e-10)


def test_they_slide_as_long_as_gravity_keeps_all_waves_of_the_mesh_stable():
    """By Lamb, section 232: waves of the number pi / h grow from this jump on."""
    particles, mesh = layers()
    heavy, light = LOWER.density, UPPER.density
    critical = math.sqrt(9.81 * SPACING / math.pi * (heavy**2 - light**2) / (heavy * light))
    above = (particles.fluid == 1) & ((mesh.components.mark & ON_INTERFACE) == 0)
    for factor, part in ((0.6, 1.0), (0.9, (1 - 0.81) / (1 - FREE)), (0.999, 0.002 / (1 - FREE))):
        particles.velocity[above] = factor * critical, 0.0
        np.testing.assert_allclose(found(particles, mesh).part, part, rtol=2e-3)
    particles.velocity[above] = 1.001 * critical, 0.0
    assert find_slip(mesh, particles, np.array([heavy, light]), GRAVITY) is None


def test_nothing_slides_below_a_heavier_liquid_or_beside_a_gas():
    assert may_slide([1000.0, 500.0])
    assert not may_slide([1000.0, 1.2])
    assert not may_slide([1000.0, 1000.0])
    for fluids, gravity in (
        ((LOWER, UPPER), -GRAVITY),
        ((LOWER, UPPER), 0 * GRAVITY),
        ((LOWER, tp.Fluid("air", 1.2, 1.8e-5)), GRAVITY),
    ):
        particles, mesh = layers(fluids)
        assert find_slip(mesh, particles, np.array([f.density for f in fluids]), gravity) is None


def test_films_without_a_particle_of_their_own_do_not_slide():
    fluids = LOWER, UPPER
    tank = tp.tank((1.0, 1.0), SPACING).fill(LOWER).fill(UPPER, box=((0, 0.5), (1, 0.5 + 1.5 * SPACING)))
    particles = tank.sample(fluids)
    mesh = with_fluids(triangulate(particles.position, particles.wall, SPACING), particles, ranks(fluids))
    assert (np.asarray(mesh.fluid) == 1).any()
    slip = find_slip(mesh, particles, np.array([1000.0, 800.0]), GRAVITY)
    on = np.unique(mesh.cells[np.asarray(mesh.fluid) == 1])
    inside = [i for i in on if (np.asarray(mesh.fluid)[(mesh.cells == i).any(axis=1)] == 1).all()]
    assert slip is None or set(slip.beside) <= set(inside)


def held_sheets(fluids, sigma, **options):
    tension = np.zeros((3, 3))
    tension[0, 1] = tension[1, 0] = sigma
    return HeldSheets(ranks(fluids), tension, np.array([f.viscosity for f in fluids]), **options)


def test_tension_lets_liquids_of_equal_density_slide_until_the_longest_wave_that_must_be_stable_grows():
    """By Lamb, section 268, with k = pi / 4 h; the fluid of the lower rank is the one beside which particles slide."""
    fluids = tp.Fluid("water", 1000.0, 1e-3), tp.Fluid("oil", 1000.0, 2e-3)
    particles, mesh = layers(fluids)
    assert ranks(fluids).tolist() == [0, 1]
    density, sigma = np.array([1000.0, 1000.0]), 50.0
    assert find_slip(mesh, particles, density, GRAVITY) is None
    critical = math.sqrt(2 / 1000.0 * sigma * math.pi / (4 * SPACING))
    below = (particles.fluid == 0) & ((mesh.components.mark & ON_INTERFACE) == 0)
    for factor, part in ((0.6, 1.0), (0.9, (1 - 0.81) / (1 - FREE))):
        particles.velocity[below] = factor * critical, 0.0
        slip = find_slip(mesh, particles, density, GRAVITY, held_sheets(fluids, sigma))
        np.testing.assert_allclose(slip.part, part, rtol=2e-3)
        assert (particles.fluid[slip.beside] == 0).all()
    particles.velocity[below] = 1.001 * critical, 0.0
    assert find_slip(mesh, particles, density, GRAVITY, held_sheets(fluids, sigma)) is None


def test_tension_holds_a_heavier_liquid_above_only_if_it_is_strong():
    """Where sigma k > g (rho_1 - rho_2) / k for all waves shorter than 8 h."""
    particles, mesh = layers()
    density, k = np.array([LOWER.density, UPPER.density]), math.pi / (4 * SPACING)
    limit = 9.81 * 200.0 / k**2
    for factor, slides in ((0.99, False), (1.05, True)):
        slip = find_slip(mesh, particles, density, -GRAVITY, held_sheets((LOWER, UPPER), factor * limit))
        assert (slip is not None) == slides


def test_a_layer_that_is_resolved_slides_less():
    particles, mesh = layers()
    density, omega = np.array([LOWER.density, UPPER.density]), 2.0
    thick = 2 * (2e-3 / 1800.0) / omega / SPACING**2
    held = held_sheets((LOWER, UPPER), 1e3, rate=omega)
    slip = find_slip(mesh, particles, density, GRAVITY, held)
    np.testing.assert_allclose(slip.part, 1 / (1 + thick), rtol=1e-12)
    held = held_sheets((LOWER, UPPER), 1e3, rate=omega * thick)
    np.testing.assert_allclose(find_slip(mesh, particles, density, GRAVITY, held).part, 0.5, rtol=1e-12)


def test_the_rate_is_that_of_the_slips():
    """Of an oscillation from rest that becomes twice as fast; at first nothing has slid, and the layer is thin."""
    slip, dt = found(*layers()), 1e-3
    assert slip.rate == math.inf
    for omega, periods in ((5.0, 3), (10.0, 8)):
        for t in np.arange(0, periods * 2 * math.pi / omega, dt) + dt / 2:
            shape = np.linspace(0.5, 1.0, len(slip.owner))
            slip = slip.after(shape * math.sin(omega * t), shape * omega * math.cos(omega * t), dt)
        assert slip.rate == pytest.approx(omega, rel=0.15)
