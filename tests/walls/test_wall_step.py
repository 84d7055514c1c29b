"""Walls in one step: residual against NumPy, Jacobian against finite differences, constraints to round-off."""

from __future__ import annotations

import numpy as np
import numpy_twin as twin
import pytest
from flow_problems import flow_problem
from residuals import residual_vector

import tipfem as tp
from tipfem.backend import launch as launching
from tipfem.backend.arrays import download
from tipfem.case.boundary.boundary import Boundary
from tipfem.fem.time_integration import GeneralizedAlpha
from tipfem.mesh.delaunay import triangulate
from tipfem.physics.term import ElementProperties
from tipfem.physics.walls.motion import set_off
from tipfem.physics.walls.step import WallStep
from tipfem.step import solve
from tipfem.step.linear_system import LinearSystem, Workspace

DIMENSIONS = pytest.mark.parametrize("dimension", [2, 3])
SCHEMES = pytest.mark.parametrize("rho_inf", [0.0, 0.5, 1.0])
SIZES = {2: ((1.0, 0.8), 0.1), 3: ((1.0, 1.0, 0.75), 0.25)}
THICK = tp.Fluid("glycerin", density=1261.0, viscosity=1.412)
LENGTH = 0.03


class _Stop(Exception):
    """Ends a step when a test has seen enough."""


class Setting:
    """A tank with a free-slip wall, one with friction, one that slides too and one that is no-slip; meshed."""

    def __init__(self, dimension, *, motion=None, rho_inf=0.0, dt=2e-3, time=0.0):
        size, h = SIZES[dimension]
        along = (0.7, 0.0, 0.0)[:dimension]
        tank = tp.tank(size, h, jitter=0.2, seed=3).fill(THICK)
        tank.wall("left", slip=True).wall("bottom", slip_length=LENGTH)
        tank.wall("top", slip_length=2 * LENGTH, velocity=along)
        particles = tank.sample([THICK])
        self.boundary = Boundary(particles, tank.walls(particles), motion)
        self.particles = set_off(self.boundary, particles, 1e-3)
        self.scheme, self.time = GeneralizedAlpha(rho_inf, dt), time
        if motion is not None:
            self.particles.position = motion.pose(time, 1e-3, dimension).place(particles.position)
        self.mesh = triangulate(self.particles.position, self.particles.wall, h)
        rng = np.random.default_rng(1)
        shape = particles.position.shape
        self.u, self.du = rng.uniform(-1, 1, (2, *shape)) * 0.1 * h
        self.p, self.dp = rng.uniform(-1, 1, (2, shape[0])) * 500
        self.v, self.a = rng.uniform(-1, 1, shape), 10 * rng.uniform(-1, 1, shape)
        index, free = self.boundary.index, self.boundary.free
        if motion is None:
            for values in (self.v, self.a):
                values[index] = np.einsum("wij,wj->wi", free, values[index])
        self.particles.velocity, self.particles.acceleration = self.v, self.a

    def pose(self, walls=True):
        """The problem, with its walls."""
        m = len(self.mesh.cells)
        self.material = ElementProperties(*(np.full(m, value) for value in (THICK.density, THICK.viscosity, 0.0)))
        step = None
        if walls:
            step = WallStep(self.boundary, self.mesh, self.particles, self.material.viscosity, self.scheme, self.time)
        force = np.zeros_like(self.u)
        force[:, 1] = -9.81
        return flow_problem(self.mesh, self.particles, self.material, self.scheme, force, 0.3, Workspace(), step), step


@DIMENSIONS
@SCHEMES
@pytest.mark.parametrize("moving", [False, True])
def test_product_is_the_derivative_of_the_residual(dimension, rho_inf, moving):
    """With projection and friction, on a tank at rest and one that rolls; central differences to 1e-6."""
    motion = tp.Motion(angle=lambda t: 0.5 * np.sin(3 * t), pivot=(0.2,) * dimension) if moving else None
    setting = Setting(dimension, motion=motion, rho_inf=rho_inf, time=0.4 if moving else 0.0)
    problem, walls = setting.pose()
    problem.residual(problem.vector(setting.u, setting.p))
    du = walls.constrain(setting.du) - walls.displacement  # P du
    direction = np.concatenate([du, setting.dp[:, None]], axis=1)
    out = problem.buffers.get("test.product", problem.size)
    problem.linearise()
    problem.product(problem.buffers.upload("test.direction", direction.ravel()), out)
    got = download(out, problem.size).reshape(direction.shape)
    sides = []
    for sign in (1e-5, -1e-5):
        problem.residual(problem.vector(setting.u + sign * setting.du, setting.p + sign * setting.dp))
        sides.append(residual_vector(problem))
    difference = (sides[0] - sides[1]) / 2e-5
    assert (abs(difference - got).max(axis=0) < 1e-6 * abs(got).max(axis=0)).all()
    # Where the walls are, by themselves: they must not hide behind larger rows.
    assert abs(difference - got)[walls.sliding].max() < 1e-6 * abs(got[walls.sliding]).max()
    assert abs(got[walls.sliding, :dimension]).max() > 0


