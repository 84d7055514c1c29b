"""Channels of one fluid, or of two that flow side by side, between an inlet and an outlet."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import LinearNDInterpolator

import tipfem as tp

Array = NDArray[np.float64]


def advance(simulation: tp.Simulation, end: float) -> tp.Simulation:
    """The simulation at a time [s]."""
    while simulation.time < end:
        simulation.step(end)
    return simulation


def refused(simulation: tp.Simulation) -> int:
    """Steps that were refused at first."""
    return int(sum(row["refused_steps"] for row in simulation.history))


def uniform(across: int, angle: float = 0.4) -> dict[str, float]:
    """Largest error of the velocity while a uniform flow passes a channel that is inclined to the lattice."""
    width, length = 0.16, 0.3
    turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    corners = np.array([(0, 0), (length, 0), (length, width), (0, width)]) @ turn
    fluid = tp.Fluid("fluid", density=1.0, viscosity=0.01)
    shape = tp.shapes.polygon(corners.tolist(), names=["below", "out", "above", "in"])
    tank = tp.tank(shape=shape, spacing=width / across).fill(fluid, velocity=turn[0])
    for name in ("below", "above"):
        tank.wall(name, slip=True)
    openings = [tp.Inlet(wall="in", fluid=fluid, velocity=1.0), tp.Outlet(wall="out")]
    exact = tp.Numerics(newton_tolerance=1e-11)
    simulation = tp.Simulation(tp.Case(tank, [fluid], (0, 0), openings=openings, numerics=exact), time_step=1e-2)
    worst = 0.0
    while simulation.time < 10 * length:
        simulation.step()
        worst = max(worst, float(np.abs(simulation.particles.velocity - turn[0]).max()))
    return {"velocity": worst, "refused": refused(simulation)}


def poiseuille(across: int, end: float = 0.8) -> dict[str, float]:
    """Errors of the velocity, over the mean one, and of the pressure gradient, in the second half of a run.

    Args:
        across: spacings in the width of the channel.
        end: of the run [s]; the fluid passes in 0.4 s.
    """
    height, length, speed, fluid = 0.2, 0.4, 1.0, tp.Fluid("fluid", density=1.0, viscosity=0.01)
    tank = tp.tank((length, height), height / across).fill(fluid)
    for side in tank.sides:
        tank.wall(side, law="no-slip")
    openings = [
        tp.Inlet(wall="left", fluid=fluid, velocity=speed, profile="parabola", ramp=0.1),
        tp.Outlet(wall="right"),
    ]
    simulation = tp.Simulation(tp.Case(tank, [fluid], (0, 0), openings=openings), time_step=0.1 / across)
    advance(simulation, 0.5 * end)
    slopes, errors, weights = [], [], []
    while simulation.time < end:
        simulation.step(end)
        p, r = simulation.particles, simulation.particles.position[:, 1] / height
        error = p.velocity - np.stack([6 * speed * r * (1 - r), 0 * r], axis=1)
        inside = (p.position[:, 0] > 0.2 * length) & (p.position[:, 0] < 0.9 * length)
        slopes.append(float(np.polyfit(p.position[inside, 0], p.pressure[inside], 1)[0]))
        errors.append(float((error**2).sum(axis=1).mean()))
        weights.append(simulation.history[-1]["time_step"])
    exact = -12 * fluid.viscosity * speed / height**2
    mean = float(np.average(slopes, weights=weights))
    return {
        "velocity": math.sqrt(np.average(errors, weights=weights)) / speed,
        "gradient": mean / exact - 1,
        "gradient of single states": float(np.std(slopes)) / abs(exact),
        "refused": refused(simulation),
    }


def layers(across: int) -> dict[str, float]:
    """Two liquids side by side, the upper one a fifth as viscous: errors of the velocity, and of their interface."""
    height, length, gradient, mu = 0.2, 0.4, -1.0, (0.05, 0.01)
    lower, upper = (tp.Fluid(name, density=rho, viscosity=m) for name, rho, m in zip("ab", (1.0, 0.9), mu, strict=True))
    # mu u'' = gradient in both, no slip at 0 and H, u and mu u' continuous at the middle.
    half = 0.5 * height
    a = np.array([[half, -half + height], [mu[0], -mu[1]]])
    b = np.array([-gradient / 2 * half**2 / mu[0] + gradient / 2 * (half**2 - height**2) / mu[1], 0.0])
    c = np.linalg.solve(a, b)

    def profile(y: Array) -> Array:
        below = gradient / (2 * mu[0]) * y**2 + c[0] * y
        above = gradient / (2 * mu[1]) * (y**2 - height**2) + c[1] * (y - height)
        return np.asarray(np.where(y < half, below, above))

    scale = float(profile(np.linspace(0, height, 201)).max())
    tank = tp.tank((length, height), height / across)
    tank.fill(upper, velocity=lambda x: np.stack([profile(x[:, 1]), 0 * x[:, 1]], axis=1))
    tank.fill(
        lower,
        box=((0, 0), (length, half)),
        velocity=lambda x: np.stack([profile(x[:, 1]), 0 * x[:, 1]], axis=1),
    )
    for side in tank.sides:
        tank.wall(side, law="no-slip")
    openings = [
        tp.Inlet(wall="left", fluid=lambda x, t: np.where(x[:, 1] < half, 0, 1), profile=lambda s, t: profile(s)),
        tp.Outlet(wall="right", pressure="hydrostatic", direction="normal"),
    ]
    case = tp.Case(tank, [lower, upper], (0, -9.81), openings=openings)
    simulation = advance(tp.Simulation(case, time_step=0.1 / across), 3 * length / scale)
    p, mesh = simulation.particles, simulation.mesh
    error = p.velocity[:, 0] - profile(p.position[:, 1])
    cells = mesh.cells[np.asarray(mesh.fluid) == 0]
    other = mesh.cells[np.asarray(mesh.fluid) == 1]
    between = np.intersect1d(cells, other)
    return {
        "velocity": float(np.sqrt((error**2).mean())) / scale,
        "interface": float(np.abs(p.position[between, 1] - half).max()) / height,
        "refused": refused(simulation),
    }


def vortex(across: int) -> dict[str, float]:
    """Part of a vortex' energy that is left when it has passed an outlet.

    A vortex of no circulation, v = v0 (r / R) exp((1 - r^2 / R^2) / 2), goes with a uniform flow of 1 m/s through a
    channel of slip walls, ten radii wide.
    """
    side, radius, strength, middle = 1.0, 0.1, 0.25, np.array([0.5, 0.5])
    fluid = tp.Fluid("fluid", density=1.0, viscosity=1e-5)

    def velocity(x: Array) -> Array:
        r = (x - middle) / radius
        part = strength * np.exp(0.5 * (1 - (r**2).sum(axis=1)))[:, None]
        return np.asarray([1.0, 0.0] + part * np.stack([-r[:, 1], r[:, 0]], axis=1))

    tank = tp.tank((side, side), side / across).fill(fluid, velocity=velocity)
    for name in ("top", "bottom"):
        tank.wall(name, slip=True)
    openings = [tp.Inlet(wall="left", fluid=fluid, velocity=1.0), tp.Outlet(wall="right")]
    simulation = tp.Simulation(tp.Case(tank, [fluid], (0, 0), openings=openings), time_step=0.3 / across)

    def energy() -> float:
        v = simulation.particles.velocity - [1.0, 0.0]
        return 0.5 * float(simulation.state.mass @ (v**2).sum(axis=1))

    start = energy()
    before = advance(simulation, 0.2) and energy()
    advance(simulation, 1.2)
    return {"inside": before / start, "left": energy() / start, "refused": refused(simulation)}


def step(across: int, reynolds: float = 100.0, length: float = 9.0, end: float = 60.0) -> dict[str, float]:
    """Reattachment behind a backward step, over its height, where the channel becomes twice as high.

    Re = 2 h U / nu with the channel's height h before the step.

    Args:
        across: spacings in the step's height.
        reynolds: number.
        length: of the channel behind it, in heights of the step.
        end: of the run, in heights over the mean speed; figures are means over its last fifth.
    """
    before, after, h = 2.0, length, 1.0
    fluid = tp.Fluid("fluid", density=1.0, viscosity=2 * h / reynolds)
    corners = [(0, 0), (after, 0), (after, 1 + h), (-before, 1 + h), (-before, 1), (0, 1)]
    names = ["floor", "out", "roof", "in", "shelf", "face"]
    tank = tp.tank(shape=tp.shapes.polygon(corners, names=names), spacing=1 / across).fill(fluid)
    for name in ("floor", "roof", "shelf", "face"):
        tank.wall(name, law="no-slip")
    openings = [
        tp.Inlet(wall="in", fluid=fluid, velocity=1.0, profile="parabola", ramp=1.0),
        tp.Outlet(wall="out"),
    ]
    simulation = advance(tp.Simulation(tp.Case(tank, [fluid], (0, 0), openings=openings), time_step=0.05), 0.8 * end)
    x, found = np.linspace(0.5, after - 0.5, 400), []
    while simulation.time < end:
        simulation.step(end)
        p, ends = simulation.particles, []
        along = LinearNDInterpolator(p.position, p.velocity[:, 0])
        for y in (0.5 / across, 1.0 / across):
            u = along(np.stack([x, np.full_like(x, y)], axis=1))
            last = int(np.flatnonzero(u < 0)[-1]) if (u < 0).any() else 0
            ends.append(x[last] + (x[last + 1] - x[last]) * u[last] / (u[last] - u[last + 1]))
        # Where the line on which the velocity is zero meets the floor.
        found.append(2 * ends[0] - ends[1])
    return {
        "reattachment": float(np.mean(found)),
        "of single states": float(np.std(found)),
        "refused": refused(simulation),
    }


def cylinder(across: int, reynolds: float = 100.0, end: float = 5.0, length: float = 1.1) -> dict[str, float]:
    """The cylinder of Schaefer and Turek in its channel: mean drag, amplitude of the lift, Strouhal number.

    Args:
        across: spacings in the diameter.
        reynolds: 20 for the steady flow, 100 for that which sheds vortices.
        end: of the run [s]; figures are those of its last two fifths.
        length: of the channel, 2.2 m in the benchmark [m].
    """
    height, diameter, speed = 0.41, 0.1, reynolds / 100
    fluid = tp.Fluid("fluid", density=1.0, viscosity=1e-3)
    fine = diameter / across

    def near(x: Array) -> Array:
        r = np.hypot(x[:, 0] - 0.2, x[:, 1] - 0.2) - 0.5 * diameter
        wake = np.hypot(np.maximum(x[:, 0] - 0.2, 0.0) / 4, x[:, 1] - 0.2) - 0.5 * diameter
        return np.asarray(np.clip(fine + 0.08 * np.maximum(np.minimum(r, wake), 0.0), fine, 2 * fine))

    cylinder = tp.Body(tp.shapes.circle((0.2, 0.2), 0.5 * diameter), law="no-slip")
    tank = tp.tank((length, height), fine).fill(fluid).add(cylinder)
    for name in ("top", "bottom"):
        tank.wall(name, law="no-slip")
    openings = [
        tp.Inlet(wall="left", fluid=fluid, velocity=speed, profile="parabola", ramp=0.2),
        tp.Outlet(wall="right"),
    ]
    numerics = tp.Numerics(mass="consistent")  # by which vortices keep more of their energy
    case = tp.Case(tank, [fluid], (0, 0), openings=openings, grading=tp.Grading(where=near), numerics=numerics)
    simulation = advance(tp.Simulation(case, time_step=0.01), end)
    rows = [row for row in simulation.history if row["time"] > 0.6 * end]
    time, step = np.array([row["time"] for row in rows]), np.array([row["time_step"] for row in rows])
    scale = 0.5 * speed**2 * diameter
    drag, lift = (np.array([row[f"body_force_{axis}"] for row in rows]) / scale for axis in "xy")
    mean, middle = float(drag @ step / step.sum()), float(lift @ step / step.sum())
    # Forces of single steps are noisy: the wave that fits the lift best, among those of possible frequencies.
    found = []
    for frequency in np.linspace(1.5, 5.0, 701) if reynolds > 50 else ():
        wave = np.exp(-2j * math.pi * frequency * time)
        found.append((2 * abs(((lift - middle) * step) @ wave) / step.sum(), frequency))
    amplitude, frequency = max(found, default=(middle, math.nan))
    return {
        "drag": mean,
        "lift": float(amplitude),
        "strouhal": diameter / speed * float(frequency),
        "refused": refused(simulation),
    }
