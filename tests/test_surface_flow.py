"""Flows with a free surface: rest, flight, landing, merging, walls that hold; and what the kernels make of it."""

from __future__ import annotations

import csv

import meshio
import numpy as np
import numpy_twin as twin
import pytest
from flow_problems import flow_problem
from mesh_twins import adjacency
from residuals import residual_vector
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from tipfem.render import Results

import tipfem as tp
from tipfem.backend.arrays import download
from tipfem.fem.schur import SCHUR_SCALE
from tipfem.fem.time_integration import GeneralizedAlpha
from tipfem.mesh.free_surface import SurfaceMesher
from tipfem.mesh.measures import extent
from tipfem.mesh.mesh import volume_gradient
from tipfem.physics.term import ElementProperties
from tipfem.step.linear_system import Workspace
from tipfem.step.problem import FlowProblem

GRAVITY = np.array([0.0, -9.81])
WATER = tp.Fluid("water", density=1000.0, viscosity=1e-3)
OIL = tp.Fluid("oil", density=900.0, viscosity=1e-2)


def with_drops(tank: tp.Tank, place, velocity) -> tp.Particles:
    """Particles of a partly filled tank of water, and single ones above it."""
    p = tank.sample([WATER], empty=True)
    place, velocity = np.asarray(place, float), np.asarray(velocity, float)
    return tp.Particles(
        np.concatenate([p.position, place]),
        np.append(p.fluid, [0] * len(place)),
        np.append(p.wall, [False] * len(place)),
        velocity=np.concatenate([p.velocity, velocity]),
        spacing=p.spacing,
    )


def simulate(particles, steps: int, *, fluids=(WATER,), dt: float = 2e-3, watch=None, **options) -> tp.Simulation:
    """A run of a number of steps; ``watch`` is called after each of them."""
    simulation = tp.Simulation(tp.Case(particles, list(fluids), GRAVITY, free_surface=True, **options), time_step=dt)
    for _ in range(steps):
        simulation.step()
        if watch:
            watch(simulation)
    return simulation


def sound(simulation: tp.Simulation) -> None:
    """Everything finite, no inverted simplex, walls at rest, and all particles within them."""
    p, mesh = simulation.particles, simulation.mesh
    for values in (p.position, p.velocity, p.acceleration, p.pressure):
        assert np.isfinite(values).all()
    assert (mesh.measure > 0).all()
    lower, upper = p.position[p.wall].min(axis=0), p.position[p.wall].max(axis=0)
    free = p.position[~p.wall]
    assert ((free > lower) & (free < upper)).all()
    surface = mesh.surface
    assert surface is not None
    assert not p.pressure[surface.pinned].any()
    np.testing.assert_array_equal(np.diff(mesh.incidence[0]) > 0, surface.used)
    # A particle that is relocated to a cell without fluid, which is spray at once, carries none.
    assert (surface.volume[surface.loose] >= 0).all()
    assert (surface.volume[surface.loose] == 0).sum() <= 1
    assert all(np.isfinite(value) for value in simulation.history[-1].values())


def bodies(simulation: tp.Simulation) -> int:
    """Number of connected bodies of fluid, single particles not counted."""
    offsets, columns = adjacency(simulation.mesh)
    n = len(simulation.particles)
    graph = sparse.csr_matrix((np.ones(len(columns)), columns, offsets), shape=(n, n))
    body = connected_components(graph, directed=False)[1]
    return len(np.unique(body[np.diff(offsets) > 0]))


@pytest.mark.slow
@pytest.mark.parametrize("slip", [False, True])
def test_water_at_rest_stays_at_rest(slip):
    """500 steps: the pressure of the lattice's surface is that of depth, to 1e-9 of the largest."""
    tank = tp.tank((1.0, 1.0), 0.1).fill(WATER, box=((0, 0), (1, 0.6)))
    for side in ("left", "right", "bottom") if slip else ():
        tank.wall(side, slip=True)
    simulation = simulate(tank, 500)
    p, used = simulation.particles, simulation.mesh.surface.used
    exact = WATER.density * 9.81 * (0.6 - p.position[used, 1])
    assert np.abs(p.pressure[used] - exact).max() < 1e-9 * exact.max()
    assert p.max_speed < 1e-9
    assert simulation.volume("water") == pytest.approx(0.6, rel=1e-9)
    sound(simulation)


