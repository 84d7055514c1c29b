"""Laws of viscosity: their formulas, the derivative of the residual with them, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from flow_problems import flow_problem
from residuals import residual_vector

import tipfem as tp
from tipfem.backend.arrays import download
from tipfem.case.fluid import law_table
from tipfem.case.rheology import LAWS, law_from, law_record, viscosities
from tipfem.fem.residual import record_width
from tipfem.fem.rheology import rates_and_viscosities
from tipfem.fem.time_integration import GeneralizedAlpha
from tipfem.mesh.delaunay import triangulate
from tipfem.physics.term import ElementProperties
from tipfem.step.linear_system import Workspace

EXAMPLES = {
    "bingham": tp.Bingham(yield_stress=20.0, viscosity=1.5, regularisation=0.4),
    "power": tp.PowerLaw(consistency=3.0, index=0.4, least_rate=0.2),
    "herschel-bulkley": tp.HerschelBulkley(20.0, 3.0, 1.6, regularisation=0.4, least_rate=0.2),
    "carreau": tp.Carreau(at_rest=5.0, at_infinity=0.3, time=0.7, index=0.3),
    "granular": tp.Granular(0.4, 0.7, diameter=0.02, grain_density=2500.0, regularisation=0.4, least_viscosity=0.1),
    "smagorinsky": tp.Smagorinsky(viscosity=0.5, constant=0.2),
}
EVERY_LAW = pytest.mark.parametrize("name", list(EXAMPLES))
DENSITY = 900.0


def stress(law, g, p, area):
    """Shear stress of a law at shear rates [Pa], by the formulas of the books."""
    if isinstance(law, tp.Bingham):
        return law.yield_stress * (1 - np.exp(-law.regularisation * g)) + law.viscosity * g
    if isinstance(law, tp.HerschelBulkley):
        smooth = np.sqrt(g**2 + law.least_rate**2) ** (law.index - 1)
        return law.yield_stress * (1 - np.exp(-law.regularisation * g)) + law.consistency * smooth * g
    if isinstance(law, tp.PowerLaw):
        return law.consistency * np.sqrt(g**2 + law.least_rate**2) ** (law.index - 1) * g
    if isinstance(law, tp.Carreau):
        part = (1 + (law.time * g) ** 2) ** ((law.index - 1) / 2)
        return (law.at_infinity + (law.at_rest - law.at_infinity) * part) * g
    if isinstance(law, tp.Smagorinsky):
        return (law.viscosity + DENSITY * law.constant**2 * area * g) * g
    pressed = np.maximum(p, 1e-9)
    inertial = g * law.diameter / np.sqrt(pressed / law.grain_density)
    friction = law.static_friction + (law.fast_friction - law.static_friction) / (law.inertial_number / inertial + 1)
    return law.least_viscosity * g + friction * np.maximum(p, 0) * (1 - np.exp(-law.regularisation * g))


@EVERY_LAW
def test_the_viscosity_is_that_of_the_formula(name):
    """In simple shear over nine decades, on both sides of where series take over, and pressures of both signs."""
    law = EXAMPLES[name]
    particles = (
        tp.tank((1.0, 1.0), 0.25, jitter=0.2)
        .fill(tp.Fluid("mud", DENSITY, law))
        .sample([tp.Fluid("mud", DENSITY, law)])
    )
    mesh = triangulate(particles.position, particles.wall, particles.spacing)
    laws = law_table([tp.Fluid("mud", DENSITY, law)])
    for g in np.logspace(-5, 4, 10):
        for p in (300.0, -300.0):
            velocity = np.stack([g * mesh.position[:, 1], 0 * mesh.position[:, 0]], axis=1)
            fluid = np.zeros(len(mesh.cells), dtype=np.int32)
            rate, mu = rates_and_viscosities(mesh, velocity, np.full(len(velocity), p), fluid, laws)
            np.testing.assert_allclose(rate, g, rtol=1e-9)
            np.testing.assert_allclose(mu, stress(law, g, p, mesh.measure) / g, rtol=2e-7)
            read = viscosities(laws, fluid, rate, np.full(len(rate), p), mesh.measure)  # when results are read
            np.testing.assert_allclose(read, mu, rtol=1e-9)


def test_the_shear_rate_of_a_ring_has_its_hoop():
    """Of u = (r, -2 z) it is the root of 12, in cells at the axis, too."""
    mud = tp.Fluid("mud", DENSITY, EXAMPLES["power"])
    tank = tp.tank((1.0, 1.0), 0.25, jitter=0.2, coordinates="axisymmetric").fill(mud)
    particles, laws = tank.sample([mud]), law_table([mud])
    mesh = triangulate(particles.position, particles.wall, particles.spacing, period=tank.period)
    given = np.zeros(len(particles)), np.zeros(len(mesh.cells)), laws
    rate, _ = rates_and_viscosities(mesh, mesh.position * (1.0, -2.0), *given)
    np.testing.assert_allclose(rate, np.sqrt(12), rtol=1e-12)


@EVERY_LAW
@pytest.mark.parametrize("jacobian", ["rows", "matrix-free"])
@pytest.mark.parametrize("size", [(1.0, 0.8), (1.0, 1.0, 0.75)], ids=["2-D", "3-D"])
def test_the_jacobian_is_the_derivative_of_the_residual(name, size, jacobian):
    """By differences of fourth order; a step in which viscosity outweighs mass."""
    fluids = [tp.Fluid("mud", DENSITY, EXAMPLES[name])]
    tank = tp.tank(size, 0.2 if len(size) == 2 else 0.35, jitter=0.2, seed=3).fill(fluids[0])
    particles = tank.sample(fluids)
    rng = np.random.default_rng(5)
    free = ~particles.wall[:, None]
    particles.velocity[:] = rng.uniform(-1, 1, particles.velocity.shape) * free
    pressure = rng.uniform(100, 500, len(particles))
    mesh = triangulate(particles.position, particles.wall, particles.spacing)
    cells, laws = np.zeros(len(mesh.cells), dtype=np.int32), law_table(fluids)
    _, viscosity = rates_and_viscosities(mesh, particles.velocity, pressure, cells, laws)
    density, nothing = np.full(len(mesh.cells), DENSITY), np.zeros(len(mesh.cells))
    problem = flow_problem(
        mesh,
        particles,
        ElementProperties(density, viscosity, nothing, None, laws, cells),
        GeneralizedAlpha(0.3, 5.0),
        np.zeros_like(particles.position),
        0.25,
        Workspace(),
        jacobian=jacobian,
    )
    u = rng.uniform(-0.05, 0.05, mesh.position.shape) * free * particles.spacing
    du = rng.uniform(-1, 1, u.shape) * free * particles.spacing
    dp = rng.uniform(-1, 1, len(u)) * 100

    def residual(step):
        problem.residual(problem.vector(u + step * du, pressure + step * dp))
        return residual_vector(problem)

    step = 1e-3
    one, two = (residual(k * step) - residual(-k * step) for k in (1, 2))
    wanted = (8 * one - two) / (12 * step)
    residual(0.0)
    problem.linearise()
    out = problem.buffers.get("test.product", problem.size)
    direction = np.concatenate([du, dp[:, None]], axis=1).ravel()
    problem.product(problem.buffers.upload("test.direction", direction), out)
    found = download(out, problem.size).reshape(wanted.shape)
    error = abs(found - wanted).max(axis=0) / abs(wanted).max(axis=0)
    assert (error < 1e-8).all(), error


@pytest.mark.parametrize("coordinates", ["planar", "axisymmetric"])
@pytest.mark.parametrize("name", ["bingham", "herschel-bulkley", "granular", "power"])
def test_the_direction_of_a_yield_stress_follows_the_corrections(name, coordinates):
    """It is that of the rates at the start, and no longer than 1; elsewhere it is that of a linear model."""
    fluids = [tp.Fluid("mud", DENSITY, EXAMPLES[name])]
    tank = tp.tank((1.0, 0.8), 0.2, jitter=0.2, seed=3, coordinates=coordinates).fill(fluids[0])
    particles, rng = tank.sample(fluids), np.random.default_rng(5)
    particles.velocity[:] = rng.uniform(-1, 1, particles.velocity.shape) * ~particles.wall[:, None]
    pressure = rng.uniform(100, 500, len(particles))
    mesh = triangulate(particles.position, particles.wall, particles.spacing, period=tank.period)
    cells, laws = np.zeros(len(mesh.cells), dtype=np.int32), law_table(fluids)
    _, viscosity = rates_and_viscosities(mesh, particles.velocity, pressure, cells, laws)
    density, nothing = np.full(len(mesh.cells), DENSITY), np.zeros(len(mesh.cells))
    properties = ElementProperties(density, viscosity, nothing, None, laws, cells)
    scheme, force = GeneralizedAlpha(0.3, 5.0), np.zeros_like(particles.position)
    problem = flow_problem(mesh, particles, properties, scheme, force, 0.25, Workspace())
    start = record_width(2, axial=tank.period.axial) + 1

    def at(u, base):
        """T and P of all elements in both places, and the direction in which stress rises; after a correction."""
        problem._base = base
        problem.residual(problem.vector(u, pressure))
        whole = download(problem.equations.linear.record, len(mesh.cells))[:, start : start + 25].reshape(-1, 5, 5)
        return whole[:, 1:].reshape(-1, 2, 2, 5), whole[:, 0]

    u = rng.uniform(-0.05, 0.05, mesh.position.shape) * particles.spacing
    (first, _), exact = at(u, -1), at(u, -1)[1]
    if name == "power":  # which does not yield
        np.testing.assert_array_equal(at(2 * u, 0)[1], at(2 * u, -1)[1])
        return
    rates, dual = first[:, 0, 0], first[:, 0, 1]
    np.testing.assert_allclose(dual, part_of(rates)[:, None] * rates, rtol=1e-9)
    if coordinates == "axisymmetric":
        assert abs(rates[:, 4]).max() > 0.1  # with the hoop's
    # Nothing has been corrected: the same again, in the other place.
    again, same = at(u, 0)
    np.testing.assert_allclose(again[:, 1], first[:, 0], rtol=1e-12)
    np.testing.assert_allclose(same, exact, rtol=1e-9, atol=1e-12 * abs(exact).max())
    # Of small corrections the model is right to first order; of large ones it stays within the yield stress.
    change = rng.uniform(-1, 1, u.shape) * particles.spacing
    errors = []
    for step in (1e-3, 5e-4):
        at(u, -1)
        found, _ = at(u + step * change, 0)
        true = part_of(found[:, 1, 0])[:, None] * found[:, 1, 0]
        errors.append(abs(found[:, 1, 1] - true).max())
    assert 3.5 < errors[0] / errors[1] < 4.5
    at(u, -1)
    far, _ = at(u + 0.5 * change, 0)
    assert size(far[:, 1, 1]).max() <= 1 + 1e-12
    assert abs(far[:, 1, 1] - part_of(far[:, 1, 0])[:, None] * far[:, 1, 0]).max() > 0.1


def size(rates):
    """g (M,) of the rates T (M, 5), or the length of P."""
    return np.sqrt(0.5 * (rates**2).sum(axis=1))


def part_of(rates):
    """r(g) of rates T (M, 5), with m = 0.4 s."""
    g = np.maximum(size(rates), 1e-9)
    return -np.expm1(-0.4 * g) / g


def test_steps_of_mud_that_slumps_take_few_newton_iterations():
    """With directions that are not unknowns of their own they take 12 and more, and a third of them is refused."""
    mud = tp.Fluid("mud", 1500.0, tp.Bingham(60.0, 1.0, regularisation=1000.0))
    tank = tp.tank((0.3, 0.13), 0.0125).fill(mud, box=((0, 0), (0.15, 0.1))).wall("left", slip=True)
    simulation = tp.Simulation(tp.Case(tank, [mud], (0, -9.81), free_surface=True))
    for _ in range(30):
        simulation.step()
    rows = simulation.history
    assert sum(row["newton_iterations"] for row in rows) < 8 * len(rows)
    assert sum(row["refused_steps"] for row in rows) <= 2


@EVERY_LAW
def test_a_law_is_kept_as_plain_values(name):
    law = EXAMPLES[name]
    record = law_record(law)
    assert record["law"] == name == law.law
    assert law_from(record) == law
    assert law_record(2.5) == law_from(2.5) == 2.5
    assert LAWS[name] is type(law)
    assert name in str(law)


def test_newtonian_fluids_have_no_table():
    assert law_table([tp.Fluid("water", 1000.0, 1e-3)]) is None


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: tp.Bingham(-1.0, 1.0), r"Bingham: yield_stress is -1.0 Pa; it must be a number >= 0 in Pa"),
        (lambda: tp.PowerLaw(1.0, 7.0), r"PowerLaw: index is 7.0; it must be a number from 0.1 to 3"),
        (lambda: tp.Carreau(1.0, 0.1, 0.0, 0.5), r"Carreau: time is 0.0 s; it must be a number > 0 in s"),
        (lambda: tp.Fluid("mud", 1000.0, "thick"), r"Fluid 'mud': viscosity is 'thick'; .*or a law of viscosity"),
    ],
)
def test_bad_numbers_are_refused(make, text):
    with pytest.raises(ValueError, match=text):
        make()


def test_what_laws_do_not_go_with_is_refused():
    mud, water = tp.Fluid("mud", 1200.0, EXAMPLES["bingham"]), tp.Fluid("water", 1000.0, 1e-3)
    tank = tp.tank((1, 1), 0.1).fill(water).fill(mud, box=((0, 0), (1, 0.5)))
    with pytest.raises(ValueError, match="'mud': viscosity follows a law, and cells of several fluids have one"):
        tp.Case(tank, [mud, water], (0, -9.81), interface="interpolated")
    tank = tp.tank((1, 1), 0.1).fill(mud).wall("bottom", law="layer")
    with pytest.raises(
        ValueError, match=r"wall 'bottom': law is 'layer', and mud follows a law of viscosity, .* it must be 'no-slip'"
    ):
        tp.Case(tank, [mud], (0, -9.81))


def test_walls_are_no_slip_by_default_but_for_eddies():
    for law, wall in ((EXAMPLES["bingham"], "no-slip"), (EXAMPLES["smagorinsky"], "layer"), (1e-3, "layer")):
        fluid = tp.Fluid("mud", 1200.0, law)
        case = tp.Case(tp.tank((1, 1), 0.1).fill(fluid), [fluid], (0, -9.81))
        assert ({each.law for each in case.walls} or {"no-slip"}) == {wall}


@pytest.mark.parametrize(
    ("law", "yield_stress", "consistency", "index"),
    [(tp.Bingham(0.2, 1.0, regularisation=1000.0), 0.2, 1.0, 1.0), (tp.PowerLaw(0.5, 0.5), 0.0, 0.5, 0.5)],
    ids=["bingham", "power"],
)
def test_a_flow_between_plates_has_the_exact_profile_and_its_budget_closes(law, yield_stress, consistency, index):
    """u' = ((f y - tau_y) / K)^(1 / n) from the middle on, with the plug where f y < tau_y; m = 1000 s is stiff."""
    fluid, across = tp.Fluid("mud", 1.0, law), 12
    tank = tp.tank((8 / across, 1.0), 1 / across, jitter=0.1, periodic="x").fill(fluid)
    simulation = tp.Simulation(tp.Case(tank.wall("bottom", law="no-slip"), [fluid], (1.0, 0.0)))
    while simulation.time < 1.5:
        simulation.step()
    power = 1 + 1 / index

    def left(y):
        return np.maximum(y - yield_stress, 0.0) ** power / power / consistency ** (1 / index)

    y = abs(simulation.particles.position[:, 1] - 0.5)
    exact = left(0.5) - left(y)
    error = simulation.particles.velocity[:, 0] - exact
    assert np.sqrt((error**2).mean()) < 0.01 * exact.max()
    assert abs(error).max() < 0.02 * exact.max()
    rows = simulation.history
    work = sum(row["viscous_dissipation"] for row in rows)
    assert abs(sum(row["energy_residual"] for row in rows)) < 1e-6 * work
    assert sum(row["refused_steps"] for row in rows) <= 2
