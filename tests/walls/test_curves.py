"""Walls of tanks with a shape: slip along straight and curved sides, and sides that slide along themselves."""

from __future__ import annotations

import math

import numpy as np
import pytest
from flow_problems import flow_problem
from scipy.special import jn_zeros

import tipfem as tp
from tipfem.backend.arrays import download
from tipfem.fem.time_integration import GeneralizedAlpha
from tipfem.geometry.period import no_period
from tipfem.geometry.plane.curves import SMOOTH, chain_tangents, curve_of, restored, runs_of, spread
from tipfem.geometry.plane.domain import domain_of
from tipfem.physics.term import ElementProperties
from tipfem.physics.walls.step import WallStep
from tipfem.step.linear_system import Workspace

BOWL = tp.shapes.polygon([(-1, 0), tp.shapes.arc((0, 0)), (1, 0), (1, 0.5), (-1, 0.5)], names=["bowl", "r", "t", "l"])
CIRCLE = tp.shapes.circle((0, 0), 1.0, name="rim")
TRAPEZIUM = [(-0.5, 0), (0.5, 0), (1.0, 0.8), (-1.0, 0.8)]


def area_of(position: np.ndarray, pairs: np.ndarray) -> float:
    p, q = position[pairs[:, 0]], position[pairs[:, 1]]
    return 0.5 * float((p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]).sum())


@pytest.mark.parametrize(
    ("shape", "walls", "level"),
    [
        (BOWL, {"bowl": {"slip": True}}, -0.13),
        (BOWL, {"bowl": {"slip": True}, "l": {"slip": True}, "r": {"slip": True}}, 0.15),
        (CIRCLE, {"rim": {"slip": True}}, 0.13),
        (TRAPEZIUM, {"side1": {"slip": True}, "side3": {"slip_length": 0.1}}, 0.4),
        (BOWL, {"bowl": {"slip_length": 0.05}}, -0.13),
    ],
)
def test_fluids_at_rest_over_walls_that_slip_stay_at_rest(shape, walls, level, water, air):
    tank = tp.tank(shape=shape, spacing=0.125).fill(air).fill(water, box=((-2, -2), (2, level)))
    for name, what in walls.items():
        tank.wall(name, **what)
    simulation = tp.Simulation(tp.Case(tank, [water, air], (0, -9.81)))
    assert len(simulation.boundary.slides)
    for _ in range(10):
        simulation.step()
        assert simulation.particles.max_speed < 1e-9
    assert simulation.mesh.measure.sum() == pytest.approx(simulation.case.domain.area, rel=1e-13)


def test_fluids_keep_their_volumes_where_a_particle_of_a_curve_is_removed(water, air):
    """What its triangle had lacked until the next step, whose walls enclose the area of the domain."""
    angle = 2 * np.pi * np.array([*range(10), 9.45, *range(10, 63)]) / 63  # two corners are crowded
    rim = [(math.cos(a), math.sin(a)) for a in sorted(angle.tolist())]
    tank = tp.tank(shape=rim, spacing=0.1).fill(air).fill(water, where=lambda x: x[:, 1] < 0.13 * x[:, 0] + 0.1)
    simulation = tp.Simulation(tp.Case(tank, [water, air], (0, -9.81)))
    rim = int(simulation.particles.wall.sum())
    simulation.step()
    assert int(simulation.particles.wall.sum()) < rim
    start, after = (simulation.state.wanted_volume, simulation.state.volume)
    np.testing.assert_allclose(after, start, rtol=1e-13)


@pytest.mark.parametrize("per_radius", [8, 10, 12.5, 20])
@pytest.mark.parametrize("level", [0.0, -0.31, 0.2, 0.55])
def test_circles_filled_to_a_level_stay_at_rest(per_radius, level, water, air):
    """Particles of the rim are evenly between the two where the level ends."""
    tank = tp.tank(shape=CIRCLE, spacing=1 / per_radius).fill(air).fill(water, box=((-2, -2), (2, level)))
    simulation = tp.Simulation(tp.Case(tank, [water, air], (0, -9.81)), time_step=1e-2)
    x = simulation.particles.position[simulation.particles.wall]
    x = x[np.argsort(np.arctan2(x[:, 1], x[:, 0]))]
    edges = np.hypot(*(np.roll(x, -1, axis=0) - x).T) * per_radius
    assert edges.min() > 0.9
    assert edges.max() < 1.1
    for _ in range(3):
        simulation.step()
    assert simulation.particles.max_speed < 1e-9


