"""The equations of liquids that slide along each other: their terms, their derivative, and runs with them."""

from __future__ import annotations

import numpy as np
import pytest
from flow_problems import flow_problem

import tipfem as tp
from tipfem.backend.arrays import download
from tipfem.case.fluid import ranks
from tipfem.fem.mass import consistent_part
from tipfem.fem.time_integration import GeneralizedAlpha
from tipfem.geometry.period import axisymmetric
from tipfem.mesh.cut import cut_along_interfaces
from tipfem.mesh.delaunay import triangulate
from tipfem.mesh.mesh import Mesh
from tipfem.physics.sliding_liquids.slip import find_slip
from tipfem.physics.term import ElementProperties
from tipfem.remesh.triangles.fitted import with_fluids
from tipfem.remesh.volumes import with_components
from tipfem.step.linear_system import Workspace

FLUIDS = [tp.Fluid("water", density=1000.0, viscosity=0.1), tp.Fluid("oil", density=800.0, viscosity=2.0)]
DENSITY, VISCOSITY = (np.array([getattr(f, name) for f in FLUIDS]) for name in ("density", "viscosity"))
ROUND = "round"
SPACING, DT, RHO_INF, STABILISATION = 0.05, 2e-3, 0.3, 0.3
SCHEME = GeneralizedAlpha(RHO_INF, DT)
GRAVITY = {2: np.array([0.4, -9.81]), 3: np.array([0.4, -0.3, -9.81]), ROUND: np.array([0.0, -9.81])}


def filled(kind):
    """A square or a box with oil over water, a drop of water in the oil, their mesh, and the spacing."""
    dim = 2 if kind == ROUND else kind
    spacing = SPACING if dim == 2 else 0.1
    size, up = (1.0,) * dim, (0.0,) * (dim - 1) + (0.5,)
    options = {"coordinates": "axisymmetric"} if kind == ROUND else {}
    tank = tp.tank(size, spacing, jitter=0.2, seed=4, **options).fill(FLUIDS[0]).fill(FLUIDS[1], box=(up, size))
    centre = np.array((0.3, 0.75) if dim == 2 else (0.4, 0.5, 0.75))
    particles = tank.fill(
        FLUIDS[0], where=lambda x: ((x - centre) ** 2).sum(axis=1) < (0.12 if dim == 2 else 0.17) ** 2
    ).sample(FLUIDS)
    mesh = triangulate(particles.position, particles.wall, spacing)
    if kind == ROUND:
        mesh = Mesh(mesh.position, mesh.cells, period=axisymmetric())
    if dim == 2:
        return particles, with_fluids(mesh, particles, ranks(FLUIDS)), spacing
    lightest = np.argsort(ranks(FLUIDS))[ranks(FLUIDS)[particles.fluid[mesh.cells]].min(axis=1)]
    return particles, with_components(Mesh(mesh.position, mesh.cells, lightest.astype(np.int32)), 2), spacing


class Setting:
    """Oil over water in motion, a drop of water in the oil, the interface rough; unknowns at random."""

    def __init__(self, jacobian="rows", lumping=1.0, kind=2):
        self.particles, self.mesh, spacing = filled(kind)
        particles, self.gravity, dim = self.particles, GRAVITY[kind], self.mesh.dimension
        rng, n = np.random.default_rng(7), len(particles)
        self.moves = moves = ~particles.wall[:, None]
        particles.velocity[:] = rng.uniform(-0.25, 0.25, (n, dim)) * moves
        particles.acceleration[:] = rng.uniform(-10, 10, (n, dim)) * moves
        self.slip = find_slip(self.mesh, particles, DENSITY, self.gravity)
        self.cut = cut_along_interfaces(self.mesh, DENSITY[self.mesh.fluid])
        self.lumping, self.force = lumping, rng.uniform(-1, 1, (n, dim)) + self.gravity
        self.with_slip, self.without = self.problem(self.slip, jacobian), self.problem(None, jacobian)
        self.x = rng.uniform(-0.1, 0.1, (n, dim)) * moves * spacing, rng.uniform(-500, 500, len(self.cut.owner))

    def problem(self, slip, jacobian):
        n, nothing = len(self.particles), np.zeros(len(self.mesh.cells))
        return flow_problem(
            self.mesh,
            self.particles,
            ElementProperties(DENSITY[self.mesh.fluid], VISCOSITY[self.mesh.fluid], nothing, nothing + self.lumping),
            SCHEME,
            self.force,
            STABILISATION,
            Workspace(),
            jacobian=jacobian,
            pressure_jump=np.zeros((2, n)),
            slip=slip,
        )

    def vector(self, problem, u, p):
        return problem.buffers.upload("test.x", np.column_stack([u[self.cut.owner], p]).ravel())

    def rows(self, problem, u, p):
        """The residual without the scale of its rows (P, d + 1)."""
        problem.residual(self.vector(problem, u, p))
        return self.unscaled(problem, problem._r)

    def unscaled(self, problem, rows):
        """Rows (P, d + 1) on the device without their scale, 0 where that is."""
        shape = (len(self.cut.owner), -1)
        rows, scale = (download(array, problem.size).reshape(shape) for array in (rows, problem.equations.scale))
        return np.divide(rows, scale, out=np.zeros_like(rows), where=scale > 0)

    def added(self, u, p):
        """What slip adds to it."""
        return self.rows(self.with_slip, u, p) - self.rows(self.without, u, p)

    @property
    def free(self):
        """Whether rows (P, d + 1) are those of unknowns that are not prescribed."""
        return download(self.with_slip.equations.scale, self.with_slip.size).reshape(len(self.cut.owner), -1) > 0


