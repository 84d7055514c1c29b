"""Pressures on both sides of interfaces: the equations on a cut mesh, their solution, and runs with them."""

from __future__ import annotations

import numpy as np
import numpy_twin as twin
import pytest
from flow_problems import flow_problem
from residuals import residual_vector

import tipfem as tp
from tipfem.backend import launch as launching
from tipfem.backend.arrays import download
from tipfem.case.fluid import ranks
from tipfem.fem.mass import consistent_part
from tipfem.fem.schur import SCHUR_SCALE
from tipfem.fem.time_integration import GeneralizedAlpha
from tipfem.mesh.cut import cut_along_interfaces
from tipfem.mesh.delaunay import triangulate
from tipfem.mesh.mesh import simplex_measure
from tipfem.physics.side_pressures.carried import PressureJump
from tipfem.physics.term import ElementProperties
from tipfem.remesh.triangles.fitted import with_fluids
from tipfem.step.linear_system import Workspace

FLUIDS = [
    tp.Fluid("water", density=1000.0, viscosity=0.1),
    tp.Fluid("oil", density=800.0, viscosity=2.0),
    tp.Fluid("air", density=1.2, viscosity=0.01),
]
DENSITY, VISCOSITY = (np.array([getattr(f, name) for f in FLUIDS]) for name in ("density", "viscosity"))
SPACING, DT, RHO_INF, STABILISATION = 0.05, 2e-3, 0.3, 0.3


def sample():
    """Water, oil with a drop of water in it, and air beside both: particles in motion, and their mesh."""
    tank = tp.tank((1.0, 1.0), SPACING, jitter=0.2, seed=4).fill(FLUIDS[0]).fill(FLUIDS[1], box=((0, 0.5), (1, 1)))
    tank = tank.fill(FLUIDS[2], box=((0.6, 0.2), (1, 0.8))).fill(FLUIDS[0], disc=((0.3, 0.75), 0.12))
    particles = tank.sample(FLUIDS)
    rng = np.random.default_rng(7)
    moves = ~particles.wall[:, None]
    particles.velocity[:] = rng.uniform(-1, 1, particles.velocity.shape) * moves
    particles.acceleration[:] = rng.uniform(-10, 10, particles.velocity.shape) * moves
    return particles, with_fluids(triangulate(particles.position, particles.wall, SPACING), particles, ranks(FLUIDS))


class Setting:
    """A problem with three fluids, unknowns at random, and its twin in NumPy."""

    def __init__(self, jacobian="rows", consistent=0.0):
        self.particles, self.mesh = sample()
        rng = np.random.default_rng(5)
        n = len(self.particles)
        density, viscosity = DENSITY[self.mesh.fluid], VISCOSITY[self.mesh.fluid]
        force = np.tile([0.4, -9.81], (n, 1))
        nothing = np.zeros(len(self.mesh.cells))
        jump = rng.uniform(-300, 300, (3, n))
        lumping = 1 - consistent * (1 - consistent_part(2))
        self.problem = flow_problem(
            self.mesh,
            self.particles,
            ElementProperties(density, viscosity, nothing, nothing + lumping),
            GeneralizedAlpha(RHO_INF, DT),
            force,
            STABILISATION,
            Workspace(),
            jacobian=jacobian,
            pressure_jump=jump,
        )
        self.cut = cut = cut_along_interfaces(self.mesh, density)
        owner = cut.owner
        self.step = twin.Step(
            cut.mesh.position,
            cut.mesh.cells,
            self.particles.wall[owner],
            self.particles.velocity[owner],
            self.particles.acceleration[owner],
            force[owner],
            density,
            viscosity,
            nothing,
            twin.Alpha(RHO_INF, DT),
            STABILISATION,
            SPACING,
            consistent,
        )
        self.u = rng.uniform(-0.2, 0.2, (n, 2)) * ~self.particles.wall[:, None] * SPACING
        p = rng.uniform(-500, 500, n)
        self.p = np.concatenate([p, p[owner[n:]] + jump[cut.fluids[cut.component[n:]], owner[n:]]])
        self.x = self.problem.vector(self.u, p)
        self.problem.residual(self.x)
        self.problem.linearise()

    def tied(self, rows):
        """Rows (P, 3) of the cut mesh with the momentum of copies added to that of their particles."""
        result = rows.copy()
        n = self.cut.particles
        result[n:, :2] = 0.0
        np.add.at(result, (self.cut.owner[n:, None], np.arange(2)), rows[n:, :2])
        return result

    @property
    def scale(self):
        """(P, 3) of the rows: in momentum that of all nodes of a particle together."""
        found = twin.row_scale(self.step)
        with np.errstate(divide="ignore"):
            diagonal = np.zeros((self.cut.particles, 2))
            np.add.at(diagonal, self.cut.owner, 1 / found[:, :2])
        found[:, :2] = (1 / diagonal)[self.cut.owner]
        return found