def test_flow_along_a_curve_keeps_the_area_and_the_particles_on_it(water):
    """Solid rotation in a circle: every particle keeps its radius, and the fluid its energy."""
    tank = tp.tank(shape=CIRCLE, spacing=0.125).fill(water, velocity=lambda x: np.stack([-x[:, 1], x[:, 0]], axis=1))
    case = tp.Case(tank.wall("rim", slip=True), [water], (0, 0), numerics=tp.Numerics(newton_tolerance=1e-12))
    rim = case.boundary.index
    np.testing.assert_allclose(np.linalg.norm(case.particles.velocity[rim], axis=1), 1.0, rtol=1e-12)
    simulation = tp.Simulation(case, time_step=0.01)
    start = simulation.energy().kinetic
    for _ in range(30):
        simulation.step()
    at = simulation.particles.position[simulation.boundary.index]
    np.testing.assert_allclose(np.linalg.norm(at, axis=1), 1.0, atol=2e-3 * 0.125)
    assert simulation.mesh.measure.sum() == pytest.approx(case.domain.area, rel=1e-13)
    assert simulation.energy().kinetic == pytest.approx(start, rel=5e-3)
    assert abs(simulation.history[-1]["energy_residual"]) < 1e-11 * start
    assert simulation.time == pytest.approx(0.3)  # no step was refused


@pytest.mark.parametrize("wall", [{"slip": True}, {"law": "layer"}], ids=["slip", "layer"])
def test_the_level_of_pressure_is_bounded_in_a_closed_circle(wall, water, air):
    """Where nothing but the sum of the equations of continuity sets it; Newton's method reaches round-off."""
    tank = tp.tank(shape=CIRCLE, spacing=0.2).fill(air).fill(water, where=lambda x: x[:, 1] < 0.3 * x[:, 0])
    case = tp.Case(tank.wall("rim", **wall), [water, air], (0, -9.81), numerics=tp.Numerics(newton_tolerance=1e-13))
    simulation = tp.Simulation(case, time_step=7e-3)
    for _ in range(20):
        simulation.step()
        assert abs(simulation.solved.level) < 998.2 * 9.81 * 0.1
    assert simulation.time == pytest.approx(20 * 7e-3)
    assert simulation.state.volume_error < 1e-12


def test_a_circle_of_the_default_law_slows_rotation_as_its_boundary_layer_does(water):
    """Spin-down: L / L_0 = 8 sum exp(-nu l^2 t / R^2) / l^2 over the zeros l of J_1; no-slip walls take 20 times it."""
    tank = tp.tank(shape=CIRCLE, spacing=0.2).fill(water, velocity=lambda x: np.stack([-x[:, 1], x[:, 0]], axis=1))
    simulation = tp.Simulation(tp.Case(tank, [water], (0, -9.81)), time_step=7e-3)

    def angular_momentum():
        x, v = simulation.particles.position, simulation.particles.velocity
        return float(simulation.state.mass @ (x[:, 0] * v[:, 1] - x[:, 1] * v[:, 0]))

    start = angular_momentum()
    while simulation.time < 0.1 - 1e-9:
        simulation.step(0.1)
    zeros = jn_zeros(1, 20000)
    left = 8 * (np.exp(-water.viscosity / water.density * zeros**2 * 0.1) / zeros**2).sum()
    lost = 8 * (1 / zeros**2).sum() - left
    assert 1 - angular_momentum() / start == pytest.approx(lost, rel=0.15)


