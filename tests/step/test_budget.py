"""Budgets of energy, momentum and volume: they close, and their terms are what theory says."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from manufactured import PI, Vortex
from mesh_twins import nodal_mass

import tipfem as tp
from tipfem.errors import TriangulationError

TIGHT = {"newton_tolerance": 1e-13, "acceleration_tolerance": 1e-12, "newton_iterations": 12}


def dam_break(water, air, spacing=0.02, interface="interpolated", **numerics):
    """A coarse dam break, by default with the interface rule that has a part for every kind of loss."""
    filled = tp.tank((0.584, 0.584), spacing).fill(air).fill(water, box=((0, 0), (0.146, 0.292)))
    for side in ("left", "right", "bottom", "top"):
        filled.wall(side, law="no-slip")
    case = tp.Case(filled, [water, air], (0, -9.81), interface=interface, numerics=tp.Numerics(**numerics))
    return tp.Simulation(case, time_step=1e-3)


def vortex_in_a_box(vortex, cells, time_step, end, *, forced=True, **numerics):
    """The vortex in the unit square from its exact state; without its force it decays."""
    fluid = tp.Fluid("fluid", density=1.0, viscosity=vortex.viscosity)
    particles = tp.tank((1, 1), 1 / cells, jitter=0.2).fill(fluid).sample([fluid])
    off_wall = ~particles.wall[:, None]
    particles.velocity = off_wall * vortex.velocity(particles.position, 0.0)
    particles.acceleration = off_wall * vortex.acceleration(particles.position, 0.0)
    force = vortex.body_force if forced else None
    case = tp.Case(
        particles, [fluid], (0, 0), body_force=force, numerics=tp.Numerics(**numerics), interface="interpolated"
    )
    simulation = tp.Simulation(case, time_step=time_step)
    while simulation.time < end - 1e-12:
        simulation.step(end)
    return simulation


def column(simulation, name):
    """A column of the history."""
    return np.array([row[name] for row in simulation.history])


@pytest.mark.slow(but=("interpolated-0.8",))
@pytest.mark.parametrize(
    ("rho_inf", "mass"), [(0.0, "lumped"), (0.8, "lumped"), (0.0, "consistent")], ids=["0", "0.8", "consistent"]
)
@pytest.mark.parametrize("interface", ["interpolated", "sharp"])
def test_energy_closes_in_the_dam_break(water, air, rho_inf, interface, mass):
    """To round-off, through remeshing, relocation and transfer of momentum."""
    simulation = dam_break(water, air, rho_inf=rho_inf, interface=interface, mass=mass)
    before = sum(simulation.energy())
    while simulation.time < 0.1:
        simulation.step()
        kinetic, potential = simulation.energy()
        row = simulation.history[-1]
        assert row["kinetic_energy"] == pytest.approx(kinetic, rel=1e-13)
        assert row["potential_energy"] == pytest.approx(potential, rel=1e-13)
        dissipated = row["viscous_dissipation"] + row["numerical_dissipation"]
        assert kinetic + potential - before == pytest.approx(row["energy_residual"] - dissipated, abs=1e-11)
        before = kinetic + potential
    assert column(simulation, "relocated").sum() > 5
    dissipated = column(simulation, "viscous_dissipation") + column(simulation, "numerical_dissipation")
    assert dissipated.sum() > 0.5
    assert np.abs(column(simulation, "energy_residual")).sum() < 1e-11 * dissipated.sum()
    parts = ("time", "geometry", "stabilisation", "source", "newton", "remeshing")
    total = sum(column(simulation, f"{part}_dissipation") for part in parts)
    np.testing.assert_allclose(total, column(simulation, "numerical_dissipation"), atol=1e-12)
    # Each of them takes part: none is there by name alone. The sharp interface needs no source.
    for part in parts if interface == "interpolated" else [part for part in parts if part != "source"]:
        assert np.abs(column(simulation, f"{part}_dissipation")).sum() > (1e-6 if part == "newton" else 1e-4)
    assert not column(simulation, "external_work").any()
    for part in ("viscous", "stabilisation"):
        assert column(simulation, f"{part}_dissipation").sum() > 0


@pytest.mark.parametrize(
    ("kind", "mass"),
    [
        ("periodic", "interfaces"),
        ("free surface", "consistent"),
        ("moving walls", "consistent"),
        ("3-D", "consistent"),
        ("3-D", "interfaces"),
    ],
)
def test_energy_closes_with_a_consistent_mass(water, air, kind, mass):
    """Wherever lumped masses work; the kinetic energy is less than that of lumped masses."""
    numerics, options = tp.Numerics(mass=mass, **TIGHT), {}
    if kind == "3-D":
        filled = tp.tank((0.4, 0.4, 0.4), 0.1, jitter=0.1).fill(air).fill(water, box=((0, 0, 0), (0.2, 0.2, 0.4)))
        options["interface"] = "interpolated"
    else:
        filled = tp.tank((0.4, 0.3), 0.02, periodic="x" if kind == "periodic" else None)
    if kind in ("periodic", "moving walls"):
        filled.fill(air).fill(water, where=lambda x: x[:, 1] < 0.15 + 0.03 * np.cos(5 * PI * x[:, 0]))
    if kind == "free surface":
        filled.fill(water, box=((0, 0), (0.2, 0.2)))
        options["free_surface"] = True
    if kind == "moving walls":
        for side, sign in (("left", 1), ("right", -1)):
            filled.wall(side, slip=True, motion=lambda t, sign=sign: sign * 0.005 * (1 - np.cos(30 * t)))
    gravity = (0, -9.81, 0) if kind == "3-D" else (0, -9.81)
    simulation = tp.Simulation(
        tp.Case(filled, [water, *([air] if kind != "free surface" else [])], gravity, numerics=numerics, **options),
        time_step=2e-3,
    )
    for _ in range(8):
        simulation.step()
        row = simulation.history[-1]
        assert abs(row["energy_residual"]) < 1e-8 * max(row["kinetic_energy"], 1e-3)
    lumped = 0.5 * simulation.state.mass @ (simulation.particles.velocity**2).sum(axis=1)
    assert row["kinetic_energy"] > 1e-3
    assert 0.5 * lumped < row["kinetic_energy"] < (1 - 1e-4) * lumped


@pytest.mark.slow(but=("sliding liquids", "3-D"))
@pytest.mark.parametrize("kind", ["dam break", "bodies", "sliding liquids", "3-D"])
def test_the_work_of_what_newton_leaves_closes_the_energy(water, air, kind):
    """It is that of the residual, in a column of its own; what is left then is round-off at any tolerance."""
    left, options = [], {"newton_iterations": 60}
    size, gravity = ((0.4, 0.4, 0.4), (0, -9.81, 0)) if kind == "3-D" else ((0.4, 0.3), (3.0, -9.81))
    lighter = tp.Fluid("air", 800.0, 0.005) if kind == "sliding liquids" else air
    for tolerance in (1e-3, 1e-13):
        tank = tp.tank(size, 0.1, jitter=0.1) if kind == "3-D" else tp.tank(size, 0.02)
        tank.fill(lighter)
        tank.fill(water, box=((0, 0, 0), (0.2, 0.2, 0.4)) if kind == "3-D" else ((0, 0), (0.2, 0.2)))
        if kind == "bodies":
            tank.add(tp.Body(tp.shapes.circle((0.11, 0.11), 0.045), density=300.0, angular_velocity=3.0, slip=True))
            spring = {"free": ("y",), "stiffness": (0, 300, 0), "damping": (0, 4.0, 0)}
            square = tp.shapes.rectangle((0.25, 0.1), (0.33, 0.18))
            tank.add(tp.Body(square, name="box", density=2.0, law="no-slip", **spring))
        numerics = tp.Numerics(newton_tolerance=tolerance, acceleration_tolerance=1.0, **options)
        interface = "interpolated" if kind == "3-D" else "sharp"
        case = tp.Case(tank, [water, lighter], gravity, numerics=numerics, interface=interface)
        simulation = tp.Simulation(case, time_step=2e-3)
        for _ in range(12):
            simulation.step()
        scale = max(row["kinetic_energy"] for row in simulation.history)
        assert np.abs(column(simulation, "energy_residual")).sum() < 1e-9 * scale
        left.append(np.abs(column(simulation, "newton_dissipation")).sum() / scale)
    assert left[0] > 1e-6
    assert left[1] < 1e-9


def test_what_newton_leaves_follows_its_tolerance(water, air):
    left = []
    for tolerance in (1e-3, 1e-13):
        simulation = dam_break(water, air, **{**TIGHT, "newton_tolerance": tolerance, "acceleration_tolerance": 1.0})
        for _ in range(20):
            simulation.step()
        left.append(np.abs(column(simulation, "newton_dissipation")).sum())
    assert left[0] > 1e-6
    assert left[1] < 1e-11


def test_a_decaying_vortex_loses_what_is_dissipated():
    """No force, no gravity: the kinetic energy goes where the columns say; most of it into viscosity."""
    simulation = vortex_in_a_box(Vortex(0.02), 24, 0.01, 0.2, forced=False, newton_tolerance=1e-7)
    row = simulation.history
    lost = row[0]["kinetic_energy"] - row[-1]["kinetic_energy"]
    viscous, numerical = (column(simulation, f"{name}_dissipation")[1:].sum() for name in ("viscous", "numerical"))
    assert lost == pytest.approx(viscous + numerical, rel=1e-5)
    assert lost > 0.2 * row[0]["kinetic_energy"]
    assert abs(numerical) < 0.1 * viscous
    assert not column(simulation, "external_work").any()
    assert not column(simulation, "potential_energy").any()


def test_viscous_dissipation_of_a_vortex_converges():
    """To 2 pi^2 mu per time, at second order in space; the force that keeps the vortex up works as much."""
    wrong = []
    for cells in (16, 32, 64):
        simulation = vortex_in_a_box(Vortex(0.05), cells, 0.4 / cells, 2 / cells, acceleration_tolerance=1e-6)
        rate = column(simulation, "viscous_dissipation") / column(simulation, "time_step")
        wrong.append(1 - rate.mean() / (2 * PI**2 * 0.05))
    orders = np.log2(np.array(wrong[:-1]) / wrong[1:])
    assert np.abs(orders - 2).max() < 0.25, (wrong, orders)
    work = column(simulation, "external_work") / column(simulation, "time_step")
    assert work.mean() == pytest.approx(2 * PI**2 * 0.05, rel=0.03)


def oscillating(rho_inf, time_step):
    """A slow vortex that starts from rest, its time dissipation, and that in closed form.

    To leading order it is (1/2 - alpha_f) dt times int (v . dota dm) dt - (rate of viscous dissipation at the end) / 2.
    """
    amplitude, frequency, end, viscosity = 0.004, 20.0, 0.16, 0.05
    vortex = Vortex(
        viscosity,
        amplitude=lambda t: amplitude * (1 - np.cos(frequency * t)),
        rate=lambda t: amplitude * frequency * np.sin(frequency * t),
    )
    simulation = vortex_in_a_box(
        vortex,
        12,
        time_step,
        end,
        rho_inf=rho_inf,
        stabilisation=0.005 / time_step,
        newton_tolerance=1e-10,
        acceleration_tolerance=1e-8,
    )
    t = np.linspace(0, end, 20001)
    product = vortex.amplitude(t) * amplitude * frequency**2 * np.cos(frequency * t)
    jerk = 3 / 8 * np.sum((product[1:] + product[:-1]) / 2) * (t[1] - t[0])
    friction = 2 * PI**2 * viscosity * vortex.amplitude(end) ** 2
    shift = 0.5 - rho_inf / (1 + rho_inf)
    return column(simulation, "time_dissipation").sum(), shift * time_step * (jerk - friction / 2)


@pytest.mark.slow(but=("0.0",))
@pytest.mark.parametrize("rho_inf", [0.0, 0.5])
def test_time_dissipation_is_that_of_theory(rho_inf):
    """By the shift of generalized-alpha's acceleration: of first order in dt, its error of second."""
    found, theory = np.array([oscillating(rho_inf, dt) for dt in (0.008, 0.004, 0.002)]).T
    wrong = np.abs(found / theory - 1)
    assert wrong[-1] < 0.06
    assert (wrong[:-1] / wrong[1:] > 1.7).all(), wrong