@pytest.mark.slow
def test_a_particle_alone_flies_on_a_parabola_and_lands():
    """To round-off, through steps of changing length; then it is a part of the pool."""
    place, velocity = np.array([[0.5, 0.7], [0.54, 0.7], [0.3, 0.9]]), np.array([[0.4, 0.5], [0.4, 0.5], [-0.2, 0.0]])
    p = with_drops(tp.tank((1.0, 1.0), 0.04).fill(WATER, box=((0, 0), (1, 0.2))), place, velocity)
    simulation = tp.Simulation(tp.Case(p, [WATER], GRAVITY, free_surface=True), time_step=4e-3)
    assert simulation.mesh.surface.loose[-3:].all()
    assert simulation.volume("water") == pytest.approx(0.2 + 3 * 0.04**2, rel=1e-12)
    while simulation.time < 0.25:
        simulation.step(0.25)
    t = simulation.time
    np.testing.assert_allclose(
        simulation.particles.position[-3:], place + velocity * t + 0.5 * t**2 * GRAVITY, atol=1e-13
    )
    np.testing.assert_allclose(simulation.particles.velocity[-3:], velocity + t * GRAVITY, atol=1e-12)
    while simulation.time < 0.7:
        simulation.step()
        sound(simulation)
    assert not simulation.mesh.surface.loose.all()
    assert (simulation.particles.position[-3:, 1] < 0.3).all()
    # Newton's tolerance, in the step in which two of them land.
    assert max(abs(row["energy_residual"]) for row in simulation.history) < 1e-3 * simulation.energy().potential


def test_particles_that_all_fly_need_no_simplices():
    """Nothing to solve: no error, and exact energies."""
    tank = tp.tank((1.0, 1.0), 0.1).fill(WATER, box=((0, 0), (1, 0.2)))
    p = with_drops(tank, [[0.3, 0.8], [0.7, 0.9]], np.zeros((2, 2)))
    keep = p.wall | (p.position[:, 1] > 0.5)
    alone = tp.Particles(p.position[keep], np.where(p.wall, -1, 0)[keep], p.wall[keep], spacing=0.1)
    simulation = simulate(alone, 20, watch=sound)
    assert len(simulation.mesh.cells) == 0
    assert simulation.volume("water") == pytest.approx(0.02)
    potential = WATER.density * 0.01 * 9.81 * 1.7
    assert sum(simulation.energy()) == pytest.approx(potential, rel=1e-12)
    assert extent(simulation.mesh, simulation.particles.fluid, 0, 0) != extent(simulation.mesh, alone.fluid, 0, 0)


def test_results_of_particles_that_all_fly_can_be_read(tmp_path):
    """The mesh has no cell; the particles are written as vertices."""
    p = tp.tank((1.0, 1.0), 0.1).fill(WATER, box=((0, 0), (1, 0.2))).sample([WATER], empty=True)
    x = np.concatenate([p.position[p.wall], [[0.5, 0.5]]])
    wall = np.arange(len(x)) < len(x) - 1
    alone = tp.Particles(x, np.where(wall, -1, 0), wall, spacing=0.1)
    case = tp.Case(alone, [WATER], (0, -9.81), free_surface=True)
    simulation = tp.Simulation(case, time_step=1e-3, out=tmp_path)
    simulation.run(2e-3)
    assert len(simulation.mesh.cells) == 0
    scene = Results(tmp_path).scene(-1)
    assert scene.cells.shape == (0, 3)
    np.testing.assert_allclose(scene.position, simulation.particles.position)


@pytest.mark.slow
def test_a_drop_merges_with_a_pool():
    """Two bodies become one, within 4 % of their volume at this coarse resolution; nothing leaks."""
    tank = tp.tank((1.0, 0.8), 0.05).fill(WATER, box=((0, 0), (1, 0.3))).fill(WATER, disc=((0.5, 0.52), 0.12))
    simulation = simulate(tank, 1)
    start = simulation.volume("water")
    assert start == pytest.approx(0.3 + np.pi * 0.12**2, rel=0.01)
    assert bodies(simulation) == 2
    counts = []
    for _ in range(300):
        simulation.step()
        sound(simulation)
        counts.append(bodies(simulation))
        assert simulation.volume("water") == pytest.approx(start, rel=0.04)
    assert max(counts[:50]) == 2
    assert counts[120] == 1


