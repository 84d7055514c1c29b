"""The residual and its derivative, through FlowProblem: against NumPy, finite differences and closed forms."""

from __future__ import annotations

import numpy as np
import numpy_twin as twin
import pytest
from flow_problems import flow_problem
from residuals import residual_vector

import tipfem as tp
from tipfem.backend.arrays import download
from tipfem.fem.mass import consistent_part
from tipfem.fem.time_integration import GeneralizedAlpha
from tipfem.mesh.delaunay import triangulate
from tipfem.mesh.mesh import Mesh
from tipfem.physics.term import ElementProperties
from tipfem.step.linear_system import Workspace

SIZES = {2: ((1.0, 0.8), 0.1), 3: ((1.0, 1.0, 0.75), 0.25)}
# Of random displacements, in spacings. In 3-D a few of the flattest tetrahedra turn over by it; the formulas hold
# there too, but every singular F that is near costs digits.
AMPLITUDE = {2: 0.2, 3: 0.12}
DIMENSIONS = pytest.mark.parametrize("dimension", [2, 3])
SCHEMES = pytest.mark.parametrize("rho_inf", [0.0, 0.5, 1.0])
GRAVITY = np.array([0.4, -9.81, 0.7])

HEAVY = tp.Fluid("water", density=998.2, viscosity=1.002e-3)
LIGHT = tp.Fluid("air", density=1.204, viscosity=1.825e-5)
THICK = tp.Fluid("glycerin", density=1261.0, viscosity=1.412)


class Setting:
    """A mesh and its elements, from which steps, their twins in NumPy and their residuals are made."""

    def __init__(self, dimension, fluids, *, walls):
        size, self.spacing = SIZES[dimension]
        below = np.array([(0.0,) * dimension, size])
        below[1, 1] /= 2
        filled = tp.tank(size, self.spacing, jitter=0.2, seed=3).fill(fluids[0]).fill(fluids[-1], box=below)
        particles = filled.sample(fluids)
        self._take(triangulate(particles.position, particles.wall, self.spacing), particles)
        if not walls:
            self.particles = particles.copy(wall=np.zeros(self.count, dtype=bool))
        fluid = particles.fluid[self.mesh.cells]
        self.density = np.array([f.density for f in fluids])[fluid].mean(axis=1)
        self.viscosity = np.array([f.viscosity for f in fluids])[fluid].mean(axis=1)

    @classmethod
    def of_mesh(cls, mesh, spacing, density, viscosity):
        """On a mesh of one's own, without walls."""
        setting = cls.__new__(cls)
        nothing = np.zeros(len(mesh.position))
        setting.spacing, setting.density, setting.viscosity = spacing, density, viscosity
        setting._take(mesh, tp.Particles(mesh.position, nothing, nothing, spacing=spacing))
        return setting

    def _take(self, mesh, particles):
        self.mesh, self.particles = mesh, particles
        self.dimension, self.count = mesh.dimension, len(particles)
        self.source, self.consistent = np.zeros(len(mesh.cells)), 0.0
        self.gravity = np.tile(GRAVITY[: self.dimension], (self.count, 1))

    @property
    def lumping(self):
        """(M,) part of the mass matrix that is lumped."""
        least = consistent_part(self.dimension)
        return np.full(len(self.mesh.cells), 1 - self.consistent * (1 - least))

    @property
    def free(self):
        """Mask (N,) of the particles inside the tank."""
        size = np.array(SIZES[self.dimension][0])
        at_side = (abs(self.mesh.position) < 1e-12) | (abs(self.mesh.position - size) < 1e-12)
        return ~at_side.any(axis=1)

    def random_state(self, seed=0, amplitude=0.2):
        """u, p, v, a: displacements up to ``amplitude`` spacings; nothing moves on walls."""
        rng = np.random.default_rng(seed)
        shape = self.mesh.position.shape
        moves = ~self.particles.wall[:, None]
        u = rng.uniform(-1, 1, shape) * moves * amplitude * self.spacing
        v = rng.uniform(-1, 1, shape) * moves
        a = rng.uniform(-1, 1, shape) * moves * 10
        return u, rng.uniform(-1, 1, self.count) * 500, v, a

    def pose(self, rho_inf, dt, v, a, body_force=None, stabilisation=0.3):
        """The problem on the device and its twin."""
        force = self.gravity if body_force is None else body_force
        particles = self.particles.copy(velocity=v, acceleration=a)
        problem = flow_problem(
            self.mesh,
            particles,
            ElementProperties(self.density, self.viscosity, self.source, self.lumping),
            GeneralizedAlpha(rho_inf, dt),
            force,
            stabilisation,
            Workspace(),
        )
        step = twin.Step(
            self.mesh.position,
            self.mesh.cells,
            particles.wall,
            v,
            a,
            force,
            self.density,
            self.viscosity,
            self.source,
            twin.Alpha(rho_inf, dt),
            stabilisation,
            self.spacing,
            self.consistent,
        )
        return problem, step


