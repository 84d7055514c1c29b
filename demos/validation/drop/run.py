"""A free drop that is stretched, and one that turns too, against the motion of an ellipse.

A disc of radius R without viscosity, gravity or surface tension begins with a velocity that is linear in the place,
(a x - w y, w x - a y). It stays so, and the disc becomes an ellipse: x = F(t) X with

    F'' = q F^-T,    q = tr(G^2) / |F^-1|^2,    G = F' F^-1,    p = rho q (R^2 - |X|^2) / 2,

for the area det F is constant (M. S. Longuet-Higgins, J. Fluid Mech. 55, 1972). With |w| < |a| the drop is
under pressure; one that only turns is under tension and flies apart, see README.md.

summary.json   figures of all runs
drop.png       the turning drop and the ellipse, and the errors over the spacing

python -m tipfem demo validation/drop --flow stretching
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from tipfem.demos import harness
from tipfem.demos.support.figures import COLOURS, new_figure, save
from tipfem.demos.support.options import Arch, Counts, Several

import tipfem as tp

Array = NDArray[np.float64]

RADIUS, DENSITY, SIDE = 0.2, 1000.0, 1.2  # of the drop [m], [kg/m^3]; of the tank around it [m]
STRAIN, END = 1.0, 1.0  # a [1/s], end of the runs [s]
TURNING = {"stretching": 0.0, "turning": 0.5}  # w [1/s]
RESOLUTIONS = (8, 16, 32)  # particles in the radius
LARGEST = {"velocity": 0.008, "axis": 0.005, "energy": 0.005, "volume": 1e-12, "angular_momentum": 1e-12}
LARGEST |= {"momentum": 1e-12}


def ellipse(spin: float, time: float) -> tuple[Array, Array, float]:
    """F (2, 2), F' (2, 2) [1/s] and q [1/s^2] at a time, of a drop with w = ``spin`` [1/s]."""

    def rate(_: float, y: Array) -> Array:
        f, velocity = y.reshape(2, 2, 2)
        inverse = np.linalg.inv(f)
        g = velocity @ inverse
        return np.stack([velocity, np.trace(g @ g) / (inverse**2).sum() * inverse.T]).ravel()

    start = np.stack([np.eye(2), [[STRAIN, -spin], [spin, -STRAIN]]]).ravel()
    y = solve_ivp(rate, (0.0, time), start, rtol=1e-11, atol=1e-12).y[:, -1]
    f, velocity = y.reshape(2, 2, 2)
    return f, velocity, float((rate(0.0, y).reshape(2, 2, 2)[1] @ f.T)[0, 0])


def start(across: int, spin: float) -> tp.Simulation:
    """The drop with ``across`` particles in its radius, at the start."""
    middle, spacing = np.full(2, SIDE / 2), RADIUS / across
    gradient = np.array([[STRAIN, -spin], [spin, -STRAIN]])
    fluid = tp.Fluid("drop", density=DENSITY, viscosity=0.0)
    tank = tp.tank((SIDE, SIDE), spacing)
    tank.fill(fluid, disc=(middle.tolist(), RADIUS), velocity=lambda x: (x - middle) @ gradient.T)
    return tp.Simulation(tp.Case(tank, [fluid], (0, 0), free_surface=True), time_step=0.2 / across)


def moments(simulation: tp.Simulation) -> tuple[Array, float]:
    """Momentum (2,) [N s/m] and angular momentum about the middle of the tank [N s]."""
    m, v, x = simulation.state.mass, simulation.particles.velocity, simulation.particles.position - SIDE / 2
    return m @ v, float(m @ (x[:, 0] * v[:, 1] - x[:, 1] * v[:, 0]))