@pytest.mark.slow
@pytest.mark.parametrize("slip", [False, True])
def test_walls_hold_a_drop_that_falls_on_the_floor(slip):
    """A block dropped into a dry tank splashes on all walls; 400 steps later all of it is inside."""
    tank = tp.tank((0.5, 0.5), 0.025).fill(WATER, box=((0.15, 0.2), (0.3, 0.4)))
    for side in ("left", "right", "bottom", "top") if slip else ():
        tank.wall(side, slip=True)
    seen = []
    simulation = simulate(tank, 400, watch=lambda s: (sound(s), seen.append(s.volume("water") / 0.03 - 1)))
    assert np.abs(seen).max() < 0.15  # 63 particles, half of them at the surface
    assert sum(row["relocated"] for row in simulation.history) > 0
    kinetic, potential = simulation.energy()
    assert kinetic + potential < WATER.density * 0.03 * 9.81 * 0.3


def test_two_fluids_with_a_surface_keep_their_volumes():
    tank = tp.tank((0.6, 0.4), 0.02).fill(WATER, box=((0, 0), (0.15, 0.15))).fill(OIL, box=((0, 0.15), (0.15, 0.3)))
    simulation = simulate(tank, 100, fluids=[WATER, OIL], watch=sound, interface="interpolated")
    for name in ("water", "oil"):
        assert simulation.volume(name) == pytest.approx(0.15**2, rel=0.06)


@pytest.mark.slow
def test_a_tank_that_sways_takes_its_dry_walls_along():
    """Walls that slip: wet particles slide, dry ones go with the tank."""
    tank = tp.tank((1.0, 0.8), 0.1).fill(WATER, box=((0, 0), (1, 0.4)))
    for side in ("left", "right", "bottom"):
        tank.wall(side, slip=True)
    motion = tp.Motion(translation=lambda t: (0.02 * (1 - np.cos(4 * t)), 0.0))
    simulation = simulate(tank, 100, dt=5e-3, tank_motion=motion)
    p = simulation.particles
    left = 0.02 * (1 - np.cos(4 * simulation.time))
    assert p.position[p.wall, 0].min() == pytest.approx(left, abs=1e-9)
    assert p.position[p.wall, 0].max() == pytest.approx(1 + left, abs=1e-9)
    dry = simulation.mesh.surface.dry(p.wall)
    assert dry.sum() > 5
    sway = [0.08 * np.sin(4 * simulation.time), 0.0]
    np.testing.assert_allclose(p.velocity[dry], np.tile(sway, (dry.sum(), 1)), atol=1e-6)
    assert np.ptp(p.position[(np.abs(p.position[:, 0] - left) < 1e-9) & ~dry, 1]) > 0.3
    assert simulation.volume("water") == pytest.approx(0.4, rel=1e-3)


@pytest.mark.slow
def test_a_wall_may_push_water_that_can_rise():
    """A piston that moves as fast as a wave sends a step along the tank, by linear theory of height v sqrt(H / g)."""
    tank = tp.tank((1.2, 0.4), 0.05).fill(WATER, box=((0, 0), (1.2, 0.2)))
    for side in ("bottom", "right"):
        tank.wall(side, slip=True)
    tank.wall("left", slip=True, motion=lambda t: 0.1 * t**2 if t < 0.5 else 0.025 + 0.1 * (t - 0.5))
    simulation = simulate(tank, 160, dt=5e-3)
    p = simulation.particles
    top = simulation.mesh.surface.front & (p.position[:, 0] < 0.25)
    assert p.position[top, 1].mean() == pytest.approx(0.2 + 0.1 * np.sqrt(0.2 / 9.81), rel=0.03)
    assert p.position[p.wall, 0].min() == pytest.approx(0.055)
    assert simulation.volume("water") == pytest.approx(0.24, rel=2e-3)


def test_a_tank_that_is_full_has_no_surface():
    """Pressure is known up to a constant again, zero at the top."""
    simulation = simulate(tp.tank((0.6, 0.6), 0.1).fill(WATER), 10, watch=sound)
    p = simulation.particles
    assert not simulation.mesh.surface.pinned.any()
    np.testing.assert_allclose(p.pressure, 9810 * (0.6 - p.position[:, 1]), atol=1e-5)


