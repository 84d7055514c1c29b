"""Rigid bodies that float, roll, fall, oscillate and stir, against closed forms and experiments.

A box of half the density of water comes to rest at the draught of Archimedes, under air and under a free surface, and
one of a hundredth of it is let go under water. A barge is released at an angle (Jung, Chang & Jo, Ocean Engineering 33,
2006). A heavy cylinder falls between two walls at the speed of Faxen's series (1946). A cylinder oscillates in a fluid
at rest (Dutsch, Durst, Becker & Lienhart, J. Fluid Mech. 360, 1998). A paddle stirs two fluids for ten turns, whose
volumes stay. A cylinder is let go above where it floats, and heaves (Maskell & Ursell, J. Fluid Mech. 44, 1970). The
waves of a piston at three frequencies have the height over its stroke of linear theory. A wedge comes down on a free
surface with the force of a similarity solution (Zhao & Faltinsen, J. Fluid Mech. 246, 1993).

    summary.json      figures of all flows
    bodies.png        what was measured over time

    python -m tipfem demo validation/bodies --flow draught falling
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from tipfem.demos import harness
from tipfem.demos.support.figures import COLOURS, new_figure, save
from tipfem.demos.support.histories import column, zeros
from tipfem.demos.support.options import Counts, Flag, Several
from tipfem.demos.validation.bodies import flows, waves

import tipfem as tp

Array = NDArray[np.float64]

# Resolutions: spacings across the tank, or across the cylinders; of the barge in its height.
FINE: dict[str, tuple[int, ...]] = {
    "draught": (25, 50),
    "surface": (25, 50),
    "light": (25, 50),
    "rolling": (8, 12),
    "falling": (8, 16),
    "oscillating": (16, 32),
    "stirring": (30,),
    "heaving": (8, 16),
    "wavemaker": (10, 16),
    "slamming": (24, 48),
}
SHORT = {
    "draught": (20,),
    "surface": (25,),
    "light": (20,),
    "rolling": (5,),
    "falling": (6,),
    "oscillating": (8,),
    "stirring": (16,),
    "heaving": (8,),
    "wavemaker": (8,),
    "slamming": (12,),
}
# Check: the largest errors at the finer resolutions.
LIMITS = {
    "draught": 5e-3,
    "draught_at_surface": 5e-3,
    "falling": 0.02,
    "volume": 1e-6,
    "drag_error": 0.05,
    "inertia_error": 0.05,
}
LIMITS |= {"period_error": 0.05, "ratio_error": 0.05, "slamming_error": 0.1, "slamming_impulse": 0.06}
SHORT_LIMITS = {
    "draught": 0.05,
    "draught_at_surface": 0.05,
    "falling": 0.04,
    "volume": 1e-6,
    "ratio_error": 0.08,
    "period_error": 0.12,
    "slamming_impulse": 0.12,
}
END = {
    "draught": 4.0,
    "surface": 2.4,
    "light": 2.0,
    "rolling": 2.6,
    "oscillating": 10.0,
}  # [s]; --short goes half of the way
TURNS = 10
SIMILAR = 0.27  # half widths that the wedge comes down before the water leaves its shoulders
# [sqrt(a / g)]; later the depth of the tank matters: long waves carry the water away that the cylinder displaces.
HEAVING = 6.6

Figures = dict[str, float]
Curve = tuple[
    Array, Array, float | Array
]  # times [s] or as in `TIMES`, values, and the value or values to be compared with


def draught(across: int, short: bool) -> tuple[Figures, Curve]:
    """The draught of a box at rest, over that of Archimedes; the mean of the last second."""
    simulation = tp.Simulation(flows.floating_box(across, 500.0, 0.02, 300.0, flows.THICK))
    end = END["draught"] / (2 if short else 1)
    depth = np.array(flows.advance(simulation, end, flows.draught))
    exact = flows.BOX[1] * (500.0 - flows.AIR.density) / (flows.WATER.density - flows.AIR.density)
    time = column(simulation, "time")
    return {"draught": float(depth[time > end - 1.0].mean()) / exact - 1}, (time, depth / exact, 1.0)


def at_surface(across: int, short: bool) -> tuple[Figures, Curve]:
    """The same without air, under a free surface, from near its draught and more damped."""
    simulation = tp.Simulation(flows.floating_box(across, 500.0, 0.005, 700.0, flows.THICK, air=False))
    end = END["surface"] / (2 if short else 1)
    depth = np.array(flows.advance(simulation, end, flows.draught))
    exact = flows.BOX[1] * 500.0 / flows.WATER.density
    time = column(simulation, "time")
    return {"draught_at_surface": float(depth[time > end - 0.6].mean()) / exact - 1}, (time, depth / exact, 1.0)


def light(across: int, short: bool) -> tuple[Figures, Curve]:
    """A box of density 10 that is let go under water: steps that were refused, and its largest speed."""
    simulation = tp.Simulation(flows.floating_box(across, 10.0, -0.05))
    flows.advance(simulation, END["light"] / (2 if short else 1))
    speed = column(simulation, "box_velocity_y")
    figures = {
        "refused": float(column(simulation, "refused_steps").sum()),
        "speed": float(np.abs(speed).max()),
        "krylov": float(column(simulation, "krylov_iterations").sum() / column(simulation, "newton_iterations").sum()),
    }
    return figures, (column(simulation, "time"), column(simulation, "box_y"), flows.LEVEL)


def rolling(across: int, short: bool) -> tuple[Figures, Curve]:
    """The period of a barge that rolls, by the times of its extremes."""
    simulation = tp.Simulation(flows.rolling_barge(flows.BARGE[1] / across))
    flows.advance(simulation, END["rolling"] / (2 if short else 1))
    time, angle = column(simulation, "time"), column(simulation, "barge_angle") + flows.BARGE_ANGLE
    inner = slice(1, -1)
    extreme = (angle[inner] - angle[:-2]) * (angle[2:] - angle[inner]) <= 0
    at = time[inner][extreme & (time[inner] > 0.1)]
    period = 2 * float(np.diff(at).mean()) if len(at) > 1 else math.nan
    return {"period": period, "period_error": period / flows.BARGE_PERIOD - 1}, (time, np.degrees(angle), 0.0)


def falling(across: int, short: bool) -> tuple[Figures, Curve]:
    """The terminal speed of a cylinder between walls, over Faxen's."""
    del short
    case = flows.falling_cylinder(across)
    relaxation = flows.FALLING**2 * flows.SYRUP.density / flows.SYRUP.viscosity
    simulation = tp.Simulation(case, time_step=0.2 * relaxation)
    flows.advance(simulation, 12 * relaxation)
    speed = -column(simulation, "cylinder_velocity_y") / flows.terminal_speed(case)
    return {"falling": float(speed[-1]) - 1}, (column(simulation, "time"), speed, 1.0)