@pytest.mark.slow
@pytest.mark.parametrize("interface", ["sharp", "interpolated"])
@pytest.mark.parametrize("wall", [{"slip": True}, {"law": "layer"}], ids=["slip", "layer"])
def test_water_swings_in_a_bowl_under_a_free_surface(wall, interface, water):
    """With the period of P. McIver, J. Fluid Mech. 201, 1989, and hardly a loss."""
    tank = tp.tank(shape=CIRCLE, spacing=0.1).wall("rim", **wall)
    tank.fill(water, where=lambda x: x[:, 1] < 0.02 * x[:, 0])
    case = tp.Case(tank, [water], (0, -9.81), free_surface=True, interface=interface)
    simulation = tp.Simulation(case, columns={"middle": middle_of})
    half = math.pi / math.sqrt(1.35573 * 9.81)
    simulation.run(2.1 * half, progress=False)
    names = "time", "middle", "potential_energy"
    time, middle, potential = (np.array([row[name] for row in simulation.history]) for name in names)
    k = np.flatnonzero(np.sign(middle[1:]) != np.sign(middle[:-1]))
    zeros = time[k] - middle[k] * (time[k + 1] - time[k]) / (middle[k + 1] - middle[k])
    assert zeros[1] - zeros[0] == pytest.approx(half, rel=0.015)
    first, second = (np.abs(part).max() for part in np.split(middle, k + 1)[1:])
    assert min(first, second) > 0.96 * middle[0]
    energy = simulation.history[0]["potential_energy"] - potential.min()
    rows = simulation.history
    assert max(abs(row["remeshing_dissipation"]) for row in rows) < 2e-3 * energy
    assert abs(sum(row["external_work"] for row in rows)) < 1e-12 * energy
    assert simulation.volume("water") == pytest.approx(rows[0]["volume_water"], rel=1e-13)


@pytest.mark.parametrize("free_surface", [True, False], ids=["surface", "air"])
@pytest.mark.parametrize("wall", [{"slip": True}, {"law": "layer"}], ids=["slip", "layer"])
def test_curves_at_rest_do_no_work(wall, free_surface, water, air):
    """What Newton's method leaves along them is in its own column; nothing is lost from the budget."""
    tank = tp.tank(shape=CIRCLE, spacing=0.125).wall("rim", **wall)
    tank = (tank if free_surface else tank.fill(air)).fill(water, where=lambda x: x[:, 1] < 0.1 * x[:, 0])
    simulation = tp.Simulation(
        tp.Case(tank, [water] if free_surface else [water, air], (0, -9.81), free_surface=free_surface)
    )
    for _ in range(20):
        simulation.step()
    kinetic, rows = simulation.energy().kinetic, simulation.history
    assert kinetic > 1.0
    assert max(abs(row["external_work"]) for row in rows) < 1e-13 * kinetic
    assert max(abs(row["energy_residual"]) for row in rows) < 1e-11 * kinetic
    assert any(row["newton_dissipation"] for row in rows)


def test_walls_that_do_the_same_are_one_curve_where_they_meet_without_a_corner(water):
    def curves(interface="sharp", **walls):
        tank = tp.tank(shape=BOWL, spacing=0.125).fill(water)
        for side, what in ({name: {"slip": True} for name in tank.sides} | walls).items():
            tank.wall(side, **what)
        return tp.Case(tank, [water], (0, -9.81), interface=interface).boundary.curves

    arc = len(runs_of(domain_of(BOWL, 0.125), 0)[0])
    assert [len(curve.edges) for curve in curves()] == [arc + 2]
    assert [len(curve.edges) for curve in curves(l={"law": "layer"})] == [arc + 1]
    assert [len(curve.edges) for curve in curves(l={"law": "no-slip"}, r={"slip_length": 0.1})] == [arc]
    assert [len(curve.edges) for curve in curves(interface="interpolated")] == [arc]