def problem_with_surface(dt: float = 2e-3) -> tuple[FlowProblem, twin.Step, tp.Particles]:
    """A jittered pool with two particles above it, on the device and in NumPy."""
    p = with_drops(
        tp.tank((1.0, 0.9), 0.1, jitter=0.1).fill(WATER, box=((0, 0), (1, 0.5))),
        [[0.3, 0.75], [0.6, 0.75]],
        [[1.0, 0.0], [0.0, -1.0]],
    )
    rng = np.random.default_rng(4)
    p.velocity[~p.wall] = rng.uniform(-0.2, 0.2, (int((~p.wall).sum()), 2))
    mesh = SurfaceMesher(tp.SurfaceRule()).start(p)
    m, force = len(mesh.cells), np.tile(GRAVITY, (len(p), 1))
    material = ElementProperties(np.full(m, 1000.0), np.full(m, 1e-3), np.zeros(m))
    problem = flow_problem(mesh, p, material, GeneralizedAlpha(0.0, dt), force, 0.25, Workspace())
    step = twin.Step(
        mesh.position,
        mesh.cells,
        p.wall,
        p.velocity,
        p.acceleration,
        force,
        material.density,
        material.viscosity,
        material.source,
        twin.Alpha(0.0, dt),
        0.25,
        p.spacing,
    )
    return problem, step, p


def test_residual_and_laplacian_leave_out_what_is_prescribed():
    """The rows of NumPy's residual; zero where pressure is pinned, and for particles in no simplex."""
    problem, step, p = problem_with_surface()
    surface, rng = problem.mesh.surface, np.random.default_rng(5)
    u, pressure = rng.uniform(-0.01, 0.01, p.position.shape), rng.uniform(-500, 500, len(p))
    x = problem.vector(u, pressure)
    u, pressure = problem.split(x)
    assert not pressure[surface.pinned].any()
    np.testing.assert_allclose(u[-2:], 2e-3 * p.velocity[-2:] + 0.5 * 2e-3**2 * GRAVITY, rtol=1e-14)
    problem.residual(x)
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = twin.row_scale(step)
    scale[~surface.used], scale[surface.pinned, 2] = 0.0, 0.0
    np.testing.assert_allclose(download(problem.equations.scale, problem.size), scale.ravel(), rtol=1e-12)
    expected, size = twin.residual(step, u, pressure)
    assert np.abs(residual_vector(problem) - scale * expected).max() < 1e-12 * np.abs(scale * size).max()
    got, mesh = problem.system.laplacian().toarray(), problem.mesh
    factor = 1e-3 / (SCHUR_SCALE * problem.scheme.cm)
    laplacian = twin.laplacian(mesh.position, mesh.cells, np.full(len(mesh.cells), factor)).toarray()
    laplacian[surface.pinned] = laplacian[:, surface.pinned] = 0.0
    # What the free particles on the surface do to their pressure: springs.
    free = np.flatnonzero(surface.front & ~p.wall)
    gradient = volume_gradient(mesh, surface.front & ~p.wall)[free]
    laplacian[free, free] += (gradient**2 * scale[free, :2]).sum(axis=1) / SCHUR_SCALE
    np.testing.assert_allclose(got, laplacian, atol=1e-12 * np.abs(laplacian).max())


def test_a_correction_solves_the_linearised_step_and_moves_nothing_that_is_prescribed():
    problem, _, p = problem_with_surface()
    surface = problem.mesh.surface
    x = problem.predict()
    before = problem.residual(x)
    old = problem.split(x)
    result = problem.correct(x, 1e-8)
    assert result.converged
    assert result.iterations <= 25
    assert problem.residual(x) < 1e-2 * before
    u, pressure = problem.split(x)
    assert np.isfinite(u).all()
    assert not pressure[surface.pinned].any()
    np.testing.assert_array_equal(u[surface.loose | p.wall], old[0][surface.loose | p.wall])


def test_results_have_the_particles_that_fly(tmp_path):
    """As vertices beside the triangles; and history and summary as ever."""
    p = with_drops(tp.tank((1.0, 1.0), 0.1).fill(WATER, box=((0, 0), (1, 0.3))), [[0.5, 0.8]], [[0.0, 0.0]])
    simulation = tp.Simulation(tp.Case(p, [WATER], GRAVITY, free_surface=True), out=tmp_path, time_step=2e-3)
    simulation.run(0.01, progress=False)
    file = sorted((tmp_path / "fields").glob("*.vtu"))[-1]
    mesh = meshio.read(file)
    blocks = {block.type: block.data for block in mesh.cells}
    assert len(blocks["triangle"]) == len(simulation.mesh.cells)
    assert blocks["vertex"].ravel().tolist() == [len(p) - 1]
    assert (mesh.point_data["fluid"] == 0).all()
    rows = list(csv.DictReader((tmp_path / "history.csv").open()))
    assert float(rows[-1]["volume_water"]) == pytest.approx(0.31, rel=1e-6)
