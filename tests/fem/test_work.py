"""The works of a step's forces: against NumPy, and a linear velocity field in closed form."""

from __future__ import annotations

import numpy as np
import numpy_twin as twin
import pytest
from mesh_twins import nodal_mass
from test_element_residual import DIMENSIONS, HEAVY, LIGHT, SCHEMES, THICK, Setting

import tipfem as tp
from tipfem.backend import launch as launches
from tipfem.backend.arrays import partials
from tipfem.backend.launch import launch
from tipfem.fem import step_limits
from tipfem.fem import work as work_kernels
from tipfem.mesh.delaunay import triangulate
from tipfem.physics.state import lumped


def works_in_numpy(step, u, p):
    """What `step_work` sums up, from the residual's terms in NumPy; the force and the work of all particles' rows."""
    cells, dt = step.cells, step.alpha.dt
    big_g, area = twin.reference_gradients(step.position, cells)
    v_alpha = step.alpha.intermediate(u, step.velocity, step.acceleration)[0]
    x_alpha, x_next = step.position + (1 - step.alpha.f) * u, step.position + u
    f = np.einsum("mai,maj->mij", x_alpha[cells], big_g)
    j_next = np.linalg.det(np.einsum("mai,maj->mij", x_next[cells], big_g))
    g = np.einsum("mji,maj->mai", np.linalg.inv(f), big_g)
    w = area * np.linalg.det(f)
    l, big_l = (np.einsum("mai,maj->mij", field[cells], g) for field in (v_alpha, u))
    d = (l + np.swapaxes(l, 1, 2)) / 2
    mean_p = p[cells].mean(axis=1)
    stabilisation = twin.parts(step, u, p)[3]
    rows, _ = twin.residual(step, u, p)
    of_walls = step.wall[:, None] * rows[:, :-1]
    return [
        dt * (2 * step.viscosity * w * (d * d).sum(axis=(1, 2))).sum(),
        (2 * step.viscosity * w * (d * big_l).sum(axis=(1, 2))).sum(),
        (mean_p * (w * np.trace(big_l, axis1=1, axis2=2) - area * (j_next - 1))).sum(),
        (p[cells] * stabilisation).sum(),
        (area * mean_p * step.source).sum(),
        (of_walls * u).sum(),
        of_walls.sum(axis=0),
    ]


@DIMENSIONS
@SCHEMES
@pytest.mark.parametrize("fluids", [[HEAVY, LIGHT], [THICK]], ids=["two fluids", "one fluid"])
def test_works_equal_those_in_numpy(dimension, rho_inf, fluids):
    """Every sum, on a random state; the walls move too, for their work would be zero otherwise."""
    setting = Setting(dimension, fluids, walls=True)
    u, p, v, a = setting.random_state(amplitude=0.05)
    setting.source = np.random.default_rng(4).uniform(-0.1, 0.1, len(setting.mesh.cells))
    u[setting.particles.wall] = np.random.default_rng(5).uniform(-0.002, 0.002, u[setting.particles.wall].shape)
    problem, step = setting.pose(rho_inf, 0.01, v, a)
    x = problem.buffers.upload("unknowns", np.concatenate([u, p[:, None]], axis=1).ravel())
    problem.residual(x)
    problem.conclude(x)
    work = problem.work(x, problem.split(x)[0])
    expected = works_in_numpy(step, u, p)
    found = [
        work.viscous_dissipation,
        work.viscous,
        work.geometry,
        work.stabilisation,
        work.source,
        work.walls,
    ]
    # A sum over elements that cancels is as exact as its terms are; those of pressure are of this size.
    size = np.abs(p).max() * setting.mesh.measure.sum() * 1e-2
    np.testing.assert_allclose(found, expected[:-1], rtol=1e-9, atol=1e-11 * size)
    np.testing.assert_allclose(work.wall_force, expected[-1], rtol=1e-9)
    if rho_inf == 1.0 and dimension == 2:
        assert work.geometry == 0  # the mid-point rule is exact for areas


def test_sums_in_as_many_parts_as_on_a_gpu_are_the_same(monkeypatch):
    """They are folded before one thread adds up what is left."""
    setting = Setting(2, [HEAVY, LIGHT], walls=True)
    u, p, v, a = setting.random_state(amplitude=0.05)
    problem, _ = setting.pose(0.5, 0.01, v, a)
    x = problem.buffers.upload("unknowns", np.concatenate([u, p[:, None]], axis=1).ravel())

    def found():
        norm, limits = problem.residual(x), problem.limits(x)
        problem.conclude(x)
        work = problem.work(x, u)
        figures = norm, limits.smallest_jacobian, limits.largest_displacement, *vars(work).values()
        return np.concatenate([np.ravel(figure) for figure in figures])

    few = found()
    monkeypatch.setattr(launches, "PARTS", launches.PARTS_OF_GPU)
    monkeypatch.setattr(launches, "ITERATIONS", 1)
    monkeypatch.setattr(launches, "is_serial", lambda *_: False)
    for kernel in list(launches._kernels):
        monkeypatch.setattr(kernel, "_schedules", {})
    np.testing.assert_allclose(found(), few, rtol=1e-9, atol=1e-11 * abs(few).max())


