"""Axisymmetric flows: rest, volumes, the Jacobian, results, pictures, probes, and what is refused."""

import dataclasses
import math

import numpy as np
import pytest
from tipfem.demos.validation.round.run import AIR, WATER, R, drop, pair, round_tank

import tipfem as tp
from tipfem.backend.arrays import download
from tipfem.case.axisymmetric import PROBES
from tipfem.errors import Invalid
from tipfem.geometry.period import axisymmetric
from tipfem.geometry.plane.curves import chain_tangents, outward_normals
from tipfem.geometry.plane.domain import enclosed
from tipfem.physics.surface_tension.edges import TensionEdges
from tipfem.physics.surface_tension.term import _volume_slope
from tipfem.probes.recorder import ProbeRecorder
from tipfem.run.liveview.source import on_computed_side
from tipfem.step import solve as step_solve

LIQUID, AROUND = pair(0.5, 0.1)


def test_a_funnel_has_an_axis_and_water_in_it_is_at_rest():
    """A shape's side at r = 0 is the axis, whatever its name; the volume is that of a truncated cone."""
    tp.init()
    tank = tp.tank(shape=[(0, 0), (0.2, 0), (0.5, 0.6), (0, 0.6)], spacing=0.05, coordinates="axisymmetric")
    assert "axis" in tank.sides
    simulation = tp.Simulation(tp.Case(tank.fill(WATER), [WATER], (0, -9.81)))
    exact = math.pi * 0.6 / 3 * (0.2**2 + 0.2 * 0.5 + 0.5**2)
    assert simulation.volume("water") == pytest.approx(exact, rel=1e-13)
    assert simulation.case.boundary.volume_at(0.0) == pytest.approx(exact, rel=1e-13)  # that pistons must keep
    for _ in range(10):
        simulation.step()
    assert simulation.history[-1]["max_speed"] < 1e-11


def bowl(spacing=0.05, **options):
    """A tank that is half of a ball of radius 0.5 m."""
    corners = [(0, 0), tp.shapes.arc((0, 0.5)), (0.5, 0.5), (0, 0.5)]
    shape = tp.shapes.polygon(corners, names=["bowl", "lid", "middle"])
    return tp.tank(shape=shape, spacing=spacing, coordinates="axisymmetric", **options)


@pytest.mark.parametrize("law", ["layer", "no-slip", "slip"])
@pytest.mark.parametrize("kind", ["full", "two fluids", "free surface"])
def test_water_in_a_bowl_stays_at_rest(kind, law):
    """On a mesh with a jitter; its volume is that of the tank's polygon to round-off, and of the ball to order 2."""
    tp.init()
    tank = bowl(jitter=0.2)
    tank = tank.fill(AIR) if kind == "two fluids" else tank
    tank.fill(WATER, **({} if kind == "full" else {"box": ((0, 0), (0.5, 0.3))}))
    for side in ("bowl", "lid"):
        tank.wall(side, **({"slip": True} if law == "slip" else {"law": law}))
    fluids = [WATER, AIR] if kind == "two fluids" else [WATER]
    simulation = tp.Simulation(tp.Case(tank, fluids, (0, -9.81), free_surface=kind == "free surface"))
    start = simulation.volume("water")
    for _ in range(10):
        simulation.step()
    assert simulation.history[-1]["max_speed"] < 1e-11
    assert simulation.volume("water") == pytest.approx(start, rel=1e-14)
    exact = math.pi * (2 / 3 * 0.5**3 if kind == "full" else 0.3**2 * (0.5 - 0.1))
    assert start == pytest.approx(exact, rel=5e-3)