@pytest.mark.slow
def test_water_slides_from_an_arc_up_a_straight_wall_into_a_corner(water):
    """A surface that spans the corner is no part of the wall; and the energy of the swing is not lost at the joint."""
    corners = [(-1, 1), (-1, 0), tp.shapes.arc((0, 0)), (1, 0), (1, 1)]
    tank = tp.tank(shape=tp.shapes.polygon(corners, names=["l", "bowl", "r", "t"]), spacing=1 / 15)
    tank.fill(water, where=lambda x: (x[:, 0] < -0.2) & (x[:, 1] < 0.6))
    simulation = tp.Simulation(tp.Case(tank, [water], (0, -9.81), free_surface=True))
    assert len(simulation.boundary.curves) == 1
    start = sum(simulation.energy())
    while simulation.time < 0.6:
        simulation.step()
    top = simulation.particles.position[simulation.mesh.used]
    assert top[top[:, 0] > 0.5, 1].max() > 0.8
    lost = sum(row["remeshing_dissipation"] for row in simulation.history)
    assert lost < 0.04 * (start - simulation.energy().potential)
    assert abs(sum(row["external_work"] for row in simulation.history)) < 1e-12 * lost
    simulation.run(0.7, progress=False)
    assert simulation.volume("water") == pytest.approx(simulation.history[0]["volume_water"], rel=1e-13)


def middle_of(simulation: tp.Simulation) -> float:
    mesh = simulation.mesh
    return float(mesh.position[mesh.cells, 0].mean(axis=1) @ mesh.measure / mesh.measure.sum())


def test_product_is_the_derivative_of_the_residual_on_a_curve(water):
    """With the pressure of the wall and friction; central differences to 1e-6."""
    tank = tp.tank(shape=BOWL, spacing=0.2, jitter=0.1).fill(water)
    tank.wall("bowl", slip_length=0.1, velocity=0.3).wall("l", slip=True)
    simulation = tp.Simulation(tp.Case(tank, [water], (0, -9.81)))
    rng, state = np.random.default_rng(3), simulation.state
    n = len(state.particles)
    u, du = 0.01 * rng.standard_normal((2, n, 2))
    p, dp = 1e3 * rng.standard_normal((2, n))
    scheme, m = GeneralizedAlpha(0.5, 0.01), len(state.mesh.cells)
    material = ElementProperties(*(np.full(m, value) for value in (1000.0, 50.0, 0.0)))
    walls = WallStep(state.boundary, state.mesh, state.particles, material.viscosity, scheme, 0.0, material.density)
    assert len(walls.curves.pressed)
    problem = flow_problem(state.mesh, state.particles, material, scheme, np.zeros((n, 2)), 0.3, Workspace(), walls)
    start = np.concatenate([walls.constrain(u), p[:, None]], axis=1)
    problem.residual(problem.vector(u, p))
    problem.linearise()
    # Corrections on curves keep the area that the boundary encloses at the end of the step.
    along, curves = walls.constrain(du) - walls.displacement, walls.boundary.index[walls.curves.rows]
    along[curves] = np.einsum("kij,kj->ki", walls.curves.projector_at(start[:, :2]), du[curves])
    direction = np.concatenate([along, dp[:, None]], axis=1)
    out = problem.buffers.get("test.product", problem.size)
    problem.product(problem.buffers.upload("test.direction", direction.ravel()), out)
    got = download(out, problem.size).reshape(direction.shape)
    sides = []
    for sign in (1e-5, -1e-5):
        problem.residual(problem.buffers.upload("unknowns", (start + sign * direction).ravel()))
        sides.append(download(problem._r, problem.size).reshape(direction.shape).copy())
    difference = (sides[0] - sides[1]) / 2e-5
    assert abs(difference - got).max() < 1e-6 * abs(got).max()
    assert abs(got[walls.sliding, :2]).max() > 0