def rows(problem, step, u, p):
    """The residual at (u, p), scale taken off, (N, d + 1); wall momentum rows are 0."""
    problem.residual(problem.vector(u, p))
    scale = twin.row_scale(step)
    return np.divide(residual_vector(problem), scale, out=np.zeros_like(scale), where=scale > 0)


def scaled_product(problem, du, dp):
    """The derivative of the scaled residual along (du, dp), (N, d + 1)."""
    values = np.concatenate([du, dp[:, None]], axis=1)
    out = problem.buffers.get("test.product", problem.size)
    problem.linearise()
    problem.product(problem.buffers.upload("test.direction", values.ravel()), out)
    return download(out, problem.size).reshape(values.shape)


def off(difference, size):
    """Largest difference relative to ``size``, column by column."""
    return (abs(difference).max(axis=0) / abs(size).max(axis=0)).max()


@DIMENSIONS
def test_mesh_fills_the_tank(dimension):
    """The premise of all that follows: element measures from the twin add up to the tank's."""
    setting = Setting(dimension, [LIGHT, HEAVY], walls=True)
    _, area = twin.reference_gradients(setting.mesh.position, setting.mesh.cells)
    assert area.min() > 0
    np.testing.assert_allclose(area.sum(), np.prod(SIZES[dimension][0]), rtol=1e-12)
    assert len(np.unique(setting.density)) > 2


@DIMENSIONS
@SCHEMES
@pytest.mark.parametrize("walls", [True, False])
def test_residual_equals_the_numpy_twin(dimension, rho_inf, walls):
    setting = Setting(dimension, [LIGHT, THICK], walls=walls)
    setting.source = np.random.default_rng(5).uniform(-0.1, 0.1, len(setting.mesh.cells))
    u, p, v, a = setting.random_state(seed=1, amplitude=AMPLITUDE[dimension])
    problem, step = setting.pose(rho_inf, 3e-3, v, a)
    expected, size = twin.residual(step, u, p)
    assert (size > 0).all()
    scale = twin.row_scale(step)
    np.testing.assert_allclose(download(problem.equations.scale, problem.size), scale.ravel(), rtol=1e-12)
    norm = problem.residual(problem.vector(u, p))
    got = residual_vector(problem)
    assert off(got - scale * expected, scale * size) < 1e-12
    np.testing.assert_allclose(norm, abs(scale * expected).max() / setting.spacing, rtol=1e-12)
    assert (got[setting.particles.wall, :-1] == 0).all()