@DIMENSIONS
@pytest.mark.parametrize("rho_inf", [0.0, 0.8])
def test_viscous_dissipation_of_a_linear_velocity(dimension, rho_inf):
    """v = B x for a step: v_alpha = B x_n, so that l = B (I + cf dt B)^-1 and w sums to the deformed volume."""
    setting = Setting(dimension, [THICK], walls=False)
    b = np.random.default_rng(1).uniform(-1, 1, (dimension, dimension))
    dt = 0.1
    x, zero = setting.mesh.position, np.zeros_like(setting.mesh.position)
    problem, _ = setting.pose(rho_inf, dt, x @ b.T, zero)
    unknowns = problem.vector(dt * x @ b.T, np.zeros(len(x)))
    problem.residual(unknowns)
    problem.conclude(unknowns)
    f = np.eye(dimension) + problem.scheme.cf * dt * b
    l = b @ np.linalg.inv(f)
    d = (l + l.T) / 2
    volume = setting.mesh.measure.sum() * np.linalg.det(f)
    rate = 2 * THICK.viscosity * (d * d).sum() * volume
    assert problem.work(unknowns, problem.split(unknowns)[0]).viscous_dissipation == pytest.approx(dt * rate, rel=1e-11)
    # The work against the stress is over the displacement dt v_n, which is that of v_alpha.
    assert problem.work(unknowns, problem.split(unknowns)[0]).viscous == pytest.approx(dt * rate, rel=1e-11)


@DIMENSIONS
def test_a_rigid_rotation_dissipates_nothing(dimension):
    """Where nothing is strained; a shear of the same speed dissipates."""
    setting = Setting(dimension, [THICK], walls=False)
    spin = np.zeros((dimension, dimension))
    spin[0, 1], spin[1, 0] = -2.0, 2.0
    x = setting.mesh.position
    dissipated = []
    for b in (spin, abs(spin)):
        problem, _ = setting.pose(0.0, 0.1, x @ b.T, np.zeros_like(x))
        # At u = 0 the mesh stands still, and with rho_inf = 0 v_alpha is -v_n / 2: still a rotation, or a shear.
        unknowns = problem.vector(np.zeros_like(x), np.zeros(len(x)))
        problem.residual(unknowns)
        problem.conclude(unknowns)
        dissipated.append(problem.work(unknowns, problem.split(unknowns)[0]).viscous_dissipation)
    assert dissipated[1] > 0.1
    assert abs(dissipated[0]) < 1e-20 * dissipated[1]


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("count", [5, 700])
def test_largest_jumps_of_particles(dimension, count):
    """Against NumPy, with more and with fewer particles than parts of the loop."""
    tp.init()
    rng, dt, full = np.random.default_rng(count), 0.1, 2.0
    mass, target = rng.uniform(0.1, 3.0, (2, count))
    wall, vectors = rng.uniform(size=count) < 0.3, rng.standard_normal((5, count, dimension))
    inertia, force, acceleration, velocity, u = vectors
    given = mass, target, wall.view(np.int8), step_limits.StepFields(*vectors)
    result, work = np.zeros(5), (count, 1e6)
    launch(step_limits.jumps, *given, partials(5), result, full, dt, dimension, work=work)
    weight = np.minimum(1.0, mass / (full * target**dimension))
    change = np.linalg.norm(inertia + force - acceleration, axis=1)
    speed = np.maximum(np.linalg.norm(velocity, axis=1), np.linalg.norm(u, axis=1) / dt)
    largest = [(weight * change)[~wall].max(), (weight * speed).max(), np.linalg.norm(force, axis=1).max()]
    np.testing.assert_allclose(result[:3], largest, rtol=1e-14)
    way = mass * (u**2).sum(axis=1)
    np.testing.assert_allclose(result[3:], [(way * (change / target) ** 2)[~wall].sum(), way.sum()], rtol=1e-12)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("count", [5, 700])
def test_sums_over_particles(dimension, count):
    """Against NumPy, with more and with fewer particles than parts of the loop."""
    tp.init()
    rng, d, work = np.random.default_rng(count), dimension, (count, 1e6)
    mass, wall = rng.uniform(size=count), (rng.uniform(size=count) < 0.3)
    x, v, a, v_old, a_old, relative, force, u = rng.standard_normal((8, count, d))
    sums = np.zeros(1 + 2 * d)
    launch(work_kernels.state_sums, mass, x, v, partials(len(sums)), sums, d, work=work)
    of_state = [mass @ (v * v).sum(axis=1), *(mass @ x), *(mass @ v)]
    np.testing.assert_allclose(sums, of_state, rtol=1e-12, atol=1e-12)
    gravity, sums = rng.standard_normal(d), np.zeros(3 + 4 * d)
    launch(
        work_kernels.step_sums,
        mass,
        work_kernels.Start(wall.view(np.int8), v_old, a_old),
        work_kernels.End(x, v, a, u),
        work_kernels.Loads(relative, force, gravity),
        partials(len(sums)),
        sums,
        0.3,
        0.7,
        d,
        work=(count, 1e-6),
    )
    inertia = relative + force
    change = np.where(wall[:, None], 0.7 * inertia, v - v_old + 0.3 * (a - a_old))
    expected = [mass @ (inertia * u).sum(axis=1), mass @ ((force - gravity) * u).sum(axis=1)]
    expected += [*(mass @ change), *(mass @ force), *of_state]
    np.testing.assert_allclose(sums, expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("dimension", [2, 3])
def test_lumped_masses_are_those_of_numpy(dimension, water):
    tp.init()
    particles = tp.tank((1.0,) * dimension, 0.2, jitter=0.2).fill(water).sample([water])
    mesh = triangulate(particles.position, particles.wall, particles.spacing)
    density = np.random.default_rng(0).uniform(1, 1000, len(mesh.cells))
    np.testing.assert_allclose(lumped(mesh, density), nodal_mass(mesh, density), rtol=1e-14)