def test_particles_slide_at_right_angles_to_the_gradient_of_the_area():
    rng = np.random.default_rng(5)
    angle = np.sort(rng.uniform(0, 2 * np.pi, 20))
    x = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    pairs = np.stack([np.arange(20), np.roll(np.arange(20), -1)], axis=1)
    tangent = chain_tangents(x, pairs, np.arange(20), no_period(2))
    for i in range(20):
        moved = [x.copy(), x.copy()]
        for sign, one in zip((1, -1), moved, strict=True):
            one[i] += sign * 1e-3 * tangent[i]
        assert area_of(moved[0], pairs) == pytest.approx(area_of(moved[1], pairs), abs=1e-15)
    moves = np.arange(20) > 3
    back = restored(x, pairs, moves, 3.0, no_period(2))
    assert area_of(back, pairs) == pytest.approx(3.0, rel=1e-14)
    np.testing.assert_array_equal(back[~moves], x[~moves])


@pytest.mark.parametrize("hole", [False, True])
def test_particles_spread_along_arcs_enclose_the_area_of_the_domain(hole):
    """Whatever their distances are; on their arc they enclose 0.4 % less."""
    rng, outline = np.random.default_rng(7), tp.shapes.circle((0.3, 0.1), 1.0)
    if hole:
        outline = tp.shapes.circle((0.3, 0.1), 2.0, holes=[tp.shapes.circle((0.3, 0.1), 1.0)])
    domain = domain_of(outline, 0.1)
    (run,) = runs_of(domain, int(hole))
    curve = curve_of(domain, 0, run)
    angle = np.sort(rng.uniform(0, 2 * np.pi, 63))[:: -1 if hole else 1]
    x = np.array([0.3, 0.1]) + np.stack([np.cos(angle), np.sin(angle)], axis=1)
    pairs = np.stack([np.arange(63), np.roll(np.arange(63), -1)], axis=1)
    wanted = 0.5 * (curve.start[:, 0] * curve.end[:, 1] - curve.start[:, 1] * curve.end[:, 0]).sum()
    moves = np.ones(63, dtype=bool)
    off = [abs(area_of(y, pairs) - wanted) for y in (x, spread(x, pairs, curve, moves))]
    assert off[0] > 0.01
    assert off[1] < 5e-5
    moves[:20] = False
    still = spread(x, pairs, curve, moves)
    np.testing.assert_array_equal(still[:20], x[:20])
    # Between two corners of its edges a line through them has the area of the polygon already.
    corners = curve.start
    chain = np.stack([np.arange(len(run)), np.roll(np.arange(len(run)), -1)], axis=1)
    np.testing.assert_allclose(spread(corners, chain, curve, np.ones(len(run), dtype=bool)), corners, atol=1e-14)


def test_particles_spread_along_a_loop_with_one_corner_stay_on_it():
    """The chord at the corner missed the area of the whole loop, and its particle was thrown out of the tank."""
    angle = np.radians(np.cumsum([22.0, 22.0, *[316 / 18] * 18]))
    corners = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    domain = domain_of(tp.shapes.polygon(corners, names=["rim"] * len(corners)), 0.1)
    sharp = np.abs(domain.turn) > math.radians(SMOOTH)
    assert sharp.sum() == 1
    (run,) = runs_of(domain, 0)
    curve = curve_of(domain, 0, run)
    x, count = curve.start.copy(), len(run)
    chain = np.stack([np.arange(count), np.roll(np.arange(count), -1)], axis=1)
    for turned in range(0, count, 7):  # in any order of the particles
        order = np.roll(np.arange(count), turned)
        moves = np.ones(count, dtype=bool)
        moves[order.argmin()] = False
        place = np.empty_like(x)
        place[order] = x
        np.testing.assert_allclose(spread(place, order[chain], curve, moves), place, atol=1e-13)


def test_corners_that_turn_more_than_the_limit_end_a_curve():
    gentle, sharp = math.radians(0.9 * SMOOTH), math.radians(1.1 * SMOOTH)
    for angle, count in ((gentle, 1), (sharp, 2)):
        corners = [(0, 0), (1, 0), (1 + math.cos(angle), math.sin(angle)), (1, 2), (0, 2)]
        shape = tp.shapes.polygon(corners, names=["floor", "floor", "a", "b", "c"])
        domain = domain_of(shape, 0.1)
        assert len(runs_of(domain, domain.sides.index("floor"))) == count


