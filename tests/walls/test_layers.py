"""Walls with unresolved boundary layers: the law against closed forms, and what it does in a flow."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

import tipfem as tp
from tipfem.case.boundary.boundary import Boundary
from tipfem.geometry.period import Period, no_period
from tipfem.physics.walls.layers import DRY, RESOLVED, LayerFaces, Layers, _nearest, advance, begin

NU, H = 1e-6, 0.005


def plate(count=4):
    """A wall of ``count`` points, dry before."""
    place = np.stack([H * np.arange(count), np.zeros(count)], axis=1)
    return Layers(place, np.zeros(count, dtype=int), np.full(count, DRY), np.zeros((count, 2)))


def faces_of(layers, speed, fluid=0, viscosity=NU):
    """Faces between the points of the plate, under a fluid with a speed."""
    middle = 0.5 * (layers.place[1:] + layers.place[:-1])
    count = len(middle)
    velocity = np.tile([float(speed), 0.0], (count, 1))
    return LayerFaces(
        np.zeros(count, dtype=int),
        middle,
        velocity,
        velocity,
        np.full(count, viscosity),
        np.broadcast_to(fluid, (count,)),
        np.full(count, H),
        no_period(2),
    )


def friction(layers, speed_at, end, steps):
    """Traction over density after a time [s], with ``speed_at`` a function of time; and the layers there."""
    dt, length = end / steps, np.zeros(0)
    for n in range(steps):
        speed = speed_at((n + 0.5) * dt)
        layers, length, _ = advance(layers, faces_of(layers, speed), dt)
    # The row of particles at the wall slips by less than the flow outside: U (1 - 2 delta / h).
    thickness = np.linalg.norm(layers.history, axis=1) ** 0.5 / abs(speed)
    slip = speed * (1 - 2 * thickness[:-1] / H)
    return NU * slip / length, layers


def test_a_wall_set_off_at_once_has_the_friction_of_stokes_first_problem():
    traction, _ = friction(plate(), lambda t: 1.5, 0.2, 400)
    np.testing.assert_allclose(traction, NU * 1.5 / np.sqrt(np.pi * NU * 0.2), rtol=3e-3)


def test_a_constant_acceleration_has_087_of_the_exact_friction():
    traction, _ = friction(plate(), lambda t: 4.0 * t, 0.2, 400)
    exact = 2 * NU * 4.0 * np.sqrt(0.2 / (np.pi * NU))
    np.testing.assert_allclose(traction / exact, np.sqrt(3) / 2, rtol=5e-3)


def test_the_oscillating_layer_does_not_grow():
    """Stokes' second problem: after ten periods, the largest Q is that of the first."""
    layers, largest = plate(), []
    for period in range(10):
        for n in range(100):
            layers, _, _ = advance(layers, faces_of(layers, np.sin(2 * np.pi * (n + 0.5) / 100)), 0.01)
            largest.append(np.abs(layers.history).max())
        assert max(largest[-100:]) == pytest.approx(max(largest[:100]), rel=1e-2), period


def test_another_fluid_begins_a_layer_and_a_dry_wall_has_none():
    _, layers = friction(plate(), lambda t: 1.0, 0.1, 10)
    assert (layers.history[:, 0] > 0).all()
    assert (layers.fluid == 0).all()
    after, _, _ = advance(layers, faces_of(layers, 1.0, fluid=[0, 0, 1]), 0.01)
    assert list(after.fluid) == [0, 0, 0, 1]  # the third point is as far from either face: it takes the first
    assert after.history[3, 0] == pytest.approx(4 * NU / np.pi * 0.01)
    assert after.history[0, 0] > layers.history[0, 0]
    none = faces_of(layers, 1.0)
    far = dataclasses.replace(none, middle=none.middle + [0.0, 1.0])
    dry, _, _ = advance(layers, far, 0.01)
    assert (dry.fluid == DRY).all()
    assert not dry.history.any()


def test_a_resolved_layer_is_a_no_slip_wall():
    """From delta = h / 2 on; and at rest."""
    steady = plate()
    for _ in range(200):
        steady, length, _ = advance(steady, faces_of(steady, 1.0, viscosity=1e-3), 0.01)
    np.testing.assert_allclose(length, RESOLVED * H)
    assert np.linalg.norm(steady.history, axis=1).max() <= H**2 * (1 + 1e-12)
    _, length, _ = advance(plate(), faces_of(plate(), 0.0), 0.01)
    np.testing.assert_allclose(length, RESOLVED * H)


