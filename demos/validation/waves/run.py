"""Standing waves between two fluids: periods, amplitudes, and the energy that numerics give or take.

A square tank with walls that slip, filled half with one fluid and half with a lighter one. Their interface starts as
half a cosine, at rest. Water under air is hardly damped; a viscous liquid under air loses a third of its amplitude in
half a period; between two liquids the flow along the interface jumps. Without surface tension, with k = pi / L, the
wave of small amplitude has the frequency

    omega^2 = g k tanh(k L / 2) (rho_1 - rho_2) / (rho_1 + rho_2)

The amplitude of the water's is compared with that of a wave of its height without viscosity, see theory.py, which goes
up and down by 0.4 % as the wave exchanges energy with its harmonics, times exp(-2 nu k^2 t).

With the heavier fluid on top, `rayleigh_taylor.py` compares how far the two come through each other.

    summary.json      figures of all runs
    waves.png         amplitude over time
    <flow>_<...>/     history.csv and summary.json of each run

    python -m tipfem demo validation/waves --across 20 40 --periods 3
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from tipfem.demos import harness
from tipfem.demos.support.figures import COLOURS, DASHES, new_figure, save
from tipfem.demos.support.options import Arch, Counts, Positive, Several
from tipfem.demos.validation.waves import rayleigh_taylor
from tipfem.demos.validation.waves.theory import StandingWave

import tipfem as tp

Array = NDArray[np.float64]

LENGTH = 0.2  # of the tank's sides: half a wavelength [m]
GRAVITY = 9.81  # [m/s^2]
AIR = tp.Fluid("air", density=1.2, viscosity=1.8e-5)
# Lower fluid and amplitude in wavelengths, by the name of the flow; upper fluids that are not air.
Flow = Literal["water", "syrup", "liquids"]
FLOWS = {
    "water": (tp.Fluid("water", density=1000.0, viscosity=1e-3), 0.0125),
    "syrup": (tp.Fluid("syrup", density=1000.0, viscosity=2.5), 0.01),
    "liquids": (tp.Fluid("water", density=1000.0, viscosity=1e-3), 0.005),
}
UPPER = {"liquids": tp.Fluid("oil", density=500.0, viscosity=5e-4)}
TIME_STEP = 0.05  # [sqrt(h / g)]
# For waves that do not break: a consistent mass makes their period right, and less damping longer steps as accurate.
CALM, CALM_STEP = tp.Numerics(mass="consistent", rho_inf=0.8), 0.2
LARGEST_PERIOD_ERROR = {"water": 0.02, "liquids": 0.005}  # that of "liquids" is for 20 particles across and more
EXTREME_BY = 0.75  # time by which an extreme must have been found [periods]
# Of the water's amplitude, from so many particles across on; of the rise of energy from one half period to the next,
# over the wave's.
LARGEST_ERRORS = {20: 0.01, 40: 0.003}
LARGEST_GAIN = 1e-4
LARGEST_RESIDUAL = 1e-3  # energy that Newton's method leaves unaccounted for, over that of the wave


def period(lower: tp.Fluid, upper: tp.Fluid = AIR) -> float:
    """Period of a small wave between two fluids without viscosity [s]."""
    k = math.pi / LENGTH
    ratio = (lower.density - upper.density) / (lower.density + upper.density)
    return 2 * math.pi / math.sqrt(GRAVITY * k * math.tanh(0.5 * k * LENGTH) * ratio)


def build(flow: str, across: int, amplitude: float | None = None, numerics: tp.Numerics | None = None) -> tp.Case:
    """The wave's case.

    Args:
        flow: one of `FLOWS`.
        across: particles along a side of the tank.
        amplitude: in wavelengths; by default the flow's.
        numerics: parameters of the method; by default pressures on both sides of the interface.
    """
    (lower, usual), upper = FLOWS[flow], UPPER.get(flow, AIR)
    numerics = numerics or tp.Numerics(pressure="two-sided")
    height = (amplitude or usual) * 2 * LENGTH
    tank = tp.tank((LENGTH, LENGTH), LENGTH / across)
    tank.fill(upper).fill(lower, where=lambda x: x[:, 1] < LENGTH / 2 + height * np.cos(math.pi * x[:, 0] / LENGTH))
    for wall in ("left", "right", "bottom", "top"):
        tank.wall(wall, slip=True)
    return tp.Case(tank, [lower, upper], (0, -GRAVITY), numerics=numerics)


def mode(simulation: tp.Simulation) -> float:
    """Amplitude of the first mode [m]: (2 / L) times the integral of cos(k x) over the lower fluid."""
    mesh = simulation.mesh
    lower = np.flatnonzero(mesh.fluid == 0)
    corners = mesh.position[mesh.cells[lower], 0]
    # By the middles of the edges, which is exact for quadratic functions.
    middles = 0.5 * (corners + np.roll(corners, 1, axis=1))
    mean = np.cos(math.pi * middles / LENGTH).mean(axis=1)
    return float(2 / LENGTH * (mesh.measure[lower] * mean).sum())


def extremes(time: Array, amplitude: Array) -> Array:
    """Times and sizes (K, 2) of the extremes after the start, by parabolas through three points."""
    found = []
    for i in range(1, len(time) - 1):
        y = np.abs(amplitude[i - 1 : i + 2])
        if y[1] >= y[0] and y[1] > y[2] and amplitude[i] * amplitude[0] * (-1) ** (len(found) + 1) > 0:
            a, b, c = np.polyfit(time[i - 1 : i + 2] - time[i], y, 2)
            found.append((time[i] - 0.5 * b / a, c - 0.25 * b**2 / a))
    return np.array(found).reshape(-1, 2)


def peak_error(lower: tp.Fluid, height: float, peaks: Array) -> float:
    """Largest difference of peaks (K, 2) of a fluid of little viscosity from theory's, by their order.

    Args:
        lower: fluid.
        height: of the wave at the start [m].
        peaks: times [s] and amplitudes over that of the start.
    """
    if not len(peaks):
        return math.nan
    course = StandingWave(LENGTH, 0.5 * LENGTH, GRAVITY).course(height, 1.05 * peaks[-1, 0])
    wanted = extremes(*course.T)[: len(peaks), 1]
    wanted *= np.exp(-2 * lower.viscosity / lower.density * (math.pi / LENGTH) ** 2 * peaks[: len(wanted), 0])
    return float(np.abs(peaks[: len(wanted), 1] - wanted).max())


def measure(
    flow: str,
    across: int,
    periods: float,
    *,
    time_step: float = TIME_STEP,
    amplitude: float | None = None,
    numerics: tp.Numerics | None = None,
    out: Path | None = None,
) -> tuple[dict[str, Any], Array]:
    """Run a wave.

    Args:
        flow: one of `FLOWS`.
        across: particles along a side of the tank.
        periods: how long.
        time_step: largest time step [sqrt(h / g)].
        amplitude: in wavelengths; by default the flow's.
        numerics: parameters of the method.
        out: folder for the history, or None.

    Returns:
        The figures, and times [s] and amplitudes relative to the first (K, 2). Figures are: ``peaks``, the sizes of
        the extremes after the start; ``period`` over that of theory; energies over that of the wave at the start:
        ``residual``, which Newton's method left, ``remeshing``, which remeshing took, and ``gain``, the largest rise
        from one half period to the next; ``error``, the largest of the water's peaks; iterations per step.
    """
    (lower, usual), upper = FLOWS[flow], UPPER.get(flow, AIR)
    theory = period(lower, upper)
    step = time_step * math.sqrt(LENGTH / across / GRAVITY)
    case = build(flow, across, amplitude, numerics)
    simulation = tp.Simulation(case, out, time_step=step, columns={"amplitude": mode})
    start, beginning = mode(simulation), sum(simulation.energy())
    simulation.run(periods * theory, progress=False)
    history = simulation.history
    course = np.array([(0.0, start), *((row["time"], row["amplitude"]) for row in history)]) / [1.0, start]
    peaks = extremes(*course.T)
    height = (amplitude or usual) * 2 * LENGTH
    energy = 0.25 * (lower.density - upper.density) * GRAVITY * LENGTH * height**2
    total = np.array([row["kinetic_energy"] + row["potential_energy"] for row in history])
    halves = np.interp(0.5 * theory * np.arange(1, 2 * periods + 1e-9), course[1:, 0], total)
    figures = {
        "flow": flow,
        "across": across,
        "periods": periods,
        "steps": len(history),
        "peaks": peaks[:, 1].tolist(),
        "period": 2 * peaks[-1, 0] / len(peaks) / theory if len(peaks) else math.nan,
        "residual": sum(row["energy_residual"] for row in history) / energy,
        "remeshing": sum(row["remeshing_dissipation"] for row in history) / energy,
        "gain": float(np.diff(halves, prepend=beginning).max(initial=-math.inf) / energy),
        "error": peak_error(lower, height, peaks) if flow == "water" else math.nan,
        "newton_iterations": sum(row["newton_iterations"] for row in history) / len(history),
        "krylov_iterations": sum(row["krylov_iterations"] for row in history) / len(history),
    }
    return figures, course


def check(figures: Mapping[str, Any]) -> list[str]:
    """What a run misses of what is expected of it; an empty list when all is well."""
    missed = []
    name = f"{figures['flow']}, {figures['across']} across"
    if not abs(figures["residual"]) <= LARGEST_RESIDUAL:
        missed.append(f"{name}: the energy closes to {figures['residual']:.2%} of the wave's, not to 0.1 %")
    largest = LARGEST_PERIOD_ERROR.get(figures["flow"], math.inf)
    if not figures["peaks"] and figures["periods"] > EXTREME_BY:
        missed.append(f"{name}: no extreme in {figures['periods']:g} periods")
    if figures["peaks"] and not abs(figures["period"] - 1) <= largest:
        missed.append(f"{name}: the period is {figures['period']:.3f} of theory's")
    allowed = [error for across, error in LARGEST_ERRORS.items() if figures["across"] >= across]
    if figures["flow"] == "water" and figures["peaks"] and allowed:
        if not figures["error"] <= allowed[-1]:
            missed.append(f"{name}: an amplitude is {figures['error']:.2%} from theory, not {allowed[-1]:.1%} at most")
        if not figures["gain"] <= LARGEST_GAIN:
            missed.append(f"{name}: in half a period the wave gains {figures['gain']:.1e} of its energy")
    return missed


def plot(path: Path, runs: Mapping[str, tuple[str, Array]]) -> None:
    """Draw the amplitudes over time: label -> (flow, course).

    Raises:
        ImportError: there is no matplotlib.
    """
    figure = new_figure(8.0, 4.5)
    axes = figure.add_subplot()
    for number, (label, (flow, course)) in enumerate(runs.items()):
        t = course[:, 0] / period(FLOWS[flow][0], UPPER.get(flow, AIR))
        style = {"color": COLOURS[number % len(COLOURS)], "linestyle": DASHES[number // len(COLOURS) % len(DASHES)]}
        axes.plot(t, course[:, 1], label=label, **style)
    axes.set_xlabel("t / T")
    axes.set_ylabel("amplitude / that of the start")
    axes.grid(alpha=0.3)
    axes.legend()
    save(figure, path)


def table(results: Sequence[Mapping[str, Any]]) -> str:
    """The figures of several runs as a table in Markdown, a row each."""
    lines = ["| wave | across | period | peaks | error | energy: residual | by remeshing | Newton | Krylov a step |"]
    lines.append("|---|---|---|---|---|---|---|---|---|")
    lines += [
        f"| {r['flow']} | {r['across']} | {r['period']:.4f} | {' '.join(f'{p:.4f}' for p in r['peaks'])} | "
        f"{'-' if math.isnan(r['error']) else format(r['error'], '.2%')} | "
        f"{r['residual']:.1e} | {-r['remeshing']:.2%} | {r['newton_iterations']:.2f} | {r['krylov_iterations']:.1f} |"
        for r in results
    ]
    return "\n".join(lines) + "\n"


def main(
    *,
    flow: Several[Flow | Literal["rayleigh-taylor"]] = ("water", "syrup"),
    across: Counts = (20, 40),
    periods: Positive = 3.0,
    time_step: Positive = TIME_STEP,
    mass: Literal["lumped", "consistent", "interfaces"] | None = None,
    arch: Arch = "cpu",
    out: Path = Path("out/validation/waves"),
) -> int:
    """Run the waves at all resolutions.

    Args:
        flow: which waves, or the instability.
        across: particles along a side of the tank.
        periods: how long each wave runs.
        time_step: in units of sqrt(h / g).
        mass: mass matrix, by default tipfem's.
        arch: where the kernels run.
        out: folder for the results.
    """
    results: list[dict[str, Any]] = []
    unstable: list[dict[str, Any]] = []
    runs: dict[str, tuple[str, Array]] = {}
    numerics = tp.Numerics(pressure="two-sided", **({"mass": mass} if mass else {}))
    tp.init(arch=arch)
    for name in flow:
        for n in across:
            if name == "rayleigh-taylor":
                unstable.append(rayleigh_taylor.measure(n, mass=mass, out=out / f"{name}_{n}"))
                continue
            figures, course = measure(name, n, periods, time_step=time_step, numerics=numerics, out=out / f"{name}_{n}")
            results.append(figures)
            runs[f"{name}, {n} across"] = name, course
    text = (table(results) if results else "") + (rayleigh_taylor.table(unstable) if unstable else "")
    (out / "table.md").write_text(text, encoding="utf-8")
    if runs:
        plot(out / "waves.png", runs)
    print(text)
    missed = [*map(check, results), *map(rayleigh_taylor.check, unstable)]
    return harness.report(out, {"runs": results + unstable}, [text for each in missed for text in each])


if __name__ == "__main__":
    harness.command(__name__)