def wanted(setting, u, p):
    """The terms of sliding liquids, particle by particle and cell by cell; unscaled rows (P, d + 1)."""
    slip, mesh, cut, particles = setting.slip, setting.mesh, setting.cut, setting.particles
    history = SCHEME.history(particles.velocity, particles.acceleration)[1]
    acceleration = SCHEME.cm * u + history
    place = (particles.position + SCHEME.cf * SCHEME.predict(particles.velocity, particles.acceleration))[cut.owner]
    slid, slips, dim = slip.slip(u), slip.slip(acceleration), mesh.dimension
    factor, rows, n = STABILISATION, np.zeros((len(cut.owner), dim + 1)), dim + 1
    shares = mesh.parts_of(np.ones(len(mesh.cells)))
    inertia, virtual = np.zeros(len(slip.owner)), np.zeros((len(mesh.position), dim))
    for e, number in zip(slip.cell, slip.corner, strict=True):
        nodes, volume, rho, part_of = cut.mesh.cells[e], mesh.measure[e], DENSITY[mesh.fluid[e]], shares[e]
        plane = volume / (2 * np.pi * mesh.position[mesh.cells[e], 0].mean()) if mesh.period.axial else volume
        last = np.linalg.inv(place[nodes[1:]] - place[nodes[0]]).T
        gradients = np.vstack([-last.sum(axis=0), last])
        length2 = 4 / np.pi * plane if dim == 2 else (6 / np.pi * volume) ** (2 / 3)
        tau = DT / np.hypot(1 / (factor * DT), 12 * VISCOSITY[mesh.fluid[e]] / (rho * length2))
        tied = (acceleration - setting.force)[cut.owner[nodes]]
        own = np.array([sum((slips[c] * slip.tangent[c] for c in at if c >= 0), np.zeros(dim)) for at in number])
        for a, c in [(a, c) for a, at in enumerate(number) for c in at if c >= 0]:
            t, part = slip.tangent[c], setting.lumping
            mean, own_volume = part_of @ (tied + own), volume * part_of[a]
            acting = part * (tied + own)[a] + (1 - part) * mean
            inertia[c] += own_volume * (rho * t @ acting + t @ gradients.T @ p[nodes])
            for b in range(n):
                share = part * (a == b) + (1 - part) * part_of[b]
                virtual[cut.owner[nodes[b]]] += rho * own_volume * share * slips[c] * t
                moved = SCHEME.cf * rho * own_volume * t @ gradients[b] * slid[c]
                virtual[cut.owner[nodes[b]]] -= moved * setting.force[cut.owner[nodes[b]]]
                rows[nodes[b], dim] += own_volume * t @ gradients[b] * (tau * slips[c] - slid[c])
    for c, force in enumerate(inertia):
        virtual[slip.owner[c]] -= slip.part[c] * force * slip.tangent[c]
        for s in range(slip.offsets[c], slip.offsets[c + 1]):
            virtual[slip.beside[s]] += slip.part[c] * slip.weight[s] * force * slip.tangent[c]
    rows[: len(virtual), :dim] = virtual
    return rows


@pytest.mark.parametrize("kind", [2, 3, ROUND])
@pytest.mark.parametrize("consistent", [False, True])
def test_rows_are_those_of_the_weak_form(kind, consistent):
    setting = Setting(lumping=consistent_part(3 if kind == 3 else 2) if consistent else 1.0, kind=kind)
    assert len(setting.slip.owner) > 15
    assert setting.slip.part.min() < 1
    found, expected = setting.added(*setting.x), setting.free * wanted(setting, *setting.x)
    size = abs(setting.rows(setting.without, *setting.x)).max(axis=0)
    assert (abs(expected).max(axis=0) > 1e-3 * size).all()
    assert (abs(found - expected) <= 1e-10 * size).all()


@pytest.mark.parametrize(
    ("kind", "jacobian"), [(2, "rows"), (2, "matrix-free"), (3, "rows"), (3, "matrix-free"), (ROUND, "rows")]
)
def test_products_are_their_derivative(kind, jacobian):
    """Slip adds a linear function of the unknowns, so differences are exact."""
    setting, rng = Setting(jacobian, kind=kind), np.random.default_rng(2)
    du = rng.standard_normal(setting.x[0].shape) * setting.moves * SPACING
    dp = rng.standard_normal(len(setting.x[1])) * 500
    u, p = setting.x
    expected = setting.added(u + du, p + dp) - setting.added(u, p)
    found = []
    for problem in (setting.with_slip, setting.without):
        setting.rows(problem, u, p)
        problem.linearise()
        out = problem.buffers.get("test.out", problem.size)
        problem.product(setting.vector(problem, du, dp), out)
        found.append(setting.unscaled(problem, out))
    assert (abs(expected).max(axis=0) > 0).all()
    assert (abs(found[0] - found[1] - expected) <= 1e-9 * abs(found[1]).max(axis=0)).all()


