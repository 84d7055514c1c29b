"""Flows between periodic sides, against closed forms and linear stability theory.

taylor-green   decaying vortices that a mean flow carries through the periodic sides: order of the error
channel        water set off between two plates by gravity along them, against the series for Poiseuille's flow
shear          Kelvin-Helmholtz instability of two viscous fluids: rate of growth, against stability.py
wave           a standing wave of water under air, a whole length of it: period and amplitude
vortex-box     decaying vortices carried at an angle through a box that is periodic in both directions: order, decay
layer-box      double shear layer in such a box: order of the error against a pseudo-spectral solution

summary.json   figures of all runs
shear.png      growth of the instability
box.png        vorticity of the double shear layer, and errors in the boxes

python -m tipfem demo validation/periodic --flow shear
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from tipfem.demos import harness
from tipfem.demos.support.figures import COLOURS, new_figure, save
from tipfem.demos.support.options import Arch, Counts, Several
from tipfem.demos.validation.periodic import box
from tipfem.demos.validation.periodic.stability import Mode, Shear, fastest
from tipfem.demos.validation.waves import run as waves

import tipfem as tp

Array = NDArray[np.float64]

# Particles along the vortex pair, across the channel, in the thickness of the shear layer, along half the wave, and
# along the boxes.
RESOLUTIONS = {"taylor-green": (16, 24, 32), "channel": (8, 16), "shear": (3, 6), "wave": (20, 40)}
RESOLUTIONS |= {"vortex-box": (16, 32, 64), "layer-box": (32, 64, 96)}
LEAST_ORDER = 1.8
LARGEST_DECAY_ERROR, LARGEST_ENERGY_ERROR = 2e-3, 5e-4  # of the boxes, at the finest resolution
LARGEST_CHANNEL_ERROR = 0.02  # of the mean velocity, at the finest resolution
LARGEST_GROWTH_ERROR = 0.05
DENSITIES = (1000.0, 500.0)  # of the shear layer's fluids [kg/m^3]
REYNOLDS, WAVE_NUMBER = 200.0, 0.44  # of the shear layer: rho_lower U delta / mu, k delta
START = 0.02  # amplitude of the shear layer's interface at the start [delta]
# A disturbance so small beside a spacing has errors that limit no step: in steps of two spacings, the default where
# forces drive a flow, it grows 11 and 3 % too slowly, with 3 and 6 particles in delta.
RESOLVED = tp.Numerics(largest_move=0.5)


def taylor_green(across: int) -> dict[str, Any]:
    """A pair of vortices between walls that slip, carried once along half of the domain: error of the velocity.

    u = U + e sin k(x - U t) cos k y, v = -e cos k(x - U t) sin k y with e = exp(-2 nu k^2 t).
    """
    width, carried, nu, end = 1.0, 1.0, 0.02, 0.5
    k = 2 * math.pi / width

    def velocity(x: Array, time: float) -> Array:
        phase, part = k * (x[:, 0] - carried * time), math.exp(-2 * nu * k**2 * time)
        u = part * np.sin(phase) * np.cos(k * x[:, 1])
        return np.stack([carried + u, -part * np.cos(phase) * np.sin(k * x[:, 1])], axis=1)

    fluid = tp.Fluid("fluid", density=1.0, viscosity=nu)
    tank = tp.tank((width, width / 2), width / across, periodic="x")
    tank.fill(fluid, velocity=lambda x: velocity(x, 0.0)).wall("bottom", slip=True).wall("top", slip=True)
    simulation = tp.Simulation(tp.Case(tank, [fluid], (0, 0)), time_step=0.16 / across)
    simulation.run(end, progress=False)
    particles, mass, history = simulation.particles, simulation.state.mass, simulation.history
    error = ((particles.velocity - velocity(particles.position, end)) ** 2).sum(axis=1)
    momentum = np.array([row["momentum_x"] for row in history])
    return {
        "error": math.sqrt((mass * error).sum() / mass.sum()) / math.exp(-2 * nu * k**2 * end),
        "momentum": float(np.ptp(momentum) / momentum[0]),
        "volume": abs(history[-1]["volume_fluid"] / (width**2 / 2) - 1),
        "krylov_iterations": float(np.mean([row["krylov_iterations"] for row in history])),
    }


def channel(across: int) -> dict[str, Any]:
    """A fluid set off from rest by gravity along a channel of height H: profile at t = 0.1 and 0.6 H^2 / nu."""
    height, nu, gravity = 1.0, 1.0, 12.0  # so that the mean velocity becomes 1

    def profile(y: Array, time: float) -> Array:
        u = gravity / (2 * nu) * y * (height - y)
        for n in range(1, 100, 2):
            part = math.exp(-nu * (n * math.pi / height) ** 2 * time)
            u = u - 4 * gravity * height**2 / (nu * (n * math.pi) ** 3) * part * np.sin(n * math.pi * y / height)
        return np.asarray(u)

    fluid = tp.Fluid("fluid", density=1.0, viscosity=nu)
    tank = tp.tank((height, height), height / across, periodic="x").fill(fluid)
    simulation = tp.Simulation(tp.Case(tank, [fluid], (gravity, 0.0)), time_step=0.1 / across)
    errors = []
    for end in (0.1, 0.6):
        simulation.run(end, progress=False)
        x, v = simulation.particles.position, simulation.particles.velocity
        errors.append(math.sqrt(np.mean((v[:, 0] - profile(x[:, 1], end)) ** 2 + v[:, 1] ** 2)))
    return {"errors": errors, "krylov_iterations": float(simulation.history[-1]["krylov_iterations"])}


def shear_flow(tension: float = 0.0) -> tuple[Shear, Mode]:
    """U tanh(y / delta) with U = 1 m/s and delta = 0.1 m between walls five delta away, and its fastest mode.

    Args:
        tension: of the interface [N/m].
    """
    delta, speed = 0.1, 1.0
    flow = Shear(
        5 * delta,
        DENSITIES,
        DENSITIES[0] * speed * delta / REYNOLDS,
        lambda y: speed * np.tanh(y / delta),
        lambda y: speed / delta / np.cosh(y / delta) ** 2,
        lambda y: -2 * speed / delta**2 * np.tanh(y / delta) / np.cosh(y / delta) ** 2,
        tension=tension,
    )
    return flow, fastest(flow, WAVE_NUMBER / delta)


def interface_mode(simulation: tp.Simulation, k: float) -> complex:
    """Amplitude of e^{ikx} in the height of the interface over the middle [m], by an integral over its edges."""
    mesh = simulation.mesh
    assert mesh.fluid is not None
    cell, i = np.nonzero((mesh.neighbours >= 0) & (mesh.fluid[:, None] == 0) & (mesh.fluid[mesh.neighbours] == 1))
    first, second = mesh.cells[cell, (i + 1) % 3], mesh.cells[cell, (i + 2) % 3]
    edge = mesh.sides(first, second)  # with the lower fluid on the left
    middle = mesh.position[first] + 0.5 * edge
    height = middle[:, 1] - 0.5 * np.ptp(mesh.position[:, 1])
    return complex(2 / mesh.period.width[0] * (-edge[:, 0] * height * np.exp(-1j * k * middle[:, 0])).sum())


def shear(across: int, duration: float = 12.0, tension: float = 0.0) -> dict[str, Any]:
    """The instability from its linear mode, with ``across`` particles in delta: growth of the interface's amplitude.

    Args:
        across: particles in delta.
        duration: in delta / U.
        tension: of the interface [N/m].
    """
    flow, mode = shear_flow(tension)
    k, delta, middle = mode.wave_number, 0.1, flow.height
    start = START * delta
    lower, upper = (
        tp.Fluid(name, density=rho, viscosity=flow.viscosity)
        for name, rho in zip(("lower", "upper"), flow.density, strict=True)
    )

    def initial(layer: int, x: Array) -> Array:
        y = x[:, 1] - middle
        inside = np.clip(y, -flow.height if layer == 0 else 0.0, 0.0 if layer == 0 else flow.height)
        v = start * mode.velocity(layer, x[:, 0], inside)
        v[:, 0] += flow.velocity(y)
        return v

    def force(x: Array, time: float) -> Array:
        y = x[:, 1] - middle
        along = -flow.viscosity * flow.curvature(y) / np.where(y < 0, *flow.density)
        return np.stack([along, np.zeros(len(x))], axis=1)

    tank = tp.tank((2 * math.pi / k, 2 * flow.height), delta / across, periodic="x")
    tank.fill(upper, velocity=lambda x: initial(1, x))
    below = lambda x: x[:, 1] <= middle + start * np.cos(k * x[:, 0])  # noqa: E731
    tank.fill(lower, where=below, velocity=lambda x: initial(0, x))
    tank.wall("bottom", slip=True).wall("top", slip=True)
    given = {("lower", "upper"): tension} if tension else None
    case = tp.Case(tank, [lower, upper], (0, 0), body_force=force, surface_tension=given, numerics=RESOLVED)
    simulation = tp.Simulation(case)
    course = [(0.0, interface_mode(simulation, k))]
    while simulation.time < duration * delta:
        simulation.step()
        course.append((simulation.time, interface_mode(simulation, k)))
    time, amplitude = np.array([t for t, _ in course]), np.array([a for _, a in course])
    late = time > time[-1] / 3
    growth = np.polyfit(time[late], np.log(np.abs(amplitude[late])), 1)[0]
    speed = -np.polyfit(time[late], np.unwrap(np.angle(amplitude[late])), 1)[0] / k
    return {
        "growth": growth * delta,
        "theory": mode.growth * delta,
        "error": growth / mode.growth - 1,
        "speed": speed,
        "theory_speed": mode.speed.real,
        "volume": abs(simulation.history[-1]["volume_lower"] / simulation.history[0]["volume_lower"] - 1),
        "course": [[t / delta, abs(a) / start] for t, a in zip(time.tolist(), amplitude.tolist(), strict=True)],
    }


def wave(across: int, periods: float = 2.0) -> dict[str, Any]:
    """The standing wave of `tipfem.demos.validation.waves`, a whole length of it and without side walls."""
    water, height, width = waves.FLOWS["water"][0], waves.FLOWS["water"][1] * 2 * waves.LENGTH, 2 * waves.LENGTH
    k, spacing = 2 * math.pi / width, waves.LENGTH / across
    tank = tp.tank((width, waves.LENGTH), spacing, periodic="x").fill(waves.AIR)
    tank.fill(water, where=lambda x: x[:, 1] < waves.LENGTH / 2 + height * np.cos(k * x[:, 0]))
    tank.wall("bottom", slip=True).wall("top", slip=True)
    case = tp.Case(tank, [water, waves.AIR], (0, -waves.GRAVITY))
    simulation = tp.Simulation(case, time_step=waves.TIME_STEP * math.sqrt(spacing / waves.GRAVITY))
    course = [(0.0, interface_mode(simulation, k).real)]
    while simulation.time < periods * waves.period(water):
        simulation.step()
        course.append((simulation.time, interface_mode(simulation, k).real))
    peaks = waves.extremes(*(np.array(course) / [1.0, course[0][1]]).T)
    return {
        "period": 2 * peaks[-1, 0] / len(peaks) / waves.period(water) if len(peaks) else math.nan,
        "peaks": peaks[:, 1].tolist(),
        "error": waves.peak_error(water, height, peaks),
    }


def without_fields(result: dict[str, Any]) -> dict[str, Any]:
    """The figures of a run, and its course, without the vorticity of all particles."""
    return {name: value for name, value in result.items() if name != "vorticity"}


def _numbers(result: dict[str, Any]) -> dict[str, Any]:
    """The figures of a run that are printed, without courses and fields."""
    return {name: value for name, value in result.items() if name not in ("course", "vorticity")}


MEASURES = {"taylor-green": taylor_green, "channel": channel, "shear": shear, "wave": wave}
MEASURES |= {"vortex-box": box.vortex_box, "layer-box": box.layer_box}
Flow = Literal["taylor-green", "channel", "shear", "wave", "vortex-box", "layer-box"]
ORDERED = ("taylor-green", "vortex-box", "layer-box")


def check(flow: str, results: dict[int, dict[str, Any]]) -> list[str]:
    """What the runs of a flow, by their resolutions, miss of what is expected; an empty list when all is well."""
    missed, finest = [], max(results)
    if flow in ORDERED:
        errors = [results[n]["error"] for n in sorted(results)]
        order = -np.polyfit(np.log(sorted(results)), np.log(errors), 1)[0] if len(errors) > 1 else LEAST_ORDER
        if not order >= LEAST_ORDER:
            missed.append(f"{flow}: order {order:.2f}, not {LEAST_ORDER}")
        missed += [
            f"{flow}, {n} across: {name} changes by {r[name]:.1e}"
            for n, r in results.items()
            for name in ("momentum", "volume")
            if not r[name] <= 1e-12
        ]
    for name, largest in (("decay", LARGEST_DECAY_ERROR), ("energy", LARGEST_ENERGY_ERROR)):
        if name in results[finest] and not abs(results[finest][name]) <= largest:
            missed.append(f"{flow}, {finest} across: the {name} is off by {results[finest][name]:.1e}")
    if flow == "channel" and not np.max(results[finest]["errors"]) <= LARGEST_CHANNEL_ERROR:
        missed.append(f"{flow}: errors {results[finest]['errors']}, not {LARGEST_CHANNEL_ERROR:.0%} at most")
    if flow == "shear":
        for n, r in results.items():
            if not abs(r["error"]) <= LARGEST_GROWTH_ERROR:
                missed.append(f"{flow}, {n} in delta: growth is {r['error']:+.1%} off")
            if not r["volume"] <= 1e-12:
                missed.append(f"{flow}, {n} in delta: volume changes by {r['volume']:.1e}")
    if flow == "wave":
        for n, r in results.items():
            allowed = [error for across, error in waves.LARGEST_ERRORS.items() if n >= across]
            if not abs(r["period"] - 1) <= waves.LARGEST_PERIOD_ERROR:
                missed.append(f"{flow}, {n} across: the period is {r['period']:.3f} of theory's")
            if allowed and not r["error"] <= allowed[-1]:
                missed.append(f"{flow}, {n} across: an amplitude is {r['error']:.2%} from theory")
    return missed


def plot(path: Path, results: dict[int, dict[str, Any]]) -> None:
    """Draw the growth of the shear layer's interface.

    Raises:
        ImportError: there is no matplotlib.
    """
    figure = new_figure(6.5, 4.2)
    axes = figure.add_subplot()
    for number, (across, result) in enumerate(sorted(results.items())):
        t, a = np.array(result["course"]).T
        axes.semilogy(t, a, color=COLOURS[number], label=f"{across} particles in the thickness")
    axes.semilogy(t, np.exp(result["theory"] * t), "k--", linewidth=1, label="linear theory, viscous")
    axes.set_xlabel("t U / thickness")
    axes.set_ylabel("amplitude of the interface / that of the start")
    axes.grid(alpha=0.3)
    axes.legend()
    save(figure, path)


def plot_boxes(path: Path, flows: dict[str, dict[int, dict[str, Any]]]) -> None:
    """Draw the vorticity of the finest double shear layer, and the errors of the velocity over the spacing.

    Raises:
        ImportError: there is no matplotlib.
    """
    figure = new_figure(10, 4.6)
    left, right = figure.subplots(1, 2)
    finest = flows["layer-box"][max(flows["layer-box"])]
    position, cells, rate = finest["vorticity"]
    limit = float(np.abs(rate).max())
    drawn = left.tripcolor(*position.T, cells, rate, cmap="RdBu_r", vmin=-limit, vmax=limit)
    left.set(xlim=(0, box.WIDTH), ylim=(0, box.WIDTH), aspect="equal", xlabel="x [m]", ylabel="y [m]")
    left.set_title(f"vorticity of the double shear layer, t = {box.LAYER_END:g} s")
    figure.colorbar(drawn, ax=left, label="vorticity [1/s]", shrink=0.9)
    for number, (flow, results) in enumerate(flows.items()):
        spacing = np.array([box.WIDTH / n for n in sorted(results)])
        errors = [results[n]["error"] for n in sorted(results)]
        right.loglog(spacing, errors, "os"[number % 2] + "-", color=COLOURS[number], label=flow)
    right.loglog(spacing, errors[-1] * (spacing / spacing[-1]) ** 2, "k--", linewidth=1, label="second order")
    right.set(xlabel="spacing [m]", ylabel="error of the velocity")
    right.grid(alpha=0.3)
    right.legend()
    save(figure, path)


def main(
    *,
    flow: Several[Flow] | None = None,
    across: Counts | None = None,
    arch: Arch = "cpu",
    out: Path = Path("out/validation/periodic"),
) -> int:
    """Run the flows at all resolutions.

    Args:
        flow: which flows; by default all.
        across: resolutions, of all flows; by default each has its own.
        arch: where the kernels run.
        out: folder for the results.
    """
    tp.init(arch=arch)
    out.mkdir(parents=True, exist_ok=True)
    runs: dict[str, dict[int, dict[str, Any]]] = {}
    for name in flow or MEASURES:
        runs[name] = {}
        for n in across or RESOLUTIONS[name]:
            runs[name][n] = MEASURES[name](n)
            print(name, n, _numbers(runs[name][n]))
    drawn = {name: runs[name] for name in ("vortex-box", "layer-box") if name in runs}
    if "layer-box" in drawn:
        plot_boxes(out / "box.png", drawn)
    if "shear" in runs:
        plot(out / "shear.png", runs["shear"])
    kept = {name: {n: without_fields(result) for n, result in results.items()} for name, results in runs.items()}
    return harness.report(out, kept, [text for name in runs for text in check(name, runs[name])])


if __name__ == "__main__":
    harness.command(__name__)