def oscillating(across: int, short: bool) -> tuple[Figures, Curve]:
    """Coefficients of Morison's equation in the second period."""
    end = END["oscillating"] / (2 if short else 1)
    simulation = tp.Simulation(flows.oscillating_cylinder(across), time_step=0.05)
    flows.advance(simulation, end)
    time, force = column(simulation, "time"), column(simulation, "cylinder_force_x")
    last = time > end - flows.KEULEGAN_CARPENTER
    found = flows.morison(time[last], force[last])
    errors = {f"{name}_error": value / flows.DUTSCH[name] - 1 for name, value in found.items()}
    return {**found, **errors}, (time, force, 0.0)


def stirring(across: int, short: bool) -> tuple[Figures, Curve]:
    """Volumes of two fluids after ten turns of a paddle."""
    simulation = tp.Simulation(flows.stirred(across))
    flows.advance(simulation, (2 if short else TURNS) * flows.TURN + 0.2)
    change = np.abs(simulation.state.volume / simulation.state.wanted_volume - 1)
    figures = {"turns": float(column(simulation, "paddle_angle")[-1] / (2 * math.pi)), "volume": float(change.max())}
    return figures, (column(simulation, "time"), column(simulation, "paddle_moment"), 0.0)


def heaving(across: int, short: bool) -> tuple[Figures, Curve]:
    """Heave of a cylinder that is let go: its period by the zeros, against linear theory."""
    del short
    simulation = tp.Simulation(waves.heaving_cylinder(across), time_step=0.04 * waves.UNIT)
    flows.advance(simulation, HEAVING * waves.UNIT)
    time = column(simulation, "time") / waves.UNIT
    heave = (column(simulation, "cylinder_y") / waves.RADIUS - waves.DEPTH) / waves.LIFT
    exact = waves.heave_response(time)
    error = half_period(time, heave) / half_period(time, exact) - 1  # between the first two zeros
    figures = {"period_error": error, "rms": float(np.sqrt(((heave - exact) ** 2).mean()))}
    return figures, (time, heave, exact)