def drop(across: int, spin: float) -> dict[str, Any]:
    """Errors of the velocity, the longer semi-axis and the pressure at `END`, and what has been lost.

    Args:
        across: particles in the radius.
        spin: w [1/s].
    """
    simulation = start(across, spin)
    momentum, turned = moments(simulation)
    area, energy = simulation.volume("drop"), simulation.energy().kinetic
    worst = 0.0
    while simulation.time < END:
        simulation.step(END)
        worst = max(worst, abs(moments(simulation)[1] - turned))
    f, rate, q = ellipse(spin, END)
    m, particles = simulation.state.mass, simulation.particles
    x = particles.position - SIDE / 2
    error = particles.velocity - x @ (rate @ np.linalg.inv(f)).T
    second = (x * m[:, None]).T @ x / m.sum()
    axis = 2 * math.sqrt(float(np.linalg.eigvalsh(second)[-1]))
    inside = ((x @ np.linalg.inv(f).T) ** 2).sum(axis=1)
    pressure = DENSITY * q * (RADIUS**2 - inside) / 2
    wet = simulation.mesh.used & (inside < RADIUS**2)
    scale = STRAIN * RADIUS
    return {
        "velocity": math.sqrt((m * (error**2).sum(axis=1)).sum() / m.sum()) / scale,
        "axis": axis / (RADIUS * float(np.linalg.norm(f, 2))) - 1,
        "pressure": float(np.sqrt(np.mean((particles.pressure - pressure)[wet] ** 2)) / (DENSITY * q * RADIUS**2 / 2)),
        "energy": simulation.energy().kinetic / energy - 1,
        "volume": abs(simulation.volume("drop") / area - 1),
        "momentum": float(np.abs(moments(simulation)[0] - momentum).max() / (m.sum() * scale)),
        "angular_momentum": worst / (m.sum() * scale * RADIUS),
        "spray": int(simulation.mesh.surface.loose.sum()),
        "shape": (particles.position, simulation.mesh.cells),
    }


def check(flow: str, results: dict[int, dict[str, Any]]) -> list[str]:
    """What the runs of a flow, by their resolutions, miss of what is expected; an empty list when all is well."""
    finest = max(results)
    found = {name: abs(results[finest][name]) for name in LARGEST}
    missed = [
        f"{flow}, {finest}: {name} {found[name]:.1e}" for name, most in LARGEST.items() if not found[name] <= most
    ]
    coarsest = min(results)
    for name in ("velocity", "axis"):
        if finest > coarsest and not found[name] < abs(results[coarsest][name]):
            missed.append(f"{flow}: error of the {name} at {finest} not below that at {coarsest}")
    return missed


def plot(path: Path, summary: dict[str, dict[int, dict[str, Any]]]) -> None:
    """Draw the last drop with the ellipse, and the errors of the velocity over the spacing.

    Raises:
        ImportError: there is no matplotlib.
    """
    figure = new_figure(10, 4.4)
    left, right = figure.subplots(1, 2)
    flow, results = list(summary.items())[-1]
    position, cells = results[max(results)]["shape"]
    left.triplot(*position.T, cells, color=COLOURS[0], linewidth=0.4)
    angle = np.linspace(0, 2 * math.pi, 200)
    circle = RADIUS * np.stack([np.cos(angle), np.sin(angle)])
    left.plot(*(circle + SIDE / 2), "k:", linewidth=1, label="start")
    left.plot(*(ellipse(TURNING[flow], END)[0] @ circle + SIDE / 2), "k-", linewidth=1.2, label="ellipse")
    left.set(aspect="equal", xlim=(0.05, 1.15), ylim=(0.2, 1.0), xlabel="x [m]", ylabel="y [m]")
    left.set_title(f"{flow} drop, {max(results)} particles in the radius, t = {END:g} s")
    left.legend(loc="upper left")
    for number, (name, runs) in enumerate(summary.items()):
        spacing = np.array([RADIUS / n for n in sorted(runs)])
        for key, style in (("velocity", "o-"), ("axis", "s--")):
            errors = [abs(runs[n][key]) for n in sorted(runs)]
            right.loglog(spacing, errors, style, color=COLOURS[number], label=f"{name}: {key}")
    right.set(xlabel="spacing [m]", ylabel="relative error at the end")
    right.grid(alpha=0.3)
    right.legend()
    save(figure, path)


def main(
    *,
    flow: Several[Literal["stretching", "turning"]] = ("stretching", "turning"),
    across: Counts = RESOLUTIONS,
    arch: Arch = "cpu",
    out: Path = Path("out/validation/drop"),
) -> int:
    """Run the drops at all resolutions.

    Args:
        flow: which flows.
        across: particles in the radius.
        arch: where the kernels run.
        out: folder for the results.
    """
    tp.init(arch=arch)
    out.mkdir(parents=True, exist_ok=True)
    runs: dict[str, dict[int, dict[str, Any]]] = {}
    figures: dict[str, Any] = {}
    for name in flow:
        runs[name], figures[name] = {}, {}
        for n in across:
            runs[name][n] = drop(n, TURNING[name])
            figures[name][n] = {key: value for key, value in runs[name][n].items() if key != "shape"}
            print(name, n, figures[name][n], flush=True)
    plot(out / "drop.png", runs)
    return harness.report(out, figures, [text for name in runs for text in check(name, runs[name])])


if __name__ == "__main__":
    harness.command(__name__)