def test_water_flows_along_a_bowl():
    """Its volume and its budget of energy hold to round-off, with a lid that it touches everywhere."""
    tp.init()
    tank = bowl().fill(WATER, velocity=lambda x: np.stack([0.5 * x[:, 0], 0.2 - x[:, 1]], axis=1))
    simulation = tp.Simulation(tp.Case(tank.wall("bowl", slip=True).wall("lid", slip=True), [WATER], (0, -9.81)))
    start = simulation.volume("water")
    for _ in range(15):
        simulation.step()
    assert simulation.volume("water") == pytest.approx(start, rel=1e-13)
    rows = simulation.history
    assert rows[-1]["kinetic_energy"] > 1e-4
    assert max(abs(row["energy_residual"]) for row in rows) < 1e-9 * rows[-1]["kinetic_energy"]


def test_normals_along_curves_are_derivatives_of_the_volume():
    """And tangents are at right angles to them."""
    rng = np.random.default_rng(0)
    angle = np.sort(rng.uniform(-1.5, 1.5, 12))
    x = np.concatenate([[(0, -1.0)], np.stack([np.cos(angle), np.sin(angle)], axis=1), [(0, 1.0)]])
    pairs, period = np.stack([np.arange(14), np.roll(np.arange(14), -1)], axis=1), axisymmetric()
    normal = outward_normals(x, pairs, period)
    for i in range(1, 13):
        for k in range(2):
            step = np.zeros_like(x)
            step[i, k] = 1e-5
            after, before = ((x + shift)[pairs.T] for shift in (step, -step))
            found = (enclosed(*after, period) - enclosed(*before, period)) / 2e-5
            assert normal[i, k] == pytest.approx(found, abs=1e-8)
    inner = np.arange(1, 13)
    assert np.abs((chain_tangents(x, pairs, inner, period) * normal[inner]).sum(axis=1)).max() < 1e-14


@pytest.mark.slow
def test_a_piston_lifts_water():
    """A floor that moves along z: the volume stays, and the work is what the water gains."""
    tp.init()
    tank = tp.tank((0.5, 1.0), 0.1, coordinates="axisymmetric").fill(WATER, box=((0, 0), (0.5, 0.5)))
    tank.wall("bottom", motion=lambda t: 0.05 * (1 - math.cos(math.pi * min(t, 1.0))))
    simulation = tp.Simulation(tp.Case(tank.wall("right", slip=True), [WATER], (0, -9.81), free_surface=True))
    start = simulation.energy()
    simulation.run(until=1.0)
    assert simulation.volume("water") == pytest.approx(math.pi * 0.25 * 0.5, rel=1e-12)
    lifted = WATER.density * math.pi * 0.25 * 0.5 * 9.81 * 0.1
    gained = simulation.energy().potential - start.potential
    assert gained == pytest.approx(lifted, rel=5e-3)
    assert sum(row["external_work"] for row in simulation.history) == pytest.approx(lifted, rel=2e-2)


@pytest.mark.parametrize("law", ["layer", "no-slip", "slip"])
@pytest.mark.parametrize("free", [False, True], ids=["two fluids", "free surface"])
def test_layers_stay_at_rest(law, free):
    """On any mesh: with other means of r than the exact ones, a fluid at rest accelerates by 0.1 g beside the axis."""
    tp.init()
    tank = tp.tank((0.5, 1.0), 0.05, jitter=0.2, coordinates="axisymmetric")
    tank = (tank if free else tank.fill(AIR)).fill(WATER, box=((0, 0), (0.5, 0.6)))
    for side in ("right", "top", "bottom"):
        tank.wall(side, **({"slip": True} if law == "slip" else {"law": law}))
    fluids = [WATER] if free else [WATER, AIR]
    simulation = tp.Simulation(tp.Case(tank, fluids, (0, -9.81), free_surface=free))
    exact = math.pi * 0.25 * 0.6
    assert simulation.volume("water") == pytest.approx(exact, rel=1e-14)
    for _ in range(10):
        simulation.step()
    assert max(row["max_speed"] for row in simulation.history) < 1e-11
    assert simulation.volume("water") == pytest.approx(exact, rel=1e-13)
    p, z = simulation.particles.pressure, simulation.particles.position[:, 1]
    wet = z < 0.6
    assert np.ptp((p + WATER.density * 9.81 * z)[wet]) < 1e-9 * WATER.density * 9.81