def test_bad_laws_are_refused():
    tank = tp.tank((1, 0.6), 0.1)
    with pytest.raises(ValueError, match=re.escape("wall 'top': law is 'log'; it must be one of 'no-slip', 'layer'")):
        tank.wall("top", law="log")
    with pytest.raises(ValueError, match="law is 'layer' and slip_length is given; give one of the two"):
        tank.wall("top", law="layer", slip_length=1e-3)


def test_the_points_of_a_wall_are_its_first_particles(water):
    tank = tp.tank((1, 0.6), 0.1).fill(water).wall("bottom", law="layer").wall("left", slip=True)
    particles = tank.sample([water])
    boundary = Boundary(particles, tank.walls(particles), None)
    layers = Layers.on(boundary, particles.position[boundary.index])
    assert layers is not None
    assert len(layers.place) == 11
    assert not layers.place[:, 1].any()
    assert (layers.fluid == DRY).all()
    bare = tp.tank((1, 0.6), 0.1).fill(water).wall("left", slip=True)
    assert Layers.on(Boundary(particles, bare.walls(particles), None), particles.position[boundary.index]) is None


def work_of_lid(law, steps, cells=8, aspect=4.0):
    """Work of a lid that sets off at once over that of Stokes' first problem, after some steps; and the history."""
    spacing, nu, speed = 1 / cells, 1e-3, 1e-3
    fluid = tp.Fluid("fluid", 1.0, nu)
    tank = tp.tank((aspect, 1), spacing, jitter=0.1).fill(fluid).wall("top", velocity=(speed, 0.0), law=law)
    for side in ("left", "right", "bottom"):
        tank.wall(side, slip=True)
    simulation = tp.Simulation(tp.Case(tank, [fluid], (0, 0)), time_step=0.02 * spacing**2 / nu)
    start = simulation.energy().kinetic
    work, exact = [], []
    for _ in range(steps):
        simulation.step()
        work.append(simulation.history[-1]["external_work"])
        exact.append(2 * nu * speed**2 * aspect * np.sqrt(simulation.time / np.pi / nu))
    return (start + np.cumsum(work)) / exact, simulation


def test_a_layer_from_unresolved_to_resolved_takes_the_work_of_stokes_first_problem():
    """Until the layer's displacement thickness is a spacing; a no-slip wall takes twice as much at first."""
    ratio, simulation = work_of_lid("layer", 25)
    assert (ratio > 0.7).all()
    assert (ratio < 1.25).all()
    history = simulation.history
    assert sum(row["friction_dissipation"] for row in history) > 0
    residual = sum(abs(row["energy_residual"]) for row in history)
    assert residual < 5e-3 * sum(row["external_work"] for row in history)
    held, _ = work_of_lid("no-slip", 1)
    assert held[0] > 1.8


def test_still_walls_do_no_work(water, air):
    """What their friction takes is dissipation, also where the flow begins."""
    tank = tp.tank((0.584, 0.584), 0.04).fill(air).fill(water, box=((0, 0), (0.146, 0.292)))
    numerics = tp.Numerics(newton_tolerance=1e-12)
    simulation = tp.Simulation(tp.Case(tank, [water, air], (0, -9.81), numerics=numerics), time_step=2e-3)
    for _ in range(10):
        simulation.step()
        row = simulation.history[-1]
        assert abs(row["external_work"]) < 1e-6 * row["friction_dissipation"]
        assert abs(row["energy_residual"]) < 1e-6 * row["friction_dissipation"]


@pytest.mark.slow
@pytest.mark.parametrize("free_surface", [False, True])
def test_walls_with_layers_take_less_from_a_dam_break(water, air, free_surface):
    """Than no-slip walls at 20 mm, by remeshing: less than a third of the energy; the free surface takes more."""
    losses = []
    for law in ("no-slip", "layer"):
        tank = tp.tank((0.584, 0.584), 0.02)
        if not free_surface:
            tank.fill(air)
        tank.fill(water, box=((0, 0), (0.146, 0.292)))
        for side in ("left", "right", "bottom", "top"):
            tank.wall(side, law=law)
        fluids = [water] if free_surface else [water, air]
        simulation = tp.Simulation(tp.Case(tank, fluids, (0, -9.81), free_surface=free_surface), time_step=2e-3)
        while simulation.time < 0.15:
            simulation.step(0.15)
        losses.append(sum(row["remeshing_dissipation"] for row in simulation.history))
    assert losses[0] > 0
    assert abs(losses[1]) < losses[0] / (1.8 if free_surface else 3)