@pytest.mark.parametrize(("pressure", "rolls"), [("two-sided", False), ("continuous", True)])
def test_all_threads_one_thread_and_staged_kernels_and_matrix_free_products_solve_alike(
    pressure, rolls, monkeypatch, water
):
    """With an interface between walls that slip; on a curved wall in a tank at rest, and in a tank that rolls."""
    points = [(-0.5, 0.0), tp.shapes.arc((0, 0)), (0.5, 0.0), (0.5, 0.3), (-0.5, 0.3)]
    bowl = tp.shapes.polygon(points, names=["bowl", "right", "top", "left"])
    air, found = tp.Fluid("air", 1.2, 1.8e-5), []

    motion = tp.Motion(angle=lambda t: 2.0 * t**2)

    def examine(problem, x, **_options):
        assert len(problem.terms[0].walls.sliding) >= 10
        assert len(problem.terms[0].walls.faces.nodes) > 5
        fused = problem.system.iterations is not None
        start = x.to_numpy().copy()
        for single, whole in ((False, True), (True, True), (False, False)) if fused else ((False, False),):
            monkeypatch.setattr(launching, "is_serial", lambda count, cost, single=single: single)
            problem.system.multigrid.fused = whole
            x.from_numpy(start)
            problem._corrected = True
            problem.residual(x)
            result = problem.correct(x, 1e-11)
            assert result.iterations > 10
            found.append(download(x, problem.size))
        raise _Stop

    # The first step ends in the same state for both, to round-off.
    monkeypatch.setattr(LinearSystem, "_is_reducible", lambda _: False)
    for jacobian in ("rows", "matrix-free"):
        tank = tp.tank(shape=bowl, spacing=0.05, jitter=0.1).fill(water).fill(air, box=((-1, -0.2), (1, 1)))
        tank.wall("right" if rolls else "bowl", slip_length=0.02).wall("left", slip=True)
        numerics = tp.Numerics(pressure=pressure, jacobian=jacobian)
        case = tp.Case(tank, [water, air], (0, -9.81), numerics=numerics, tank_motion=motion if rolls else None)
        simulation = tp.Simulation(case, time_step=2e-3)
        simulation.step()
        with monkeypatch.context() as inner:
            inner.setattr(solve, "newton", examine)
            with pytest.raises(_Stop):
                simulation.step()
    all_threads, one, staged, matrix_free = found
    np.testing.assert_array_equal(all_threads, one)
    for solution in found:  # the tank is full, which leaves the level of the pressure open
        solution[2::3] -= solution[2]
    for other in (staged, matrix_free):
        np.testing.assert_allclose(all_threads, other, atol=1e-9 * abs(staged).max())


@DIMENSIONS
@SCHEMES
def test_residual_equals_the_numpy_twin(dimension, rho_inf):
    """Free rows + lumped friction of every wall face, projected; one scale for the rows of a particle."""
    setting = Setting(dimension, rho_inf=rho_inf)
    problem, walls = setting.pose()
    boundary, d, s = setting.boundary, dimension, setting.scheme
    u = walls.constrain(setting.u)
    step = twin.Step(
        setting.mesh.position,
        setting.mesh.cells,
        walls.fixed,
        setting.v,
        setting.a,
        np.tile((0.0, -9.81, 0.0)[:d], (len(u), 1)),
        setting.material.density,
        setting.material.viscosity,
        setting.material.source,
        twin.Alpha(rho_inf, s.dt),
        0.3,
        setting.particles.spacing,
    )
    rows, _ = twin.residual(step, u, setting.p)
    scale = twin.row_scale(step)
    v_alpha, _ = step.alpha.intermediate(u, setting.v, setting.a)
    x_alpha = setting.mesh.position + s.cf * u
    friction = np.zeros(len(u))
    for number, _, members in boundary.members:
        wall = boundary.walls[number]
        if wall.slip_length is None:
            continue
        on_wall = np.isin(setting.mesh.cells, boundary.index[members])
        for cell in np.flatnonzero(on_wall.sum(axis=1) == d):
            face = setting.mesh.cells[cell][on_wall[cell]]
            for x, factor in ((x_alpha, 0.0), (setting.mesh.position, s.cv)):
                edge = x[face[1:]] - x[face[0]]
                measure = np.linalg.norm(edge[0] if d == 2 else 0.5 * np.cross(*edge))
                share = measure / d * THICK.viscosity / wall.slip_length
                if factor:
                    friction[face] += factor * share
                else:
                    rows[face, :d] += share * (v_alpha[face] - wall.sliding(0.0, d))
    slides = walls.sliding
    scale[slides, :d] = (1 / ((1 / scale[slides, :d]).mean(axis=1) + friction[slides]))[:, None]
    expected = scale * rows
    expected[slides, :d] = np.einsum("kij,kj->ki", boundary.free[boundary.slides], expected[slides, :d])
    problem.residual(problem.vector(setting.u, setting.p))
    got = residual_vector(problem)
    np.testing.assert_allclose(got, expected, atol=1e-11 * abs(expected).max())
    assert friction[slides].max() > 0