def meridian(count, noise=0.0, ends=True):
    """Places of a ball's meridian, with or without the poles, and its edges."""
    angle = np.linspace(-0.5 * math.pi, 0.5 * math.pi, count + 1)
    size = 1 + noise * np.random.default_rng(0).standard_normal(count + 1)
    x = np.stack([np.where(abs(angle) < 1.5, np.cos(angle), 0.0), np.sin(angle)], axis=1) * size[:, None]
    x = x if ends else x[2:-3]
    one = np.arange(len(x) - 1)
    return x, TensionEdges(one, one + 1, np.full(len(one), 2.0), np.zeros((2, 2)), axisymmetric())


@pytest.mark.parametrize("ends", [True, False], ids=["poles", "contacts"])
def test_the_tension_of_arcs_is_the_derivative_of_their_energy(ends):
    x, edges = meridian(13, noise=0.03, ends=ends)
    v = np.random.default_rng(1).standard_normal(x.shape)
    slope = (edges.energy(x + 1e-6 * v) - edges.energy(x - 1e-6 * v)) / 2e-6
    assert slope == pytest.approx(((edges.gradient(x) + edges.arc_gradient(x)) * v).sum(), rel=1e-8)
    assert abs(edges.arc_gradient(x)).max() > 0.1


def test_tension_around_an_axis_is_of_fourth_order():
    """The pressure in a ball, and the work along u_r = -r / 2, u_z = z, 3 % of it along the meridian."""
    errors = []
    for count in (12, 24):
        x, edges = meridian(count)
        r, z = x.T
        volume = math.pi / 3 * ((r[1:] ** 2 + r[1:] * r[:-1] + r[:-1] ** 2) * np.diff(z)).sum()
        radius = (0.75 * volume / math.pi) ** (1 / 3)
        pressure = 2 * edges.energy(x) / (3 * volume)
        works = []
        for size in (-1e-4, 1e-4):
            y = x * [math.exp(-0.5 * size), math.exp(size)]
            force = edges.gradient(y) + edges.arc_gradient(y)
            normal = _volume_slope(y[1:-1], y[:-2]) - _volume_slope(y[1:-1], y[2:])
            along = (force[1:-1] * normal).sum(axis=1) / (normal * normal).sum(axis=1)
            force[1:-1] = along[:, None] * normal + edges.pressed_along(y)[1:-1]
            works.append((force * y * [-0.5, 1.0]).sum())  # r = 0 at the poles
        stiffness = (works[1] - works[0]) / 2e-4
        errors.append((pressure * radius / 4 - 1, stiffness / (16 * math.pi / 5 * 2 * radius**2) - 1))
    (one, stiff), (finer, stiffer) = errors
    assert abs(one) < 1e-4
    assert abs(one / finer) > 12
    assert abs(stiff) < 5e-4
    assert abs(stiff / stiffer) > 10
    assert abs(edges.pressed_along(x)).max() < 1e-6  # nothing on a ball


LAWS = {
    "lumped": 0.5,
    "consistent": 0.5,
    "bingham": tp.Bingham(2.0, 0.5, regularisation=0.4),
    "power": tp.PowerLaw(0.5, 0.4, least_rate=0.2),
    "carreau": tp.Carreau(at_rest=5.0, at_infinity=0.3, time=0.7, index=0.3),
    "granular": tp.Granular(0.4, 0.7, diameter=0.02, grain_density=2500.0, regularisation=0.4, least_viscosity=0.1),
    "smagorinsky": tp.Smagorinsky(viscosity=0.5, constant=0.2),
}