def test_layers_in_3d():
    """The floor of a tank in 3-D takes momentum, and less than half a spacing of the fluid has."""
    fluid = tp.Fluid("fluid", 1000.0, 1e-3)
    tank = tp.tank((1, 1, 0.75), 0.25, jitter=0.1).fill(fluid).wall("bottom", law="layer")
    case = tp.Case(
        tank,
        [fluid],
        (0, 0, 0),
        interface="interpolated",
        body_force=lambda x, t: np.stack([x[:, 1], -x[:, 0], 0 * x[:, 0]], axis=1),
    )
    simulation = tp.Simulation(case, time_step=0.02)
    for _ in range(3):
        simulation.step()
    layers = simulation.state.part(Layers)
    assert layers is not None
    assert (layers.fluid == 0).all()
    assert np.linalg.norm(layers.history, axis=1).max() > 0
    assert simulation.history[-1]["friction_dissipation"] > 0


def test_a_flow_begins_with_the_layers_of_its_profile():
    """A profile that is zero at the wall is resolved, a uniform flow has no layer yet."""
    uniform = faces_of(plate(), 2.0)
    for slip, thickness in ((1.0, 0.0), (0.5, H / 4), (0.0, H / 2), (-1.0, H / 2), (3.0, 0.0)):
        layers = begin(plate(), dataclasses.replace(uniform, slip=slip * uniform.velocity))
        np.testing.assert_allclose(layers.history, np.tile([thickness**2 * 4.0, 0.0], (4, 1)), rtol=1e-12)
        assert (layers.fluid == 0).all()
    _, length, _ = advance(begin(plate(), dataclasses.replace(uniform, slip=0 * uniform.velocity)), uniform, 1e-6)
    np.testing.assert_allclose(length, RESOLVED * H)


SQUARE = [(0.3, 0.3), (0.7, 0.3), (0.7, 0.7), (0.3, 0.7)]
BOX = ["left", "right", "bottom", "top", "back", "front"]
BOWL = tp.shapes.polygon([(0, 0), (1, 0), (1, 1), tp.shapes.arc((0.5, 1)), (0, 1)], names=["floor", "r", "bow", "l"])


@pytest.mark.parametrize(
    ("tank", "options", "layered"),
    [
        ({}, {}, ["left", "right", "bottom", "top"]),
        ({}, {"interface": "interpolated"}, ["left", "right", "bottom", "top"]),
        ({}, {"free_surface": True}, ["left", "right", "bottom", "top"]),
        ({}, {"walls": [tp.Wall("floor", between=((0, 0), (1, 0)), slip=True)]}, []),
        ({"periodic": "x"}, {}, ["bottom", "top"]),
        ({"body": True}, {}, ["left", "right", "bottom", "top"]),
        ({"shape": [(0, 0), (1, 0.2), (1, 1), (0, 1)]}, {}, ["side0", "side1", "side2", "side3"]),
        ({"shape": BOWL}, {}, ["floor", "r", "bow", "l"]),
        ({"shape": BOWL}, {"free_surface": True}, ["floor", "r", "bow", "l"]),
        ({"shape": BOWL}, {"interface": "interpolated"}, ["floor", "r", "l"]),
        ({"shape": BOWL}, {"grading": tp.Grading({"water": 0.08})}, ["floor", "r", "l"]),
        ({"size": (1, 1, 1), "jitter": 0.1}, {"interface": "interpolated"}, []),
        ({"size": (1, 1, 1), "jitter": 0.1}, {"free_surface": True}, BOX),
    ],
)
def test_which_walls_have_the_law_by_default(water, tank, options, layered):
    size = {} if "shape" in tank or "size" in tank else {"size": (1, 1)}
    filled = tp.tank(spacing=0.05, **size, **{k: v for k, v in tank.items() if k != "body"}).fill(water)
    if "body" in tank:
        filled.add(tp.Body(SQUARE, "block", density=1000.0))
    gravity = (0, -9.81, 0) if "jitter" in tank else (0, -9.81)
    case = tp.Case(filled, [water], gravity, **options)
    assert [wall.name for wall in case.walls if wall.law == "layer"] == layered
    for name, rule in filled.default_laws.items():
        assert (rule.law == "layer") == (name in layered)