@DIMENSIONS
@pytest.mark.parametrize("consistent", [0.6, 1.0])
def test_residual_with_a_consistent_mass(dimension, consistent):
    """Against NumPy, as above, and its derivative by a complex step; rows sum to those with lumped masses."""
    setting = Setting(dimension, [LIGHT, THICK], walls=True)
    u, p, v, a = setting.random_state(seed=1, amplitude=AMPLITUDE[dimension])
    problem, step = setting.pose(0.5, 3e-3, v, a)
    lumped, _ = twin.residual(step, u, p)
    setting.consistent = consistent
    problem, step = setting.pose(0.5, 3e-3, v, a)
    expected, size = twin.residual(step, u, p)
    assert abs(lumped - expected)[:, :-1].max() > 1e-2 * size[:, :-1].max()
    np.testing.assert_allclose(expected.sum(axis=0), lumped.sum(axis=0), atol=1e-10 * size.sum())
    scale = twin.row_scale(step)
    problem.residual(problem.vector(u, p))
    assert off(residual_vector(problem) - scale * expected, scale * size) < 1e-12
    du, dp, _, _ = setting.random_state(seed=7)
    exact = scale * twin.jacobian_product(step, u, p, du, dp)
    assert off(scaled_product(problem, du, dp) - exact, exact) < 1e-11


@DIMENSIONS
@SCHEMES
@pytest.mark.parametrize(
    ("fluids", "dt"), [([THICK, HEAVY], 1e-2), ([LIGHT, HEAVY], 1e-3)], ids=["glycerin-water", "air-water"]
)
def test_product_is_the_derivative_of_the_residual(dimension, rho_inf, fluids, dt):
    """Central differences to 1e-6, a complex step through the twin to 1e-11; each block by itself."""
    setting = Setting(dimension, fluids, walls=True)
    u, p, v, a = setting.random_state(seed=2, amplitude=AMPLITUDE[dimension])
    problem, step = setting.pose(rho_inf, dt, v, a)
    du, dp, _, _ = setting.random_state(seed=7)
    nothing_u, nothing_p = np.zeros_like(du), np.zeros_like(dp)
    scale = twin.row_scale(step)
    for direction_u, direction_p in [(du, nothing_p), (nothing_u, dp), (du, dp)]:
        problem.residual(problem.vector(u, p))
        got = scaled_product(problem, direction_u, direction_p)
        exact = scale * twin.jacobian_product(step, u, p, direction_u, direction_p)
        assert off(got - exact, exact) < 1e-11
        sides = []
        for sign in (1.0, -1.0):
            problem.residual(problem.vector(u + sign * 1e-5 * direction_u, p + sign * 1e-5 * direction_p))
            sides.append(residual_vector(problem))
        assert off((sides[0] - sides[1]) / 2e-5 - got, got) < 1e-6


@DIMENSIONS
@SCHEMES
def test_translation_gives_no_force(dimension, rho_inf):
    setting = Setting(dimension, [THICK, HEAVY], walls=False)
    dt, velocity = 1e-2, np.array([3.0, -2.0, 1.0])[:dimension]
    v = np.tile(velocity, (setting.count, 1))
    problem, step = setting.pose(rho_inf, dt, v, np.zeros_like(v), body_force=np.zeros_like(v))
    got = rows(problem, step, dt * v, np.zeros(setting.count))
    inertia = setting.density.max() * setting.spacing**dimension * 3.0 / dt
    assert abs(got[:, :-1]).max() < 1e-11 * inertia
    assert abs(got[:, -1]).max() < 1e-12 * setting.spacing**dimension


def rotation(dimension, angle):
    """A rotation by ``angle``, about (1, 2, 2) / 3 in 3-D, and the skew matrix of the axis."""
    if dimension == 2:
        skew = np.array([[0.0, -1.0], [1.0, 0.0]])
    else:
        x, y, z = np.array([1.0, 2.0, 2.0]) / 3
        skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(dimension) + np.sin(angle) * skew + (1 - np.cos(angle)) * skew @ skew, skew