def wavemaker(across: int, short: bool) -> tuple[Figures, Curve]:
    """Height of the waves over the stroke of a piston at three frequencies, against linear theory."""
    figures, errors = {}, []
    for kh in list(waves.WAVES)[1:2] if short else waves.WAVES:
        gauge = tp.WaveGauge(name="gauge", x=waves.STEADY, fluid="water")
        simulation = tp.Simulation(
            waves.wave_maker(kh, across), time_step=waves.wave_period(kh) / waves.STEPS, probes=[gauge]
        )
        simulation.run(waves.wave_window(kh)[1], progress=False)
        time, level = simulation.probes["gauge"]["time"], simulation.probes["gauge"]["height"]
        ratio = waves.wave_height(time, level, kh) / waves.stroke(kh)
        figures[f"ratio_{kh:g}"] = ratio
        errors.append(ratio / waves.stroke_ratio(kh) - 1)
        if kh == list(waves.WAVES)[1]:
            unit = 0.5 * waves.stroke(kh) * waves.stroke_ratio(kh)
            curve = time / waves.wave_period(kh), (level - 1.0) / unit, waves.tank_waves(kh, time) / unit
    return {**figures, "ratio_error": errors[int(np.argmax(np.abs(errors)))]}, curve


def slamming(across: int, short: bool) -> tuple[Figures, Curve]:
    """The force on a wedge over that of similarity, by tenths of the time until the water leaves its shoulders.

    The short version goes on until it has come down three half widths.
    """
    simulation = tp.Simulation(flows.slamming_wedge(across))
    touch, end = flows.OFFSET * flows.HALF / across / flows.ENTRY, SIMILAR * flows.HALF / flows.ENTRY
    flows.advance(simulation, touch + end)
    time, force = column(simulation, "time") - touch, column(simulation, "wedge_force_y")
    unit = flows.SLAMMING * flows.WATER.density * flows.ENTRY**3
    impulse = np.concatenate([[0.0], np.cumsum(force * np.diff(time, prepend=-touch))])
    bounds = np.linspace(0.0, end, 11)
    tenths = np.diff(np.interp(bounds, np.append(-touch, time), impulse)) / (0.5 * unit * np.diff(bounds**2))
    if short:
        flows.advance(simulation, touch + 3 * flows.HALF / flows.ENTRY)
    figures = {f"tenth_{k + 1}": float(ratio) for k, ratio in enumerate(tenths)}
    figures["slamming_error"] = float(np.abs(tenths[1:] - 1).max())
    figures["slamming_impulse"] = float(impulse[-1] / (0.5 * unit * time[len(force) - 1] ** 2) - 1)
    return figures, (time, force / unit, np.maximum(time, 0.0))


def half_period(time: Array, values: Array) -> float:
    """Time between the first two changes of sign of values (K,), linear between samples; NaN if there are none."""
    passes = zeros(time, values)[1]
    return float(passes[1] - passes[0]) if len(passes) > 1 else math.nan