def test_the_trapezoidal_rule_dissipates_nothing(water, air):
    """rho_inf = 1: the work of inertia is the change of kinetic energy, that of friction what it dissipates."""
    assert abs(oscillating(1.0, 0.008)[0]) < 1e-12 * abs(oscillating(0.5, 0.008)[0])
    simulation = dam_break(water, air, rho_inf=1.0)
    for _ in range(10):
        simulation.step()
    assert not column(simulation, "geometry_dissipation").any()
    assert np.abs(column(simulation, "time_dissipation")).max() < 1e-12 * column(simulation, "kinetic_energy").max()


def test_time_and_geometry_belong_together():
    """In a flow that nothing drives from outside they cancel but for a few per cent; each by itself halves with dt."""
    parts = []
    for dt in (0.02, 0.01, 0.005):
        simulation = vortex_in_a_box(
            Vortex(0.001),
            16,
            dt,
            0.16,
            forced=False,
            stabilisation=0.0025 / dt,
            newton_tolerance=1e-10,
            acceleration_tolerance=1e-8,
        )
        parts.append([column(simulation, f"{name}_dissipation").sum() for name in ("time", "geometry")])
    of_time, geometry = np.array(parts).T
    for part in (of_time, geometry):
        np.testing.assert_allclose(part[:-1] / part[1:], 2, atol=0.2)
    assert (np.abs(of_time + geometry) < [0.12 * geometry[0], 0.06 * geometry[1], 0.03 * geometry[2]]).all()