@DIMENSIONS
@SCHEMES
@pytest.mark.parametrize("rigid", [True, False], ids=["rotation", "shear"])
def test_rotation_by_a_finite_angle_gives_no_viscous_force(dimension, rho_inf, rigid):
    """v_alpha = W x_alpha with W skew; a symmetric W of the same size is the counter-proof.

    Displacements are a rotation by 0.3. For rho_inf = 1, v_alpha = u / dt whatever v_n is, and the
    Cayley transform, 2 (R - I) (R + I)^-1 / dt, is skew by itself.
    """
    setting = Setting(dimension, [THICK, HEAVY], walls=False)
    dt, angle = 1e-2, 0.3
    x = setting.mesh.position
    turn, skew = rotation(dimension, angle)
    u = x @ (turn - np.eye(dimension)).T
    alpha = twin.Alpha(rho_inf, dt)
    w = angle / dt * (skew if rigid else abs(skew))
    weight, _ = alpha.intermediate(np.zeros(1), np.ones(1), np.zeros(1))
    if rho_inf < 1:
        # v_alpha = v_alpha(u, 0, 0) + weight v_n; choose v_n so that it is w x_alpha
        v = ((x + (1 - alpha.f) * u) @ w.T - alpha.intermediate(u, 0 * u, 0 * u)[0]) / weight[0]
    else:
        assert abs(weight[0]) < 1e-12
        v = np.zeros_like(u)
        u = u if rigid else x @ (abs(turn) - np.eye(dimension)).T
    _, a_alpha = alpha.intermediate(u, v, np.zeros_like(u))
    problem, step = setting.pose(rho_inf, dt, v, np.zeros_like(u), body_force=a_alpha)
    got = rows(problem, step, u, np.zeros(setting.count))
    force = setting.viscosity.max() * angle / dt * setting.spacing ** (dimension - 1)
    inertia = setting.density.max() * setting.spacing**dimension * abs(a_alpha).max()
    if rigid:
        assert abs(got[:, :-1]).max() < 1e-10 * force + 1e-15 * inertia
        assert abs(got[:, -1]).max() < 1e-13
        np.testing.assert_allclose(problem.limits(problem.vector(u, np.zeros(setting.count))).smallest_jacobian, 1.0)
    else:
        assert abs(got[:, :-1]).max() > 0.1 * force


@DIMENSIONS
@SCHEMES
def test_free_fall_leaves_no_residual(dimension, rho_inf):
    """a = g, p = 0, no walls: momentum and continuity rows vanish, for the stabilisation keeps the inertia."""
    setting = Setting(dimension, [LIGHT, HEAVY], walls=False)
    dt = 5e-3
    v = np.tile([0.5, 1.0, -0.2][:dimension], (setting.count, 1))
    u = dt * v + dt**2 / 2 * setting.gravity
    problem, step = setting.pose(rho_inf, dt, v, setting.gravity)
    got = rows(problem, step, u, np.zeros(setting.count))
    cell = setting.spacing**dimension
    assert abs(got[:, :-1]).max() < 1e-10 * setting.density.max() * cell * 9.81
    assert abs(got[:, -1]).max() < 1e-11 * cell * dt**2 * 9.81 / setting.spacing
    # without the fall there is a residual in both
    still = rows(problem, step, dt * v, np.zeros(setting.count))
    assert abs(still[:, :-1]).max() > 0.1 * setting.density.max() * cell * 9.81
    assert abs(still[:, -1]).max() > 1e-3 * cell * dt**2 * 9.81 / setting.spacing


@DIMENSIONS
def test_one_fluid_at_rest_is_balanced(dimension):
    """p = rho b . x: no momentum residual inside, no continuity residual anywhere, on any mesh."""
    setting = Setting(dimension, [HEAVY], walls=True)
    p = HEAVY.density * setting.mesh.position @ GRAVITY[:dimension]
    still = np.zeros_like(setting.mesh.position)
    problem, step = setting.pose(0.0, 1e-3, still, still)
    got = rows(problem, step, still, p)
    cell = setting.spacing**dimension
    assert abs(got[setting.free, :-1]).max() < 1e-11 * HEAVY.density * cell * 9.81
    assert abs(got[:, -1]).max() < 1e-12 * cell * 1e-6 * 9.81 / setting.spacing
    assert abs(rows(problem, step, still, 1.1 * p)[:, -1]).max() > 1e-3 * cell * 1e-6 * 9.81 / setting.spacing


