"""The matrix-free Newton-Krylov solve: the same products, preconditioner and steps as with the Jacobian's rows."""

import numpy as np
import pytest
from flow_problems import flow_problem

import tipfem as tp
from tipfem.backend.arrays import SPARE, download
from tipfem.fem.time_integration import GeneralizedAlpha
from tipfem.mesh.delaunay import triangulate
from tipfem.physics.term import ElementProperties
from tipfem.step.linear_system import Workspace


def problem_of(size, jacobian, lumping=1.0):
    """A step of two fluids from a state at random, linearised, and the particles."""
    water, air = tp.Fluid("water", density=998.0, viscosity=0.5), tp.Fluid("air", density=1.2, viscosity=0.1)
    tank = tp.tank(size, 0.1 if len(size) == 2 else 0.25, jitter=0.2, seed=3).fill(water)
    tank = tank.fill(air, box=((0.0,) * (len(size) - 1) + (0.6 * size[-1],), size))
    particles = tank.sample([water, air])
    rng = np.random.default_rng(5)
    free = ~particles.wall[:, None]
    particles.velocity[:] = rng.uniform(-1, 1, particles.velocity.shape) * free
    particles.pressure[:] = rng.uniform(-500, 500, len(particles))
    mesh = triangulate(particles.position, particles.wall, particles.spacing)
    light = particles.fluid[mesh.cells].max(axis=1) == 1
    problem = flow_problem(
        mesh,
        particles,
        ElementProperties(
            np.where(light, 1.2, 998.0), np.where(light, 0.1, 0.5), *np.tile([[0.0], [lumping]], len(light))
        ),
        GeneralizedAlpha(0.3, 2e-3),
        np.tile([0.0, -9.81, 0.0][: len(size)], (len(particles), 1)),
        0.25,
        Workspace(),
        jacobian=jacobian,
    )
    u = rng.uniform(-0.05, 0.05, mesh.position.shape) * free * particles.spacing
    problem.residual(problem.vector(u, particles.pressure))
    problem.linearise()
    return problem


@pytest.mark.parametrize("size", [(1.0, 0.8), (1.0, 1.0, 0.75)], ids=["2-D", "3-D"])
@pytest.mark.parametrize("lumping", [1.0, 0.25])
def test_products_and_preconditioner_are_those_of_the_rows(size, lumping):
    rows, free = (problem_of(size, jacobian, lumping) for jacobian in ("rows", "matrix-free"))
    assert rows.system.stores_rows
    assert not free.system.stores_rows
    assert not any(name == "blocks" and len(a.to_numpy()) > SPARE for name, a in free.buffers._arrays.items())
    values = np.random.default_rng(1).standard_normal(rows.size) * (download(rows.equations.scale, rows.size) > 0)
    for name, tolerance in (("product", 1e-12), ("precondition", 1e-9)):
        found = []
        for problem in (rows, free):
            v, out = problem.buffers.upload("test.v", values), problem.buffers.get("test.out", problem.size)
            getattr(problem, name)(v, out)
            found.append(download(out, problem.size).reshape(problem.nodes, -1))
        for k in range(found[0].shape[1]):
            scale = abs(found[0][:, k]).max()
            assert scale > 0
            np.testing.assert_allclose(found[1][:, k], found[0][:, k], atol=tolerance * scale)


@pytest.mark.parametrize("size", [(1.0, 0.8), (1.0, 1.0, 0.75)], ids=["2-D", "3-D"])
def test_the_matrix_on_the_host_is_that_of_the_products(size):
    problem = problem_of(size, "rows")
    values = np.random.default_rng(2).standard_normal(problem.size)
    v, out = problem.buffers.upload("test.v", values), problem.buffers.get("test.out", problem.size)
    problem.product(v, out)
    found = download(out, problem.size)
    np.testing.assert_allclose(problem.system.matrix() @ values, found, atol=1e-13 * abs(found).max())


def test_a_matrix_free_system_has_no_matrix():
    with pytest.raises(NotImplementedError, match="stores no rows"):
        problem_of((1.0, 0.8), "matrix-free").system.matrix()


def dam_break(jacobian, **options):
    """Some steps of a coarse dam break, solved to a tight tolerance."""
    water = tp.Fluid("water", density=998.2, viscosity=1.002e-3)
    air = tp.Fluid("air", density=1.204, viscosity=1.825e-5)
    tank = tp.tank((0.584, 0.584), 0.04).fill(air).fill(water, box=((0, 0), (0.146, 0.292)))
    numerics = tp.Numerics(newton_tolerance=1e-11, newton_iterations=30, jacobian=jacobian)
    simulation = tp.Simulation(tp.Case(tank, [water, air], (0, -9.81), numerics=numerics, **options), time_step=2e-3)
    for _ in range(5):
        simulation.step()
    return simulation


FLOOR, LEFT = ((0, 0), (0.584, 0)), ((0, 0), (0, 0.584))
WALLS = {
    "no-slip": (),
    "free slip": (tp.Wall("floor", between=FLOOR, slip=True), tp.Wall("left", between=LEFT, slip=True)),
    "friction": (tp.Wall("floor", between=FLOOR, slip_length=0.01, velocity=(0.1, 0.0)),),
}


@pytest.mark.parametrize("walls", WALLS)
def test_a_dam_break_is_the_same_with_both(walls):
    """To the tolerance of Newton's method, with about as many iterations of Krylov's."""
    rows, free = (dam_break(jacobian, walls=WALLS[walls]) for jacobian in ("rows", "matrix-free"))
    assert rows.case.numerics.jacobian == "rows"
    assert free.time == rows.time
    assert abs(rows.particles.velocity).max() > 0.02
    spacing, pressure = 0.04, abs(rows.particles.pressure).max()
    np.testing.assert_allclose(free.particles.position, rows.particles.position, atol=1e-8 * spacing)
    np.testing.assert_allclose(free.particles.pressure, rows.particles.pressure, atol=1e-6 * pressure)
    counts = [sum(row["krylov_iterations"] for row in s.history) for s in (rows, free)]
    assert counts[1] == pytest.approx(counts[0], rel=0.1)


@pytest.mark.parametrize("value", ["matrix", None, True])
def test_other_jacobians_are_refused(value):
    with pytest.raises(ValueError, match=r"Numerics: jacobian is .*; it must be one of 'rows', 'matrix-free'"):
        tp.Numerics(jacobian=value)


def test_a_body_that_floats_is_refused(water):
    tank = (
        tp.tank((1.0, 1.0), 0.1).fill(water).add(tp.Body([(0.4, 0.4), (0.6, 0.4), (0.6, 0.6), (0.4, 0.6)], density=1.0))
    )
    with pytest.raises(ValueError, match=r"no body can float; say jacobian='rows'"):
        tp.Case(tank, [water], (0, -9.81), numerics=tp.Numerics(jacobian="matrix-free"))