@pytest.mark.parametrize("law", ["no-slip", "layer"])
def test_a_stream_between_periodic_sides_loses_the_momentum_of_two_layers(water, law):
    """Stokes' first problem at both walls, whose layers are a tenth of the spacing thick; across the seam, too."""
    height, speed = 0.1, 1.0
    tank = tp.tank((0.2, height), 0.01, jitter=0.1, periodic="x").fill(water, velocity=(speed, 0.0))
    for side in tank.sides:
        tank.wall(side, law=law)
    simulation = tp.Simulation(tp.Case(tank, [water], (0, 0)), time_step=3e-3)
    start = water.density * 0.2 * height * speed
    while simulation.time < 0.3:
        simulation.step(0.3)
    nu = water.viscosity / water.density
    exact = 4 * water.density * 0.2 * speed * np.sqrt(nu * 0.3 / np.pi)
    lost = (start - simulation.history[-1]["momentum_x"]) / exact
    assert lost == pytest.approx(1.0, abs=0.25) if law == "layer" else lost > 4
    if law == "layer":
        layers = simulation.state.part(Layers)
        size = np.linalg.norm(layers.history, axis=1)
        assert size.min() > 0.5 * size.max()  # also beside the seam


def test_what_is_said_of_a_wall_holds(water):
    tank = tp.tank((1, 1), 0.1).fill(water).wall("top", velocity=(1.0, 0.0)).wall("left", law="no-slip")
    case = tp.Case(tank.wall("bottom", slip=True), [water], (0, 0))
    assert {wall.name: wall.law for wall in case.walls} == {"top": None, "bottom": None, "right": "layer"}


@pytest.mark.parametrize("viscosity", [1e-6, 1.0])
def test_contacts_are_those_of_a_no_slip_wall_where_layers_are_resolved(viscosity):
    fluid = tp.Fluid("fluid", density=1.0, viscosity=viscosity)
    tank = tp.tank((1, 1), 0.1, jitter=0.1).fill(fluid, velocity=lambda x: x[:, ::-1] * [-1, 1] + [0.5, -0.5])
    simulation = tp.Simulation(tp.Case(tank, [fluid], (0, 0)), time_step=1e-2)
    simulation.step()
    solved = simulation.solve(simulation.state, 1e-2)
    slides = simulation.boundary.index[simulation.boundary.slides]
    assert len(slides) == 36
    stuck = solved.walls.stuck[slides].mean()
    assert stuck > 0.8 if viscosity == 1.0 else stuck < 0.2  # but for those beside corners, which do not slip


@pytest.mark.slow
def test_oil_between_circles_turns_as_between_no_slip_walls():
    """Curved walls may have the law, too: it is resolved here, and the torque is that of the closed form."""
    inner, outer, speed, across = 0.5, 1.0, 0.1, 8
    oil, spacing = tp.Fluid("oil", density=1000.0, viscosity=10.0), (outer - inner) / across
    ring = tp.shapes.circle((0, 0), outer, name="outer", holes=[tp.shapes.circle((0, 0), inner, name="inner")])
    tank = tp.tank(shape=ring, spacing=spacing).fill(oil).wall("inner", velocity=speed).wall("outer", law="layer")
    simulation = tp.Simulation(tp.Case(tank, [oil], (0, 0)), time_step=0.2 * spacing / speed)
    simulation.run(30.0, progress=False)
    x, rows = simulation.particles.position, simulation.history[-20:]
    r = np.linalg.norm(x, axis=1)
    around = (simulation.particles.velocity * np.stack([-x[:, 1], x[:, 0]], axis=1)).sum(axis=1) / r
    part = speed * inner / (outer**2 - inner**2)
    assert np.abs(around - part * (outer**2 / r - r)).max() < 0.01 * speed
    torque, dt = 4 * np.pi * oil.viscosity * part * outer**2, sum(row["time_step"] for row in rows)
    power = sum(row["viscous_dissipation"] + row["friction_dissipation"] for row in rows) / dt
    assert power == pytest.approx(torque * speed / inner, rel=0.01)
    assert min(row["friction_dissipation"] for row in simulation.history) >= 0


@pytest.mark.parametrize("width", [0.0, 1.0])
def test_the_nearest_is_found_on_the_same_part_and_across_a_periodic_side(width):
    """As by comparing all; a part without others has the number 0 and no distance that matters."""
    rng = np.random.default_rng(2)
    place, others = rng.random((40, 2)), rng.random((30, 2))
    part, part_of_others = np.sort(rng.integers(0, 4, 40)), np.sort(rng.integers(0, 3, 30))
    apart = place[:, None] - others
    apart[..., 0] -= width * np.round(apart[..., 0])
    distance = np.where(part[:, None] == part_of_others, np.linalg.norm(apart, axis=2), np.inf)
    found, number = _nearest(place, part, others, part_of_others, Period(np.array([width, 0.0])))
    alone = part == 3
    np.testing.assert_array_equal(number, np.where(alone, 0, distance.argmin(axis=1)))
    np.testing.assert_allclose(found[~alone], distance.min(axis=1)[~alone], rtol=1e-12)
    assert (found[alone] > 1e10).all()