def layered_mesh(seed=0):
    """A square of 10 x 10 cells whose nodes are shaken, those at half height along it only: an edge chain."""
    n = 11
    x, y = (c.ravel() for c in np.meshgrid(np.arange(n) / 10, np.arange(n) / 10, indexing="ij"))
    number = np.arange(n * n).reshape(n, n)
    low, right, top, corner = number[:-1, :-1], number[1:, :-1], number[:-1, 1:], number[1:, 1:]
    cells = np.concatenate(
        [np.stack([low, right, corner], axis=2).reshape(-1, 3), np.stack([low, corner, top], axis=2).reshape(-1, 3)]
    )
    position = np.stack([x, y], axis=1)
    inside = ((position > 0) & (position < 1)).all(axis=1)
    shift = np.random.default_rng(seed).uniform(-0.02, 0.02, position.shape) * inside[:, None]
    shift[y == 0.5, 1] = 0.0
    return Mesh(position + shift, cells.astype(np.int32))


@SCHEMES
@pytest.mark.parametrize("ratio", [1.0, 50.0], ids=["one fluid", "two layers"])
def test_couette_flow_passes_the_patch_test(rho_inf, ratio):
    """Linear velocity in each layer, equal shear stress t: nothing inside, +-t on the plates; displaced by a step."""
    mesh = layered_mesh()
    middle = mesh.position[mesh.cells].mean(axis=1)[:, 1]
    stress, dt = 2.0, 2e-2
    layer = middle < 0.5
    setting = Setting.of_mesh(mesh, 0.1, np.where(layer, 1000.0, 10.0), np.where(layer, 1.0, 1.0 / ratio))
    y = mesh.position[:, 1]
    speed = stress * np.minimum(y, 0.5) + stress * ratio * np.maximum(y - 0.5, 0.0)
    v = np.stack([speed, np.zeros_like(speed)], axis=1)
    problem, step = setting.pose(rho_inf, dt, v, np.zeros_like(v), body_force=np.zeros_like(v))
    got = rows(problem, step, dt * v, np.zeros(setting.count))
    inside = ((mesh.position > 1e-9) & (mesh.position < 1 - 1e-9)).all(axis=1)
    round_off = 1e-12 * stress + 1e-14 * 1000.0 * 0.01 * speed.max() / dt
    assert abs(got[inside, :-1]).max() < round_off
    assert abs(got[y > 1 - 1e-9, 0].sum() - stress) < 10 * round_off
    assert abs(got[y < 1e-9, 0].sum() + stress) < 10 * round_off
    assert abs(got[:, -1]).max() < 1e-15
    # a profile without equal stress does not pass
    bent = rows(problem, step, dt * v * (1 + 0.1 * (y > 0.5)[:, None]), np.zeros(setting.count))
    assert abs(bent[inside, 0]).max() > 1e-3 * stress


@DIMENSIONS
@SCHEMES
def test_internal_forces_sum_to_zero(dimension, rho_inf):
    """And so do their moments about the origin at the intermediate positions, for sigma is symmetric."""
    setting = Setting(dimension, [LIGHT, THICK], walls=False)
    u, p, v, a = setting.random_state(seed=4, amplitude=AMPLITUDE[dimension])
    alpha = twin.Alpha(rho_inf, 5e-3)
    problem, step = setting.pose(rho_inf, alpha.dt, v, a, body_force=alpha.intermediate(u, v, a)[1])
    force = rows(problem, step, u, p)[:, :-1]
    size = abs(force).sum()
    assert size > 1.0
    assert abs(force.sum(axis=0)).max() < 1e-12 * size
    x_alpha = setting.mesh.position + (1 - alpha.f) * u
    moment = np.einsum("ni,nj->ij", x_alpha, force)
    assert abs(moment - moment.T).max() < 1e-12 * size
    assert abs(moment).max() > 1e-3 * size / setting.count