@pytest.fixture(scope="module")
def setting():
    return Setting()


def test_the_residual_is_that_of_the_cut_mesh_with_momentum_summed(setting):
    rows, size = (setting.tied(r) for r in twin.residual(setting.step, setting.u[setting.cut.owner], setting.p))
    found, scale = residual_vector(setting.problem), setting.scale
    assert len(found) == len(setting.cut.owner) > setting.cut.particles + 40
    assert abs(scale * rows).max() > 0.01 * SPACING
    assert (abs(found - scale * rows) <= 1e-10 * (scale * size).max(axis=0)).all()


@pytest.mark.parametrize("jacobian", ["rows", "matrix-free"])
@pytest.mark.parametrize("consistent", [0.0, 1.0])
def test_products_are_its_derivative(jacobian, consistent):
    setting = Setting(jacobian, consistent)
    rng = np.random.default_rng(2)
    du = rng.standard_normal(setting.u.shape) * ~setting.particles.wall[:, None] * SPACING
    dp = rng.standard_normal(len(setting.p)) * 500
    problem, owner = setting.problem, setting.cut.owner
    wanted = twin.jacobian_product(setting.step, setting.u[owner], setting.p, du[owner], dp)
    wanted = setting.scale * setting.tied(wanted)
    v = problem.buffers.upload("test.v", np.column_stack([du[owner], dp]).ravel())
    out = problem.buffers.get("test.out", problem.size)
    problem.product(v, out)
    found = download(out, problem.size).reshape(-1, 3)
    assert (abs(wanted).max(axis=0) > 0).all()
    assert (abs(found - wanted) <= 1e-10 * abs(wanted).max(axis=0)).all()


def test_both_jacobians_have_the_same_preconditioner():
    found = []
    for jacobian in ("rows", "matrix-free"):
        setting = Setting(jacobian)
        problem, n = setting.problem, setting.cut.particles
        values = np.random.default_rng(1).standard_normal((problem.nodes, 3))
        values[n:, :2] = 0.0
        values[setting.particles.wall[setting.cut.owner], :2] = 0.0
        r, z = problem.buffers.upload("test.r", values.ravel()), problem.buffers.get("test.z", problem.size)
        problem.precondition(r, z)
        found.append(download(z, problem.size).reshape(-1, 3))
        assert not found[-1][n:, :2].any()  # copies are no unknowns
    assert (abs(found[0]).max(axis=0) > 0).all()
    assert (abs(found[1] - found[0]) <= 1e-9 * abs(found[0]).max(axis=0)).all()


def test_the_laplacian_has_the_schur_complement_of_tied_particles(setting):
    """B_k . B_l / diag(A) summed over the particles on interfaces, B by differences of the nodes' volumes."""
    cut, found = setting.cut, setting.problem.system.laplacian()
    assert abs(found - found.T).max() < 1e-12 * abs(found).max()
    assert abs(found.sum(axis=1)).max() < 1e-12 * abs(found).max()
    position, cells, nodes = cut.mesh.position, cut.mesh.cells, len(cut.owner)
    alone = twin.laplacian(position, cells, 1 / (SCHUR_SCALE * GeneralizedAlpha(RHO_INF, DT).cm * setting.step.density))
    wanted = np.zeros((nodes, nodes))
    tied = np.flatnonzero(np.bincount(cut.owner) > 1)
    for i in tied[~setting.particles.wall[tied]]:
        around, size = np.isin(cells, np.flatnonzero(cut.owner == i)).any(axis=1), 1e-4 * SPACING
        for k in (0, 1):
            volumes = []
            for sign in (1, -1):
                moved = position.copy()
                moved[cut.owner == i, k] += sign * size
                share = np.repeat(simplex_measure(moved, cells[around]) / 3, 3)
                volumes.append(np.bincount(cells[around].ravel(), share, minlength=nodes))
            slope = (volumes[0] - volumes[1]) / (2 * size)
            wanted += setting.scale[i, k] * np.outer(slope, slope)
    assert len(tied) > 40
    np.testing.assert_allclose((found - alone).toarray(), wanted, atol=1e-6 * abs(wanted).max())