@DIMENSIONS
def test_fixed_no_slip_walls_change_nothing(dimension):
    """A boundary that prescribes a motion of zero gives the residual of plain walls, bit by bit."""
    setting = Setting(dimension)
    setting.boundary = Boundary(setting.particles.copy(velocity=0 * setting.v), [], tp.Motion(angle=lambda t: 0.0))
    wall = setting.particles.wall
    setting.particles.velocity[wall] = setting.particles.acceleration[wall] = 0.0
    results = []
    for walls in (True, False):
        problem, _ = setting.pose(walls)
        problem.residual(problem.vector(setting.u, setting.p))
        results.append(residual_vector(problem))
    np.testing.assert_array_equal(*results)


@DIMENSIONS
def test_a_step_ends_exactly_on_walls_that_move(dimension):
    """After any solution wall particles are on the lines that the pose gives, and as fast along their normals."""
    motion = tp.Motion(lambda t: np.array([t**2, -0.3 * t, t])[:dimension], lambda t: 0.4 * t, (0.1,) * dimension)
    setting = Setting(dimension, motion=motion, time=0.5, dt=0.01)
    _, walls = setting.pose()
    u = setting.u
    done = walls.finish(setting.particles, u, setting.scheme.advance(setting.particles, u, setting.p))
    pose = motion.pose(0.51, 1e-3, dimension)
    index, b = setting.boundary.index, setting.boundary
    y = pose.origin(done.position[index])
    assert (np.abs(y @ b.side_normal.T - b.offset)[b.on_side] < 1e-14).all()
    slides = b.slides
    assert np.abs(y[slides] - pose.origin(setting.particles.position[index])[slides]).max() > 1e-3
    normal = b.normal[slides, 0] @ pose.rotation.T
    relative = done.velocity - pose.rigid_velocity(done.position)
    assert abs((relative[walls.sliding] * normal).sum(axis=1)).max() < 1e-9
    assert abs(relative[walls.fixed]).max() < 1e-9


def test_what_slides_on_a_turning_wall_feels_coriolis_and_the_centripetal_acceleration():
    """The normal acceleration, against a second difference of the motion of a point that slides at constant speed."""
    motion = tp.Motion(angle=lambda t: 0.7 * t + t**2, pivot=(0.5, 0.4))
    setting = Setting(2, motion=motion, time=0.3)
    _, walls = setting.pose()
    t = 0.3 + setting.scheme.dt
    place = setting.boundary.index[setting.boundary.slides[4]]
    pose = motion.pose(t, 1e-3, 2)
    y = pose.origin(setting.particles.position[[place]])
    normal = setting.boundary.normal[setting.boundary.slides[4], 0]
    tangent, speed, e = np.array([-normal[1], normal[0]]), 0.8, 1e-4

    def path(time):
        return motion.pose(time, 1e-3, 2).place(y + speed * (time - t) * tangent)[0]

    state = setting.particles.copy()
    state.position[place] = path(t)
    state.velocity[place] = (path(t + e) - path(t - e)) / (2 * e)
    acceleration = (path(t + e) - 2 * path(t) + path(t - e)) / e**2
    state = walls.imposed(state)
    got = (state.acceleration[place] - acceleration) @ (pose.rotation @ normal)
    assert abs(got) < 1e-5 * np.linalg.norm(acceleration)


def test_walls_that_keep_their_particles_are_not_found_anew(monkeypatch):
    """Particles that slid along their sides: the same as if all were found anew; not so once two changed places."""
    tank = tp.tank((0.4, 0.3), 0.05).fill(tp.Fluid("water", 1000.0, 0.0))
    for side in ("left", "right", "bottom", "top"):
        tank.wall(side, slip=True)
    case = tp.Case(tank, [tp.Fluid("water", 1000.0, 0.0)], (0, -9.81))
    boundary, moved = case.boundary, case.particles.copy()
    bottom = np.flatnonzero((moved.position[:, 1] == 0) & (moved.position[:, 0] > 0) & (moved.position[:, 0] < 0.4))
    moved.position[bottom, 0] += 0.01
    pose, still = boundary.pose(0.0, 1e-3), np.zeros(len(boundary.offset))
    kept = boundary.reassigned(moved, pose, still)
    assert kept.free is boundary.free
    swapped = moved.copy()
    swapped.position[bottom[:2], 0] = swapped.position[bottom[1::-1], 0]
    assert boundary.reassigned(swapped, pose, still).free is not boundary.free
    monkeypatch.setattr(type(boundary), "_remains", lambda *_: False)
    anew = boundary.reassigned(moved, pose, still)
    for name in (
        "index",
        "on_side",
        "normal",
        "side",
        "inverse",
        "free",
        "slides",
        "sliding",
        "still",
        "stays",
        "tangent",
    ):
        np.testing.assert_array_equal(getattr(kept, name), getattr(anew, name))
    for (one, _), (other, _) in zip(kept.pieces, anew.pieces, strict=True):
        np.testing.assert_array_equal(one, other)
    for one, other in zip(kept.members, anew.members, strict=True):
        np.testing.assert_array_equal(one[2], other[2])