@pytest.mark.slow(but=("0.8",))
@pytest.mark.parametrize("rho_inf", [0.0, 0.8])
def test_the_work_of_a_wall_that_slides_to_and_fro_is_what_is_dissipated(rho_inf):
    """Stokes' second problem, in periods after the first: of second order in the step, 53 % at 20 steps a period with
    forces of the step's end along its displacements. The power is U^2 sqrt(rho mu omega / 8) a metre."""
    nu, omega, speed = 1e-4, 2 * np.pi, 5e-3
    depth = np.sqrt(2 * nu / omega)
    fluid, errors = tp.Fluid("oil", 1000.0, 1000 * nu), []
    for steps in (20, 40):
        tank = tp.tank((4 * depth, 8 * depth), 0.5 * depth, periodic="x").fill(fluid)
        tank.wall("bottom", law="no-slip", velocity=lambda t: (speed * np.cos(omega * t), 0.0)).wall("top", slip=True)
        case = tp.Case(tank, [fluid], (0, 0), numerics=tp.Numerics(rho_inf=rho_inf))
        simulation = tp.Simulation(case, time_step=1 / steps)
        while simulation.time < 2 - 1e-9:
            simulation.step(2.0)
        last = [row for row in simulation.history if row["time"] > 1 + 1e-9]
        work, lost = (sum(row[name] for row in last) for name in ("external_work", "viscous_dissipation"))
        assert sum(abs(row["energy_residual"]) for row in last) < 1e-12 * lost
        assert lost == pytest.approx(4 * depth * speed**2 * np.sqrt(1000 * 1000 * nu * omega / 8), rel=0.1)
        errors.append(abs(work / lost - 1))
    assert errors[0] < 0.02
    assert errors[1] < 0.01