def test_all_threads_one_thread_and_staged_kernels_solve_alike(monkeypatch):
    """Bits do not depend on the number of threads; staged kernels may round sums otherwise."""
    found = []
    for single, fused in ((False, True), (True, True), (False, False)):
        monkeypatch.setattr(launching, "is_serial", lambda count, cost, single=single: single)
        problem = Setting().problem
        problem.system.multigrid.fused = fused
        assert (problem.system.iterations is not None) is fused
        x = problem.predict()
        problem.residual(x)
        result = problem.correct(x, 1e-10)
        assert result.iterations > 10
        found.append([download(x, problem.size), np.array([result.iterations])])
    for all_threads, one, staged in zip(*found, strict=True):
        np.testing.assert_array_equal(all_threads, one)
        np.testing.assert_allclose(all_threads, staged, atol=1e-9 * abs(staged).max())


@pytest.mark.parametrize("disc", [None, "drops", "bubbles"])
def test_iterations_are_few(disc):
    """Of the first system to 1e-6, at most 1.25 times as many as with a continuous pressure."""
    water, air = FLUIDS[0], FLUIDS[2]
    tank = tp.tank((1.0, 1.0), 1 / 60, jitter=0.1, seed=2).fill(water).fill(air, box=((0, 0.6), (1, 1)))
    for k in range(12 if disc else 0):
        y = 0.7 + 0.15 * (k // 6) if disc == "drops" else 0.2 + 0.15 * (k // 6)
        tank = tank.fill(water if disc == "drops" else air, disc=((0.12 + 0.15 * (k % 6), y), 0.04))
    particles = tank.sample([water, air])
    density, viscosity = np.array([water.density, air.density]), np.array([1e-3, 1.8e-5])
    mesh = with_fluids(triangulate(particles.position, particles.wall, 1 / 60), particles, ranks([water, air]))
    nothing, counts = np.zeros(len(mesh.cells)), []
    for jump in (None, np.zeros((2, len(particles)))):
        problem = flow_problem(
            mesh,
            particles,
            ElementProperties(density[mesh.fluid], viscosity[mesh.fluid], nothing),
            GeneralizedAlpha(0.0, 1e-3),
            np.tile([0.0, -9.81], (len(particles), 1)),
            0.25,
            Workspace(),
            pressure_jump=jump,
        )
        x = problem.predict()
        problem.residual(x)
        result = problem.correct(x, 1e-6)
        assert result.converged
        counts.append(result.iterations)
    assert counts[1] <= 1.25 * counts[0]


def simulation_of(tank, fluids, numerics=None, time_step=None, **options):
    """A run with pressures on both sides."""
    numerics = tp.Numerics(pressure="two-sided", **(numerics or {}))
    return tp.Simulation(tp.Case(tank, fluids, (0, -9.81), numerics=numerics, **options), time_step=time_step)


def dam_break(water, air):
    """A coarse tank with a column of water, a drop of water and a bubble of air."""
    tank = tp.tank((0.584, 0.584), 0.03).fill(air).fill(water, box=((0, 0), (0.146, 0.292)))
    return tank.fill(water, disc=((0.4, 0.3), 0.07)).fill(air, disc=((0.075, 0.12), 0.045))


FLOOR, LEFT = ((0, 0), (0.584, 0)), ((0, 0), (0, 0.584))
WALLS = {
    "no-slip": {},
    "free slip": {"walls": (tp.Wall("floor", between=FLOOR, slip=True), tp.Wall("left", between=LEFT, slip=True))},
    "friction": {
        "walls": (tp.Wall("floor", between=FLOOR, slip_length=0.01), tp.Wall("left", between=LEFT, slip=True))
    },
    "moving tank": {
        "tank_motion": tp.Motion(angle=lambda t: 0.3 * np.sin(8 * t) ** 2, pivot=(0.3, 0.0)),
        "walls": (tp.Wall("floor", between=FLOOR, slip=True),),
    },
}


@pytest.mark.parametrize("jacobian", ["rows", "matrix-free"])
@pytest.mark.parametrize("walls", WALLS)
def test_each_component_keeps_its_volume_in_the_solve(walls, jacobian, water, air):
    numerics = {"newton_tolerance": 1e-11, "newton_iterations": 30, "jacobian": jacobian}
    simulation = simulation_of(dam_break(water, air), [water, air], numerics, **WALLS[walls])
    for _ in range(4):
        simulation.step()
    state = simulation.state
    solved = simulation.solve(state, simulation.control.largest)
    label = state.mesh.components.label
    before, after = (np.bincount(label, m) for m in (state.mesh.measure, solved.mesh.measure))
    assert len(before) == 4
    assert abs(solved.displacement).max() > 1e-3 * state.particles.spacing
    assert abs(after / before - 1).max() < 1e-9
    before, after = (of.part(PressureJump).values for of in (state, solved))
    assert np.isfinite(after).all()
    assert np.isfinite(before).all()
    assert abs(after).max() > 0
    # the jump is a first guess that is nearly right
    assert abs(after - before).max() < 0.5 * abs(after).max()


def test_layers_stay_at_rest(water, air, glycerin):
    tank = tp.tank((0.1, 0.15), 0.01, jitter=0.2, seed=1).fill(glycerin).fill(water, box=((0, 0.05), (0.1, 0.1)))
    simulation = simulation_of(tank.fill(air, box=((0, 0.1), (0.1, 0.15))), [glycerin, water, air])
    for _ in range(20):
        simulation.step()
    particles = simulation.particles
    assert particles.max_speed < 1e-9
    y, p = particles.position[:, 1], np.zeros(len(particles))
    for fluid, low, high in ((glycerin, 0, 0.05), (water, 0.05, 0.1), (air, 0.1, 0.15)):
        p += fluid.density * 9.81 * (high - np.clip(y, low, high))
    p -= p[simulation.state.reference]
    np.testing.assert_allclose(particles.pressure, p, atol=1e-9 * np.ptp(p))
    assert abs(simulation.pressure_jump).max() < 1e-9 * np.ptp(p)


def test_a_graded_run_keeps_volumes_and_first_guesses(water, air):
    simulation = simulation_of(
        dam_break(water, air), [water, air], grading=tp.Grading(largest={"air": 0.06}, growth=0.3)
    )
    count = len(simulation.particles)
    for _ in range(12):
        simulation.step()
    state = simulation.state
    assert len(state.particles) != count
    assert simulation.pressure_jump.shape == (2, len(state.particles))
    np.testing.assert_allclose(state.volume, state.wanted_volume, rtol=1e-12)
    solved = simulation.solve(state, simulation.history[-1]["time_step"])
    label = state.mesh.components.label
    before, after = (np.bincount(label, m) for m in (state.mesh.measure, solved.mesh.measure))
    assert abs(after / before - 1).max() < 1e-5  # at the default tolerance
    assert simulation.history[-1]["newton_iterations"] <= 3


def test_auto_is_two_sided_where_interfaces_are_sharp(water, air):
    auto = tp.Numerics(pressure="auto")
    assert tp.Numerics() == auto
    options = {
        "sharp": {"numerics": auto},
        "interpolated": {"interface": "interpolated", "numerics": auto},
        "continuous": {"numerics": tp.Numerics(pressure="continuous")},
        "by default": {},
    }
    for name, given in options.items():
        simulation = tp.Simulation(tp.Case(dam_break(water, air), [water, air], (0, -9.81), **given))
        simulation.step()
        two_sided = name in ("sharp", "by default")
        assert simulation.case.two_sided == two_sided
        assert (simulation.pressure_jump is not None) == two_sided
    tank = tp.tank((1.0, 1.0), 0.1).fill(water)
    assert not tp.Case(tank, [water], (0, -9.81), free_surface=True, numerics=auto).two_sided
    assert not tp.Case(tank, [water], (0, -9.81), numerics=auto).two_sided


def test_other_masses_are_refused():
    with pytest.raises(ValueError, match=r"mass is 'full'; it must be one of 'lumped', 'consistent', 'interfaces'"):
        tp.Numerics(mass="full")


def test_other_pressures_are_refused(water, air):
    with pytest.raises(ValueError, match=r"pressure is 'both'; it must be one of 'auto', 'continuous', 'two-sided'"):
        tp.Numerics(pressure="both")
    tank, numerics = tp.tank((1.0, 1.0), 0.1).fill(water), tp.Numerics(pressure="two-sided")
    for options in ({"interface": "interpolated"}, {"interface": "interpolated", "free_surface": True}):
        with pytest.raises(ValueError, match=r"pressure is 'two-sided'; .*it must be 'auto' or 'continuous'"):
            tp.Case(tank, [water], (0, -9.81), numerics=numerics, **options)