@DIMENSIONS
def test_continuity_rows_sum_to_the_change_of_volume(dimension):
    setting = Setting(dimension, [LIGHT, HEAVY], walls=False)
    setting.source = np.random.default_rng(8).uniform(-0.1, 0.1, len(setting.mesh.cells))
    u, p, v, a = setting.random_state(seed=5, amplitude=0.15)
    problem, step = setting.pose(0.5, 2e-3, v, a)
    got = rows(problem, step, u, p)[:, -1]
    _, before = twin.reference_gradients(setting.mesh.position, setting.mesh.cells)
    _, after = twin.reference_gradients(setting.mesh.position + u, setting.mesh.cells)
    expected = after.sum() - before.sum() - before @ setting.source
    assert abs(expected) > 1e-4
    np.testing.assert_allclose(got.sum(), expected, atol=1e-12 * before.sum())


@DIMENSIONS
def test_continuity_rows_of_a_closed_tank_sum_to_zero(dimension):
    """Fixed walls, and sources that balance: the system is solvable whatever happens inside."""
    setting = Setting(dimension, [LIGHT, HEAVY], walls=True)
    _, area = twin.reference_gradients(setting.mesh.position, setting.mesh.cells)
    source = np.random.default_rng(9).uniform(-0.1, 0.1, len(area))
    setting.source = source - source @ area / area.sum()
    u, p, v, a = setting.random_state(seed=6)
    problem, step = setting.pose(0.0, 2e-3, v, a)
    got = rows(problem, step, u, p)[:, -1]
    assert abs(got).sum() > 1e-3 * area.sum()
    assert abs(got.sum()) < 1e-13 * area.sum()


@DIMENSIONS
def test_evaluation_is_repeatable_bit_by_bit(dimension):
    setting = Setting(dimension, [LIGHT, HEAVY], walls=True)
    u, p, v, a = setting.random_state(seed=10)
    problem, step = setting.pose(0.0, 1e-3, v, a)
    first = rows(problem, step, u, p)
    product = scaled_product(problem, u, p)
    rows(problem, step, 0.5 * u, p)
    for other in (problem, setting.pose(0.0, 1e-3, v, a)[0]):
        np.testing.assert_array_equal(rows(other, step, u, p), first)
        np.testing.assert_array_equal(scaled_product(other, u, p), product)


@DIMENSIONS
def test_limits_and_unknowns(dimension):
    """split undoes vector, walls held; J_{n+1} and displacements as in the twin; NaN and inf are seen."""
    setting = Setting(dimension, [HEAVY], walls=True)
    u, p, v, a = setting.random_state(seed=11)
    problem, _ = setting.pose(0.0, 1e-3, v, a)
    pushed = u + setting.particles.wall[:, None] * 0.01
    moved, pressure = problem.split(problem.vector(pushed, p))
    np.testing.assert_array_equal(moved, u)
    np.testing.assert_array_equal(pressure, p)
    limits = problem.limits(problem.vector(u, p))
    _, before = twin.reference_gradients(setting.mesh.position, setting.mesh.cells)
    _, after = twin.reference_gradients(setting.mesh.position + u, setting.mesh.cells)
    np.testing.assert_allclose(limits.smallest_jacobian, (after / before).min(), rtol=1e-10)
    expected = (np.linalg.norm(u, axis=1) / setting.particles.target).max()
    np.testing.assert_allclose(limits.largest_displacement, expected, rtol=1e-13)
    assert limits.finite
    for bad in (np.nan, np.inf, -np.inf):
        spoiled = p.copy()
        spoiled[-1] = bad
        assert not problem.limits(problem.vector(u, spoiled)).finite
    assert np.isnan(problem.residual(problem.vector(u, np.where(np.arange(len(p)) == 3, np.nan, p))))