@pytest.mark.parametrize("rho_inf", [0.0, 0.8])
def test_momentum_changes_by_forces_alone(water, air, rho_inf, monkeypatch):
    """To 1e-8 of the impulse of gravity in the solve; remeshing is all that adds to it."""
    simulation = dam_break(water, air, rho_inf=rho_inf, **TIGHT)
    real, solved = simulation.solve, []

    def keep(*arguments):
        solved.append(real(*arguments))
        return solved[-1]

    monkeypatch.setattr(simulation, "solve", keep)
    for _ in range(60):
        mass = nodal_mass(simulation.mesh, simulation.state.material.density)
        simulation.step()
        row, old, new = simulation.history[-1], solved[-1].before.particles, solved[-1].particles
        weight, dt, kappa = mass.sum() * 9.81, row["time_step"], 0.5 - solved[-1].scheme.alpha_f
        assert abs(row["momentum_residual_x"]) + abs(row["momentum_residual_y"]) < 1e-8 * dt * weight
        change = mass @ (new.velocity - old.velocity + kappa * dt * (new.acceleration - old.acceleration))
        force = np.array([row["wall_force_x"], row["wall_force_y"] - weight])
        assert np.abs(change - dt * force).max() < 1e-8 * dt * weight
        now = nodal_mass(simulation.mesh, simulation.state.material.density) @ simulation.particles.velocity
        np.testing.assert_allclose([row["momentum_x"], row["momentum_y"]], now, rtol=1e-12)
        added = np.array([row["remeshing_momentum_x"], row["remeshing_momentum_y"]])
        np.testing.assert_allclose(added, now - mass @ new.velocity, atol=1e-12)
    assert len(solved) == 60
    assert np.abs(column(simulation, "remeshing_momentum_x")).sum() > 1e-4


@pytest.mark.parametrize("jitter", [0.0, 0.2])
def test_walls_bear_the_weight_of_a_fluid_at_rest(water, jitter):
    """It stays at rest on any mesh: the force of the walls is the weight, and that is all of it."""
    filled = tp.tank((0.1, 0.1), 0.005, jitter=jitter).fill(water)
    simulation = tp.Simulation(tp.Case(filled, [water], (0, -9.81), numerics=tp.Numerics(**TIGHT)), time_step=1e-3)
    weight = water.density * 0.01 * 9.81
    for _ in range(3):
        simulation.step()
        row = simulation.history[-1]
        assert row["wall_force_y"] == pytest.approx(weight, rel=1e-8)
        assert abs(row["wall_force_x"]) < 1e-8 * weight