Flow = Literal[
    "draught", "surface", "light", "rolling", "falling", "oscillating", "stirring", "heaving", "wavemaker", "slamming"
]
STUDIES: dict[str, tuple[Callable[[int, bool], tuple[Figures, Curve]], str]] = {
    "draught": (draught, "draught of the box / Archimedes"),
    "surface": (at_surface, "the same, free surface"),
    "light": (light, "height of a box of density 10 [m]"),
    "rolling": (rolling, "angle of the barge [deg]"),
    "falling": (falling, "speed / Faxen"),
    "oscillating": (oscillating, "force on the cylinder [N/m]"),
    "stirring": (stirring, "moment on the paddle [N]"),
    "heaving": (heaving, "heave / that at the start"),
    "wavemaker": (wavemaker, "elevation / theory's, kh = 1.5"),
    "slamming": (slamming, "force / (14.14 rho V$^3$) [s]"),
}

TIMES = {"heaving": "t (g / a)$^{1/2}$", "wavemaker": "t / T"}  # where times are not in seconds


def check(figures: Mapping[str, float], limits: Mapping[str, float]) -> list[str]:
    """What a flow misses of what is expected of it."""
    missed = harness.above({name: abs(value) for name, value in figures.items()}, limits)
    if figures.get("refused"):
        missed.append(f"{figures['refused']:.0f} steps with the light box were refused")
    return missed


def plot(path: Path, curves: Mapping[str, Mapping[int, Curve]]) -> None:
    """Draw what was measured over time, one flow above the other: flow -> resolution -> curve.

    Raises:
        ImportError: there is no matplotlib.
    """
    figure = new_figure(9.0, 2.3 * ((len(curves) + 1) // 2))
    for number, (flow, runs) in enumerate(curves.items()):
        axes = figure.add_subplot((len(curves) + 1) // 2, 2, number + 1)
        for (across, (time, values, known)), colour in zip(runs.items(), COLOURS, strict=False):
            axes.plot(time, values, color=colour, linewidth=1.2, label=f"{across} spacings")
            if np.ndim(known):
                axes.plot(time, known, color="black", linewidth=0.8, linestyle="--")
            else:
                axes.axhline(float(known), color="black", linewidth=0.8, linestyle="--")
        axes.set_xlabel(TIMES.get(flow, "t [s]"))
        axes.set_ylabel(STUDIES[flow][1], fontsize=8)
        axes.grid(alpha=0.3)
        axes.legend(fontsize=7)
        if flow == "falling":
            axes.set_ylim(0, 1.2)
        if flow == "oscillating":
            axes.set_ylim(-3, 3)
    save(figure, path)


def main(
    *,
    flow: Several[Flow] | None = None,
    across: Counts | None = None,
    short: Flag = False,
    out: Path = Path("out/validation/bodies"),
) -> int:
    """Run the flows at all resolutions.

    Args:
        flow: which flows; by default all.
        across: resolutions; by default those of each flow.
        short: coarse, a few minutes.
        out: folder for the results.
    """
    sizes, limits = (SHORT, SHORT_LIMITS) if short else (FINE, LIMITS)
    tp.init()
    out.mkdir(parents=True, exist_ok=True)
    results: dict[str, dict[int, Figures]] = {}
    curves: dict[str, dict[int, Curve]] = {}
    for name in flow or STUDIES:
        for n in across or sizes[name]:
            figures, curve = STUDIES[name][0](n, short)
            results.setdefault(name, {})[n] = figures
            curves.setdefault(name, {})[n] = curve
            print(name, n, {key: f"{value:.4g}" for key, value in figures.items()})
    plot(out / "bodies.png", curves)
    missed = [line for runs in results.values() for line in check(runs[max(runs)], limits)]
    return harness.report(out, {"flows": results}, missed)


if __name__ == "__main__":
    harness.command(__name__)