@pytest.mark.parametrize("what", LAWS)
def test_the_jacobian_is_the_derivative_of_the_residual(what, monkeypatch):
    """By differences of fourth order, each block by itself: a jittered mesh, two fluids, tension, and laws."""
    tp.init()
    liquid, numerics = tp.Fluid("liquid", 1.0, LAWS[what]), tp.Numerics(mass=what if what == "consistent" else "lumped")
    simulation = drop(6, liquid, AROUND, (2.0, 4.0), jitter=0.2, gravity=0.3, numerics=numerics)
    simulation.step()
    errors = {}

    def look(problem, x, **options):
        size, h, rng = problem.size, problem.particles.spacing, np.random.default_rng(0)
        free, x0 = (download(problem.equations.scale, size) != 0).astype(float), download(x, size).copy()
        of_interface = np.zeros(size, dtype=bool)  # where only a part of the tension is taken, with the whole Hessian
        edges = simulation.state.part(TensionEdges)
        of_interface.reshape(-1, 3)[np.concatenate([edges.one, edges.other])] = True

        def up(values):
            return problem.buffers.upload("check.x", values)

        def spread(values):  # to copies of nodes, and along walls
            there = up(values)
            problem.system.condensation.spread(there)
            return download(there, size).copy()

        def residual(values):
            problem._evaluate(up(values))
            return download(problem._r, size).copy()

        def bump(u, p):
            return rng.standard_normal(size) * free * np.tile([u, u, p], size // 3)

        x1 = x0 + spread(bump(0.05 * h, np.abs(x0[2::3]).max() + 1.0))
        for name, v in (("u", bump(h, 0.0)), ("p", bump(0.0, np.abs(x0[2::3]).max() + 1.0))):
            residual(x1)
            problem.linearise()
            out, full = problem.buffers.get("check.out", size), spread(v)
            problem.product(up(v), out)
            exact = download(out, size).copy()
            one, two = (residual(x1 + step * full) - residual(x1 - step * full) for step in (5e-5, 1e-4))
            difference = (8 * one - two) / 6e-4
            for k, row in enumerate("rzc"):
                off = np.abs(exact - difference) * ~of_interface
                errors[row, name] = off[k::3].max() / np.abs(difference[k::3]).max()
        problem._evaluate(up(x0))
        return kept(problem, x, **options)

    kept = step_solve.newton
    monkeypatch.setattr(step_solve, "newton", look)
    simulation.step()
    assert max(errors.values()) < 1e-8, errors


@pytest.mark.slow
def test_a_drop_in_a_liquid_of_its_density_swings_as_liquids_that_slide():
    """Mode 2, omega^2 = 24 sigma / ((3 rho_1 + 2 rho_2) R^3) (Lamb, 1932, article 275), 8 spacings a diameter."""
    slow = []
    for sliding in (True, False):
        drop, around = tp.Fluid("drop", 1000.0, 1e-3), tp.Fluid("around", 1000.0, 1e-3)

        def inside(x):
            y = x - [0.0, 1.0]
            r = np.maximum(np.linalg.norm(y, axis=1), 1e-12)
            return r < 0.25 * (1 + 0.05 * (3 * (y[:, 1] / r) ** 2 - 1))

        tank = tp.tank((1.0, 2.0), 0.0625, coordinates="axisymmetric").fill(around).fill(drop, where=inside)
        for side in ("right", "bottom", "top"):
            tank.wall(side, slip=True)
        tension, numerics = {("drop", "around"): 1.0}, tp.Numerics(sliding=sliding, mass="consistent")
        case = tp.Case(tank, [drop, around], (0, 0), surface_tension=tension, numerics=numerics)
        simulation = tp.Simulation(case, time_step=0.25 * case.surface_tension.capillary_time(0.0625))
        assert ("sliding_liquids" in simulation.state.parts) == sliding
        period = 2 * math.pi / math.sqrt(24.0 / (5000.0 * 3 * simulation.volume("drop") / (4 * math.pi)))
        times, moments = [], []
        while simulation.time < 1.6 * period:
            simulation.step(1.6 * period)
            mesh = simulation.mesh
            here = np.asarray(mesh.fluid) == 0
            x, volume = mesh.position[mesh.cells[here]].mean(axis=1), mesh.measure[here]
            z = volume @ x[:, 1] / volume.sum()
            times.append(simulation.time)
            moments.append(volume @ ((x[:, 1] - z) ** 2 - 0.5 * x[:, 0] ** 2))
        t, a = np.array(times), np.array(moments)
        k = np.flatnonzero(a[:-1] * a[1:] < 0)
        crossing = t[k] - a[k] * (t[k + 1] - t[k]) / (a[k + 1] - a[k])
        slow.append((crossing[2] - crossing[0]) / period - 1)
        rows = simulation.history
        assert max(abs(row["energy_residual"]) for row in rows) < 1e-10 * max(row["kinetic_energy"] for row in rows)
    assert abs(slow[0]) < 0.04
    assert slow[1] > 0.08


@pytest.mark.slow
def test_volumes_through_splash_and_pinch_off():
    """A drop falls into a pool; a thread pinches off: volumes to 1e-12, and no energy is made."""
    tp.init()
    tank = round_tank((1.5, 2.0), 0.1).fill(WATER, box=((0, 0), (1.5, 0.5)))
    tank.fill(WATER, disc=((0.0, 0.9), 0.25), velocity=(0, -4.0))
    splash = tp.Simulation(tp.Case(tank, [WATER], (0, -9.81), free_surface=True, surface_tension={"water": 0.07}))
    oh, x = 0.1, 0.7
    fluids = [tp.Fluid("liquid", 1.0, oh), tp.Fluid("around", 1e-3, 1e-3 * oh)]
    tank = round_tank((3.0, math.pi / x), 1 / 6).fill(fluids[1])
    tank.fill(fluids[0], where=lambda p: p[:, 0] < 1 + 0.2 * np.cos(x * p[:, 1]))
    thread = tp.Simulation(tp.Case(tank, fluids, (0, 0), surface_tension={("liquid", "around"): 1.0}))
    for simulation, name, end in ((splash, "water", 0.5), (thread, "liquid", 8.0)):
        volume, energy = simulation.volume(name), None
        while simulation.time < end:
            simulation.step()
            row = simulation.history[-1]
            assert simulation.volume(name) == pytest.approx(volume, rel=1e-12)
            total = row["kinetic_energy"] + row["potential_energy"] + row["surface_energy"]
            energy = total if energy is None else energy
            assert total < energy * (1 + 1e-6) + 1e-6 * abs(energy)
    edges, r = thread.state.part(TensionEdges), thread.particles.position[:, 0]
    assert min(r[edges.one].min(), r[edges.other].min()) == 0  # the thread has two ends on the axis


def test_a_run_goes_on_from_its_folder_in_the_same_coordinates(tmp_path):
    """Case files, results and checkpoints keep the coordinates; units are those of rings."""
    tp.init()
    text = """
gravity = [0, -9.81]
free_surface = true
[fluids.water]
density = 1000
viscosity = 1e-3
[tank]
size = [0.5, 1.0]
spacing = 0.1
coordinates = "axisymmetric"
[[fill]]
fluid = "water"
box = [[0, 0], [0.3, 0.5]]
[time]
end = 0.05
[output]
interval = 0.02
"""
    (tmp_path / "case.toml").write_text(text)
    case = tp.load_case(tmp_path / "case.toml").case()
    assert case.coordinates == "axisymmetric"
    assert "axis" in [wall.name for wall in case.walls]
    again = tp.load_case(tmp_path / "case.toml").case()
    assert 'coordinates = "axisymmetric"' in tp.describe(again, 0.05).text
    simulation = tp.Simulation(case, out=tmp_path / "out", output_interval=0.02)
    simulation.run(until=0.05)
    same = tp.load_case(tmp_path / "out" / "case.toml").case()
    assert sorted(wall.name for wall in same.walls) == sorted(wall.name for wall in case.walls)
    again = tp.Simulation.resume(tmp_path / "out")
    assert again.case.coordinates == "axisymmetric"
    assert again.case.period == simulation.case.period
    assert again.mesh.measure.sum() == pytest.approx(math.pi * 0.09 * 0.5, rel=1e-12)
    history = tp.RunResults(tmp_path / "out").history
    assert (history.units["volume_water"], history.units["kinetic_energy"]) == ("m3", "J")
    assert "momentum_z" in history
    assert not {"momentum_x", "momentum_r", "wall_force_x"} & set(history)


def test_pictures_show_both_sides_of_the_axis(tmp_path):
    """The other half mirrored, with r and z, and no line at the axis."""
    tp.init()
    tank = round_tank((0.5, 1.0), 0.1).fill(WATER, box=((0, 0), (0.3, 0.5)))
    simulation = tp.Simulation(
        tp.Case(tank, [WATER], (0, -9.81), free_surface=True), out=tmp_path, output_interval=0.05
    )
    simulation.run(until=0.05)
    from tipfem.render.results import Results

    results = Results(tmp_path)
    scene = results.scene(-1)
    assert scene.axes == ("r", "z")
    assert results.lower.tolist() == [-0.5, 0.0]
    x, cells = scene.position, scene.cells
    a, b, c = (x[cells[:, k]] for k in range(3))
    area = 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    assert (area > 0).all()
    assert (area * x[cells][:, :, 0].mean(axis=1)).sum() == pytest.approx(0.0, abs=1e-12)
    speed, u = scene.fields["velocity_x"], x[:, 0]
    assert (speed @ u) > 0
    assert speed.sum() == pytest.approx(0.0, abs=1e-12)
    dry = np.bincount(cells.ravel(), minlength=len(x)) == 0
    assert scene.wall[dry & (x[:, 0] == 0)].all()  # in empty space they are no drops
    assert (dry & (x[:, 0] == 0)).any()
    assert np.abs(x[scene.geometry.rim][:, :, 0]).max(axis=1).min() > 0  # the axis is no rim


def test_a_poke_on_the_mirrored_side_is_one_on_the_computed_side():
    """With its acceleration turned to the other side; a release has no place."""
    assert on_computed_side({"at": [-0.1, 0.2], "acceleration": [3, 4]}) == {"at": [0.1, 0.2], "acceleration": [-3, 4]}
    for same in ({"at": [0.1, 0.2], "acceleration": [3, 4]}, {"at": None}):
        assert on_computed_side(same) == same


def test_a_drop_is_measured_as_a_sphere():
    """Place, sphericity, volume and diameter; the volume in a box is that of its rings."""
    tp.init()
    probes = [
        tp.DropProbe(name="drop", fluid="liquid"),
        tp.VolumeProbe(name="box", fluid="around", box=((0.1, 0.0), (0.3, 0.2))),
        tp.VolumeProbe(name="all", fluid="liquid"),
    ]
    simulation = drop(16, LIQUID, AROUND, (1.0, 2.0), gravity=1.0)
    simulation = tp.Simulation(simulation.case, probes=probes)
    simulation.step()
    found = simulation.probes["drop"]
    assert list(found) == ["time", "number", "z", "velocity_z", "sphericity", "contact_angle", "volume", "diameter"]
    assert found["number"][0] == 1
    assert found["z"][0] == pytest.approx(1.0, abs=1e-3)
    assert found["sphericity"][0] == pytest.approx(1.0, abs=5e-3)
    assert found["diameter"][0] == pytest.approx(2 * R, rel=1e-2)
    assert found["volume"][0] == pytest.approx(simulation.probes["all"]["volume"][0], rel=1e-12)
    assert simulation.probes["box"]["volume"][0] == pytest.approx(math.pi * (0.09 - 0.01) * 0.2, rel=1e-6)


def filled(**options):
    return tp.tank((0.5, 1.0), 0.1, coordinates="axisymmetric", **options).fill(WATER)


REFUSED = {
    "gravity": lambda: tp.Case(filled(), [WATER], (1.0, -9.81)),
    "interface": lambda: tp.Case(filled(), [WATER], (0, -9.81), interface="interpolated"),
    "jacobian": lambda: tp.Case(filled(), [WATER], (0, -9.81), numerics=tp.Numerics(jacobian="matrix-free")),
    "budget": lambda: tp.Case(filled(), [WATER], (0, -9.81), numerics=tp.Numerics(budget="detailed")),
    "tank_motion": lambda: tp.Case(filled(), [WATER], (0, -9.81), tank_motion=tp.Motion(translation=lambda t: (0, 0))),
    "ball": lambda: tp.Case(
        filled().add(tp.Body([(0.2, 0.45), (0.3, 0.45), (0.3, 0.55), (0.2, 0.55)], name="ball", density=500.0)),
        [WATER],
        (0, -9.81),
    ),
    "beach": lambda: tp.Case(filled(), [WATER], (0, -9.81), beaches=[tp.Beach(wall="right", length=0.2, period=1.0)]),
    "velocity": lambda: tp.Case(filled().wall("top", velocity=1.0), [WATER], (0, -9.81)),
    "motion": lambda: tp.Case(filled().wall("right", motion=lambda t: 0.0), [WATER], (0, -9.81), free_surface=True),
    "wall 'axis'": lambda: filled().wall("axis", slip=True),
    "has axis": lambda: filled().wall("left", slip=True),
    "coordinates": lambda: tp.tank(shape=[(-1, 0), (1, 0), (1, 1)], spacing=0.1, coordinates="axisymmetric"),
    "periodic": lambda: filled(periodic="x"),
    "'polar'": lambda: tp.tank((1, 1), 0.1, coordinates="polar"),
    "in 3-D": lambda: tp.tank((1, 1, 1), 0.1, jitter=0.1, coordinates="axisymmetric"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_is_refused_is_refused_in_a_sentence(what):
    """It names what is wrong, before anything runs."""
    with pytest.raises(ValueError, match=what) as found:
        REFUSED[what]()
    assert "\n" not in str(found.value)


@pytest.mark.parametrize("kind", PROBES)
def test_probes_of_planar_flows_are_refused(kind):
    """Each by its name."""
    case = tp.Case(filled(), [WATER], (0, -9.81))
    required = {"fluid": "water", "wall": "right"}
    fields = {field.name for field in dataclasses.fields(getattr(tp, kind))}
    probe = getattr(tp, kind)(name="probe", **{name: value for name, value in required.items() if name in fields})
    with pytest.raises(Invalid, match=rf"{kind} 'probe'.*axisymmetric"):
        ProbeRecorder([probe], case)


def test_particles_given_as_arrays_have_an_axis():
    """Their least radius is 0; those on it slip, as in a tank."""
    particles = tp.Case(filled(), [WATER], (0, -9.81)).particles
    case = tp.Case(particles, [WATER], (0, -9.81), coordinates="axisymmetric")
    assert case.coordinates == "axisymmetric"
    assert next(wall for wall in case.walls if wall.name == "axis").slip
    assert "around an axis" in "".join(tp.describe(case, 0.1).missing)
    moved = particles.shallow_copy(position=particles.position + (0.1, 0.0))
    with pytest.raises(Invalid, match="least radius must be 0"):
        tp.Case(moved, [WATER], (0, -9.81), coordinates="axisymmetric")
    with pytest.raises(Invalid, match="'polar'"):
        tp.Case(particles, [WATER], (0, -9.81), coordinates="polar")