def test_walls_bear_the_weight_of_layers_at_rest(water, air):
    """To within 0.5 %: the interface starts to move at once."""
    filled = tp.tank((0.1, 0.1), 0.005).fill(water).fill(air, box=((0, 0.05), (0.1, 0.1)))
    simulation = tp.Simulation(tp.Case(filled, [water, air], (0, -9.81)), time_step=1e-3)
    simulation.step()
    row = simulation.history[-1]
    weight = (water.density + air.density) * 0.005 * 9.81
    assert row["wall_force_y"] == pytest.approx(weight, rel=5e-3)
    assert abs(row["wall_force_x"]) < 5e-3 * weight


def test_volumes_add_up(water, air):
    """Solve and remeshing make up each step's change, to round-off; together the fluids fill the tank."""
    simulation = dam_break(water, air)
    source = 0.0
    untouched = 0
    while simulation.time < 0.08:
        mesh, fraction, before = simulation.mesh, simulation.state.material.fraction, simulation.state.volume
        fluid = simulation.particles.fluid  # of wall particles, remeshing may change it and nothing else
        simulation.step()
        row = simulation.history[-1]
        solve, remeshing, given = (
            np.array([row[f"{name}_volume_{fluid}"] for fluid in ("water", "air")])
            for name in ("solve", "remeshing", "source")
        )
        np.testing.assert_allclose(before + solve + remeshing, simulation.state.volume, rtol=0, atol=1e-14)
        assert row["volume_water"] == pytest.approx(simulation.volume("water"), rel=1e-13)
        for change in (solve, remeshing, given):
            assert abs(change.sum()) < 1e-14
        if row["relocated"] == 0:
            moved = mesh.moved(simulation.particles.position).measure @ fraction
            np.testing.assert_allclose(solve, moved - before, rtol=0, atol=1e-14)
            same = {*map(tuple, np.sort(mesh.cells))} == {*map(tuple, np.sort(simulation.mesh.cells))}
            if same and (simulation.particles.fluid == fluid).all():
                untouched += 1
                assert np.abs(remeshing).max() < 1e-14
        source += abs(given[0])
    assert untouched > 3
    assert source > 1e-6


def test_volumes_add_up_with_a_sharp_interface(water, air):
    """What the solve changes the remeshing undoes: every step ends with the volumes of the start."""
    simulation = dam_break(water, air, interface="sharp", pressure="continuous")
    start = before = simulation.state.volume
    while simulation.time < 0.08:
        simulation.step()
        row = simulation.history[-1]
        solve, remeshing = (
            np.array([row[f"{name}_volume_{fluid}"] for fluid in ("water", "air")]) for name in ("solve", "remeshing")
        )
        after = simulation.state.volume
        np.testing.assert_allclose(before + solve + remeshing, after, rtol=0, atol=1e-14)
        np.testing.assert_allclose(after, start, rtol=1e-10)
        before = after
    assert max(abs(row["solve_volume_water"]) for row in simulation.history) > 1e-8


def test_without_a_source_nothing_is_prescribed(water, air):
    """And the work of the source is none."""
    simulation = dam_break(water, air, volume_correction=0.0)
    for _ in range(30):
        simulation.step()
    assert not column(simulation, "source_volume_water").any()
    assert not column(simulation, "source_dissipation").any()


def test_a_step_refused_after_its_solve_leaves_no_trace(water, air, monkeypatch):
    """The budget is that of the step that was accepted."""
    simulation = dam_break(water, air)
    real, calls = simulation.remesher.remesh, itertools.count()

    def remesh(solved):
        state = real(solved)
        if next(calls) == 3:
            raise TriangulationError("for the test")
        return state

    monkeypatch.setattr(simulation.remesher, "remesh", remesh)
    for _ in range(6):
        before = simulation.state.volume[0]
        simulation.step()
        row = simulation.history[-1]
        assert abs(row["energy_residual"]) < 1e-6
        assert before + row["solve_volume_water"] + row["remeshing_volume_water"] == pytest.approx(row["volume_water"])
    assert simulation.history[3]["time_step"] == 5e-4


@pytest.mark.slow
@pytest.mark.benchmark
def test_the_budget_costs_little(water, air):
    """Less than 10 ms a step at 14 000 particles."""
    simulation = dam_break(water, air, 0.005)
    for _ in range(2):
        simulation.step()
    simulation.timings.reset()
    for _ in range(7):
        simulation.step()
    assert len(simulation.particles) > 13000
    assert simulation.timings.seconds["step/budget"] / 7 < 0.01