@pytest.mark.parametrize("kind", [2, 3, ROUND])
def test_a_pressure_in_balance_with_gravity_drives_no_slip_and_volumes_stay(kind):
    """On a rough interface, with any level of pressure in each component."""
    setting = Setting(kind=kind)
    dim = setting.mesh.dimension
    place = setting.particles.position + SCHEME.cf * SCHEME.predict(
        setting.particles.velocity, setting.particles.acceleration
    )
    setting.particles.velocity[:] = setting.particles.acceleration[:] = 0.0
    setting.force[:] = setting.gravity
    setting.with_slip, setting.without = setting.problem(setting.slip, "rows"), setting.problem(None, "rows")
    place, cut = setting.particles.position[setting.cut.owner], setting.cut
    density = DENSITY[cut.fluids[cut.component]]
    p = density * (place @ setting.gravity) + np.array([300.0, -70.0, 20.0])[cut.component]
    still = np.zeros_like(setting.x[0])
    size = abs(setting.rows(setting.without, still, np.zeros(len(p)))[:, :dim]).max()
    assert abs(setting.added(still, p)).max() < 1e-12 * size
    growth = setting.added(setting.x[0], p)[:, dim]
    assert abs(growth).max() > 0
    sums = np.bincount(cut.component, growth)
    assert abs(sums).max() < 1e-13 * abs(growth).sum()


def wave(jacobian="rows", dim=2, **options):
    """A standing wave between liquids after ten steps."""
    tank = tp.tank((0.2, 0.2) if dim == 2 else (0.2, 0.1, 0.2), 0.02, **options)
    lower, upper = tp.Fluid("water", 1000.0, 1e-3), tp.Fluid("oil", 500.0, 5e-4)
    tank.fill(upper).fill(lower, where=lambda x: x[:, -1] < 0.1 + 0.002 * np.cos(np.pi * x[:, 0] / 0.1))
    for wall in ("bottom", "top") if "periodic" in options else tank.sides:
        tank.wall(wall, slip=True)
    numerics, gravity = tp.Numerics(jacobian=jacobian, newton_tolerance=1e-11, newton_iterations=30), (0,) * (dim - 1)
    simulation = tp.Simulation(tp.Case(tank, [lower, upper], (*gravity, -9.81), numerics=numerics), time_step=2e-3)
    for _ in range(10):
        simulation.step()
    return simulation


@pytest.mark.slow(but=("2-options0",))
@pytest.mark.parametrize(("dim", "options"), [(2, {}), (3, {"jitter": 0.1})])
def test_both_systems_solve_alike_and_energy_closes(dim, options):
    runs = [wave(jacobian, dim, **options) for jacobian in ("rows", "matrix-free")]
    first, other = (run.particles for run in runs)
    assert "sliding_liquids" in runs[0].state.parts
    np.testing.assert_allclose(first.velocity, other.velocity, atol=1e-7 * first.max_speed)
    for run in runs:
        rows = run.history
        kinetic = max(row["kinetic_energy"] for row in rows)
        assert max(abs(row["energy_residual"]) for row in rows) < 1e-7 * kinetic
        np.testing.assert_allclose(run.state.volume, run.state.wanted_volume, rtol=1e-13)
        slip = run.state.parts["sliding_liquids"].slip(run.particles.velocity)
        assert np.linalg.norm(slip) > 0.1 * run.particles.max_speed


def test_momentum_along_periodic_sides_stays():
    rows = wave(periodic="x").history
    scale = max(row["kinetic_energy"] for row in rows) ** 0.5 * 30.0**0.5
    momentum = [row["momentum_x"] for row in rows]
    assert np.ptp(momentum) < 1e-9 * scale


@pytest.mark.parametrize("kind", [2, 3, ROUND])
def test_the_scale_of_momentum_rows_is_that_of_their_diagonal(kind):
    """With the liquid that slides, for elements as they are at the start of the step and lumped masses."""
    setting = Setting(kind=kind)
    dim = setting.mesh.dimension
    setting.particles.velocity[:] = setting.particles.acceleration[:] = 0.0
    problem, owner = setting.problem(setting.slip, "rows"), setting.cut.owner
    setting.rows(problem, np.zeros_like(setting.x[0]), np.zeros(len(owner)))
    problem.linearise()
    diagonal = problem.system.matrix().diagonal().reshape(len(owner), -1)[:, :dim]
    # The rows of copies are added to those of their particles.
    sums = np.stack([np.bincount(owner, column) for column in diagonal.T], axis=1)
    np.testing.assert_allclose(sums[setting.moves[:, 0]], 1.0, rtol=1e-12)