def test_points_are_put_on_arcs_and_on_polylines():
    domain = domain_of(BOWL, 0.1)
    (run,) = runs_of(domain, domain.sides.index("bowl"))
    curve = curve_of(domain, 0, run)
    angle = np.linspace(-math.pi + 0.1, -0.1, 50)
    x = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    np.testing.assert_allclose(curve.project(0.99 * x), x, atol=1e-13)
    np.testing.assert_allclose(curve.tangent(x), np.stack([-x[:, 1], x[:, 0]], axis=1), atol=1e-13)
    flat = domain_of(
        tp.shapes.polygon([(0, 0), (1, 0), (2, 0.1), (2, 1), (0, 1)], names=["f", "f", "r", "t", "l"]), 0.1
    )
    (run,) = runs_of(flat, 0)
    np.testing.assert_allclose(
        curve_of(flat, 0, run).project(np.array([[0.5, 0.01], [1.5, 0.05]])), [[0.5, 0], [1.5, 0.05]]
    )


@pytest.mark.parametrize(
    ("what", "message"),
    [
        ({"side": "floor", "slip": True}, "must be one of the sides of the shape"),
        ({"side": "bowl", "motion": lambda t: 0.0}, "cannot move along its normal"),
        ({"side": "bowl", "velocity": (1.0, 0.0)}, "is not along the wall"),
    ],
)
def test_walls_that_do_not_fit_are_refused(what, message, water):
    tank = tp.tank(shape=BOWL, spacing=0.2).fill(water)
    with pytest.raises(ValueError, match=message):
        tp.Case(tank, [water], (0, -9.81), walls=[tp.Wall("here", **what)])


@pytest.mark.slow
def test_oil_between_circles_slips_on_the_outer_one_with_the_friction_of_its_slip_length():
    """u = A r + B / r with the inner circle's speed at r_1 and mu / l u = -mu r d(u / r) / dr at R."""
    inner, outer, speed, length, across = 0.5, 1.0, 0.1, 0.2, 8
    oil, spacing = tp.Fluid("oil", density=1000.0, viscosity=10.0), (outer - inner) / across
    ring = tp.shapes.circle((0, 0), outer, name="outer", holes=[tp.shapes.circle((0, 0), inner, name="inner")])
    tank = tp.tank(shape=ring, spacing=spacing).fill(oil).wall("inner", velocity=speed)
    tank.wall("outer", slip_length=length)
    simulation = tp.Simulation(tp.Case(tank, [oil], (0, 0)), time_step=0.2 * spacing / speed)
    simulation.run(60.0, progress=False)
    a, b = np.linalg.solve([[inner, 1 / inner], [outer, 1 / outer - 2 * length / outer**2]], [speed, 0.0])
    x = simulation.particles.position
    r = np.linalg.norm(x, axis=1)
    around = (simulation.particles.velocity * np.stack([-x[:, 1], x[:, 0]], axis=1)).sum(axis=1) / r
    assert np.abs(around - a * r - b / r).max() < 0.015 * speed
    assert around[r > outer - 1e-3 * spacing].mean() == pytest.approx(a * outer + b / outer, rel=0.02)


def test_a_circle_of_18_edges_is_one_curve():
    """Its corners turn by 20 degrees, at which smooth ones end: by round-off, some of them held the fluid."""
    angle = 0.1 + np.arange(18) * np.pi / 9
    corners = [0.3, 0.155] + 0.05 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    circle = tp.shapes.polygon(corners, names=["hole"] * 18)
    water = tp.Fluid("water", density=1000.0, viscosity=1e-3)
    tank = tp.tank(shape=tp.shapes.rectangle((0, 0), (0.6, 0.3), holes=[circle]), spacing=0.05 / 3)
    boundary = tp.Case(tank.fill(water).wall("hole", slip=True), [water], (0, 0)).boundary
    assert [(len(curve.edges), curve.closed) for curve in boundary.curves] == [(18, True)]
