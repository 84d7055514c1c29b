"""interFoam and tipfem in turns on this machine: processor time side by side, and error against cost.

A standing wave of water under air between walls that slip (demos/validation/waves), whose theory has finite amplitude,
the dam break of Martin & Moyce (demos/validation/dam_break), water that enters by an inlet, runs over a sharp or a
broad weir and leaves by a drain (demos/validation/openings), against Rehbock's formula and handbooks' coefficient, and
with surface tension (demos/validation/drops) a bubble that rises, against the benchmark of Hysing et al., and a drop at
rest, which should not move. Both codes have one core, the same geometry, fluids and walls. tipfem has its defaults, and
for the wave a consistent mass, rho_inf = 0.8 and twice the largest step, see docs/howto/resolution.md. interFoam
(OpenFOAM) has the settings of its own dam break, for the wave with Courant numbers up to 0.5 and steps that end at 100
stored times a period, and for the weirs its inlet of variable height and Courant numbers up to 0.5; the back of its
sharp weir, which no water touches, is upright. Its default Euler's method damps waves; with --scheme crank-nicolson
they grow. With tension its steps are at most half the capillary time: with longer ones it is wrong without a word.
Figures are medians over the rounds; processor time is that of the solver alone, tipfem's after its first step, whose
kernels are compiled then.

    peers.png       error against cost
    time.png        processor time side by side
    peers.md        all figures, and where interFoam is better

    python -m tipfem demo benchmarks/peers
"""

from __future__ import annotations

import csv
import datetime
import itertools
import json
import math
import platform
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from tipfem.demos import harness
from tipfem.demos.benchmarks import interfoam
from tipfem.demos.support.figures import COLOURS, MARKERS, new_figure, save
from tipfem.demos.support.options import Count, Counts, Positive, Positives, Several
from tipfem.demos.validation.dam_break import case as dam_break
from tipfem.demos.validation.dam_break import check
from tipfem.demos.validation.drops import at_rest
from tipfem.demos.validation.drops import in_motion as drops
from tipfem.demos.validation.openings import water
from tipfem.demos.validation.waves import run as waves

import tipfem as tp
from tipfem.case.surface_tension import TensionTable

Array = NDArray[np.float64]
Figures = dict[str, Any]

# Of the time integration of interFoam's wave.
SCHEMES = {"euler": "Euler", "crank-nicolson": "CrankNicolson 0.9"}
CODES = ("interFoam", "tipfem")
DAM_END = 0.3  # [s]
DAM_INTERVAL = 0.005  # between the stored times of interFoam [s]
WAVE_STATES = 100  # stored times a period, of interFoam
BUBBLE_END, BUBBLE_INTERVAL = 3.0, 0.02  # end of the bubble's run, and time between interFoam's stored states [s]
STATIC_STEPS = 200  # how long the drop is at rest [capillary times]
WEIR_END, WEIR_INTERVAL = 3.0, 0.02  # end of the weirs' runs, and time between interFoam's stored states [s]
SAMPLES = 20  # points along each side of a cell, for the fractions of discs at the start
FINEST_SAMPLES = 64  # points across a cell, for the fractions at the start
# The figures that are compared, and what they are called.
ERRORS = {
    "bubble": ("height", "relative error of the height of a bubble that rises"),
    "static_drop": ("capillary_number", "capillary number of a drop at rest"),
    "weir": ("head", "error of the depth over a sharp weir"),
    "broad_weir": ("head", "error of the depth over a broad weir"),
    "wave": ("amplitude", "largest error of an amplitude, part of that at the start"),
    "dam_break": ("front_rms", "RMS of the front against Martin & Moyce"),
}
WORDS = {
    "height": "height",
    "velocity": "velocity",
    "capillary_number": "drop at rest",
    "amplitude": "amplitude",
    "period": "period",
    "front_rms": "front",
    "head": "depth over the weir",
}
KEPT = ("date", "version", "commit", "machine", "command", "flow", "code", "resolution", "figure", "value", "unit")


def column_fraction(cells: int) -> Array:
    """The dam break's column: (cells, cells) fractions of water."""
    place, (width, height) = np.arange(cells) * dam_break.TANK[0] / cells, dam_break.COLUMN
    h = dam_break.TANK[0] / cells
    return np.outer(np.clip((height - place) / h, 0, 1), np.clip((width - place) / h, 0, 1))


def wave_fraction(cells: int, amplitude: float) -> Array:
    """The wave at the start: (cells, cells) fractions of water; its amplitude [m]."""
    h = waves.LENGTH / cells
    x = (np.arange(cells * FINEST_SAMPLES) + 0.5) * h / FINEST_SAMPLES
    level = waves.LENGTH / 2 + amplitude * np.cos(math.pi * x / waves.LENGTH)
    rows = np.clip((level[None, :] - np.arange(cells)[:, None] * h) / h, 0, 1)
    return np.asarray(rows.reshape(cells, cells, FINEST_SAMPLES).mean(axis=2))


def wave_figures(course: Array) -> Figures:
    """Errors of a wave of water by its course (K, 2), times [s] and amplitudes over that of the start."""
    lower, amplitude = waves.FLOWS["water"]
    peaks = waves.extremes(*course.T)
    theory = waves.StandingWave(waves.LENGTH, waves.LENGTH / 2, waves.GRAVITY)
    height = amplitude * 2 * waves.LENGTH
    expected = waves.extremes(*theory.course(height, 1.1 * course[-1, 0]).T)[: len(peaks), 0]
    slower = waves.period(lower) / waves.period(lower, tp.Fluid("nothing", density=1e-9, viscosity=0.0))
    return {
        "amplitude": waves.peak_error(lower, height, peaks),
        "period": abs(float(peaks[len(expected) - 1, 0] / (expected[-1] * slower)) - 1) if len(expected) else math.nan,
    }


def front_figures(time: Array, front: Array) -> Figures:
    """Errors of the dam break's front, times (K,) [s] and places (K,) [m]."""
    found = check.front_figures([{"time": t, "front": x} for t, x in zip(time.tolist(), front.tolist(), strict=True)])
    return {"front_rms": found["front_rms"], "shift": found["front_shift"]}


def interfoam_wave(cells: int, periods: float, scheme: str, folder: Path) -> Figures:
    """interFoam's wave with so many cells along a side, for so many periods, by a scheme of `SCHEMES`."""
    lower, amplitude = waves.FLOWS["water"]
    period = waves.period(lower)
    flow = interfoam.Flow(
        (waves.LENGTH, waves.LENGTH),
        (cells, cells),
        (lower, waves.AIR),
        wave_fraction(cells, amplitude * 2 * waves.LENGTH),
        slip=True,
        end=periods * period,
        interval=period / WAVE_STATES,
        courant=0.5,
        scheme=SCHEMES[scheme],
    )
    done = interfoam.run(flow, folder)
    course = np.array([interfoam.mode(flow, fraction) for fraction in done.fraction])
    figures = wave_figures(np.stack([done.time, course / course[0]], axis=1))
    return {**figures, "seconds": done.seconds, "steps": done.steps, "code_version": done.version}


def interfoam_dam_break(spacing: float, folder: Path) -> Figures:
    """interFoam's dam break with cells of about this size [m]."""
    cells = round(dam_break.TANK[0] / spacing)
    flow = interfoam.Flow(
        dam_break.TANK,
        (cells, cells),
        (dam_break.WATER, dam_break.AIR),
        column_fraction(cells),
        slip=False,
        end=DAM_END,
        interval=DAM_INTERVAL,
    )
    done = interfoam.run(flow, folder)
    front = np.array([interfoam.front(flow, fraction) for fraction in done.fraction])
    figures = front_figures(done.time[1:], front[1:])
    return {**figures, "seconds": done.seconds, "steps": done.steps, "code_version": done.version}


def weir_blocks(across: int, broad: bool) -> tuple[interfoam.Blocks, Array]:
    """The mesh of the channel with a weir, with so many cells in the depth over it, and fractions at the start.

    Its first blocks are before the weir, in three columns: those below the crest, and those above it.
    """
    corners, _ = water.weir_outline(broad)
    h, high, roof, (foot, low), (end, _) = water.ABOVE / across, water.HIGH, water.ROOF, corners[-4], corners[-3]
    over = water.CREST + (water.BROAD if broad else 0.0)
    left, right = [0.0, *water.VENTS[0], water.CREST], [over, *(foot + x for x in water.VENTS[1]), end]
    upper = left + right[not broad :]

    def row(places: Sequence[float], floor: float, top: float) -> list[Any]:
        size = [(round((b - a) / h), round((top - floor) / h)) for a, b in itertools.pairwise(places)]
        boxes = [((a, floor), (b, floor), (b, top), (a, top)) for a, b in itertools.pairwise(places)]
        return list(zip(boxes, size, strict=True))

    cells = [*row(left, 0.0, high), *row(left, high, roof), *row(upper[3:], high, roof), *row(right, low, high)]
    above = [((b, roof), (a, roof)) for a, b in itertools.pairwise(upper)]
    patches = {
        "inlet": [((0.0, high), (0.0, 0.0))],
        "drain": [((a, low), (b, low)) for a, b in itertools.pairwise(right)],
        "vents": [above[1], above[-2]],
    }
    free = {
        "alpha.water": "inletOutlet; inletValue uniform 0; value uniform 0",
        "U": "pressureInletOutletVelocity; value uniform (0 0 0)",
        "p_rgh": "prghTotalPressure; p0 uniform 0; value uniform 0",
    }
    flow = water.weir_discharge(broad) * h
    rise = [(r, 3 * r**2 - 2 * r**3) for r in np.linspace(0, 1, 11).tolist()]
    table = " ".join(f"({r * water.RAMP:.9g} {part * flow:.9g})" for r, part in [*rise, (1e6, 1.0)])
    inlet = {
        "alpha.water": "variableHeightFlowRate; lowerBound 0; upperBound 1; value uniform 1",
        "U": f"variableHeightFlowRateInletVelocity; alpha alpha.water; flowRate table ({table}); value uniform (0 0 0)",
        "p_rgh": "fixedFluxPressure; value uniform 0",
    }
    full = [np.ones(nx * ny) for _, (nx, ny) in cells[:3]]
    part = [np.repeat(np.arange(ny) < across, nx) for _, (nx, ny) in cells[3:6]]
    rest = [np.zeros(nx * ny) for _, (nx, ny) in cells[6:]]
    mesh = interfoam.Blocks(cells, patches, {"inlet": inlet, "drain": free, "vents": free})
    return mesh, np.concatenate([*full, *part, *rest]).astype(float)


def interfoam_weir(across: int, broad: bool, folder: Path) -> Figures:
    """interFoam's weir with so many cells in the depth over it, sharp or broad."""
    blocks, fraction = weir_blocks(across, broad)
    h = water.ABOVE / across
    flow = interfoam.Flow(
        (water.CREST, water.ROOF),
        (round(water.CREST / h), round(water.ROOF / h)),
        (water.WATER, water.AIR),
        fraction,
        slip=True,
        end=WEIR_END,
        interval=WEIR_INTERVAL,
        courant=0.5,
        gravity=water.G,
        blocks=blocks,
    )
    done = interfoam.run(flow, folder)
    # Depths in the columns of cells before the weir: what flows over it is what enters and does not stay there.
    sizes = [nx * ny for _, (nx, ny) in blocks.cells]
    parts = np.split(done.fraction, np.cumsum(sizes)[:6], axis=1)[:6]
    wide = [part.reshape(len(part), ny, nx) for part, (_, (nx, ny)) in zip(parts, blocks.cells, strict=False)]
    depth = h * (np.concatenate(wide[:3], axis=2).sum(axis=1) + np.concatenate(wide[3:], axis=2).sum(axis=1))
    x, half = (np.arange(depth.shape[1]) + 0.5) * h, done.time >= 0.5 * WEIR_END - 1e-9
    far = np.mean([np.interp(water.CREST - water.BEFORE, x, row) for row in depth[half]])
    area = h * depth[half].sum(axis=1)
    out = water.weir_discharge(broad) - (area[-1] - area[0]) / np.ptp(done.time[half])
    figures = weir_errors(float(far), float(out), broad)
    return {**figures, "seconds": done.seconds, "steps": done.steps, "code_version": done.version}


def weir_errors(far: float, out: float, broad: bool) -> Figures:
    """Coefficient of a weir by the depth before it [m] and the discharge [m^2/s]; error of the depth over the crest."""
    found = water.weir_figures(far, out, broad)
    coefficient, expected = found["coefficient"], found["expected"]
    return {"head": abs((expected / coefficient) ** (2 / 3) - 1), "coefficient": coefficient, "expected": expected}


def tipfem_weir(across: int, broad: bool) -> Figures:
    """tipfem's weir with so many spacings in the depth over it, sharp or broad."""
    simulation = water.weir_simulation(across, broad, air=True)
    figures = timed(simulation, WEIR_END)
    far, out = water.means(simulation, 0.5 * WEIR_END, "far", "through_outlet_drain_water")
    return {**weir_errors(far, -out, broad), **figures}


def tipfem_wave(cells: int, periods: float) -> Figures:
    """tipfem's wave with so many spacings along a side, for so many periods."""
    theory = waves.period(waves.FLOWS["water"][0])
    step = waves.CALM_STEP * math.sqrt(waves.LENGTH / cells / waves.GRAVITY)
    case = waves.build("water", cells, numerics=waves.CALM)
    simulation = tp.Simulation(case, time_step=step, columns={"amplitude": waves.mode})
    start = waves.mode(simulation)
    figures = timed(simulation, periods * theory)
    course = np.array([(0.0, start), *((row["time"], row["amplitude"]) for row in simulation.history)]) / [1.0, start]
    return {**wave_figures(course), **figures}


def tipfem_dam_break(spacing: float) -> Figures:
    """tipfem's dam break with this spacing [m]."""
    case, step = dam_break.build(spacing), dam_break.TIME_STEP
    simulation = tp.Simulation(case, time_step=step, columns={"front": dam_break.front})
    figures = timed(simulation, DAM_END)
    return {**front_figures(*check.fronts_of(simulation.history)), **figures}


def disc_fraction(cells: tuple[int, int], spacing: float, disc: tuple[tuple[float, float], float]) -> Array:
    """A disc, its centre and radius [m], in cells (nx, ny) of a size: (ny, nx) fractions of it."""
    nx, ny = cells
    x, y = ((np.arange(n * SAMPLES) + 0.5) * spacing / SAMPLES for n in (nx, ny))
    (a, b), radius = disc
    inside = (x[None, :] - a) ** 2 + (y[:, None] - b) ** 2 < radius**2
    return np.asarray(inside.reshape(ny, SAMPLES, nx, SAMPLES).mean(axis=(1, 3)))


def interfoam_bubble(cells: int, folder: Path) -> Figures:
    """interFoam's bubble with so many cells across the tank."""
    size, both = 1 / cells, (cells, 2 * cells)
    liquid, bubble = drops.BUBBLE
    tension = TensionTable({("liquid", "bubble"): drops.BUBBLE_TENSION}, drops.BUBBLE, empty=False)
    flow = interfoam.Flow(
        (1.0, 2.0),
        both,
        (bubble, liquid),
        disc_fraction(both, size, drops.BUBBLE_DISC),
        slip=("left", "right"),
        end=BUBBLE_END,
        interval=BUBBLE_INTERVAL,
        courant=0.5,
        largest_step=0.5 * tension.capillary_time(size),
        sigma=drops.BUBBLE_TENSION,
        gravity=drops.BUBBLE_GRAVITY,
    )
    done = interfoam.run(flow, folder)
    y = (np.arange(2 * cells) + 0.5) * size
    height = [float((part.sum(axis=1) @ y) / part.sum()) for part in done.fraction]
    course = np.stack([done.time, np.ones(len(height)), height], axis=1)  # the circularity of fractions is not defined
    errors = drops.against_benchmark(course)[1]
    figures = {name: errors[name] for name in ("height", "velocity")}
    return {**figures, "seconds": done.seconds, "steps": done.steps, "code_version": done.version}


def tipfem_bubble(cells: int) -> Figures:
    """tipfem's bubble with so many spacings across the tank."""
    probe = tp.DropProbe(name="bubble", fluid="bubble")
    simulation = tp.Simulation(drops.rising(cells), probes=[probe])
    figures, course = timed(simulation, BUBBLE_END), simulation.probes["bubble"]
    columns = np.stack([course[name] for name in ("time", "circularity", "y")], axis=1)
    errors = drops.against_benchmark(columns)[1]
    return {**{name: errors[name] for name in ("height", "velocity")}, **figures}


def static_drop(across: int) -> tuple[list[tp.Fluid], float, float, float]:
    """Fluids of the drop at rest, the width of its tank, the spacing, and the end of the run, `STATIC_STEPS` times."""
    fluids = at_rest.pair(1.0, math.sqrt(2 * at_rest.RADIUS / at_rest.LAPLACE))
    spacing = 2 * at_rest.RADIUS / across
    tension = TensionTable({("liquid", "around"): 1.0}, fluids, empty=False)
    return fluids, 5 * at_rest.RADIUS, spacing, STATIC_STEPS * tension.capillary_time(spacing)


def interfoam_drop(across: int, folder: Path) -> Figures:
    """interFoam's drop at rest with so many cells in its diameter."""
    fluids, width, spacing, end = static_drop(across)
    cells = round(width / spacing)
    flow = interfoam.Flow(
        (width, width),
        (cells, cells),
        (fluids[0], fluids[1]),
        disc_fraction((cells, cells), spacing, ((width / 2, width / 2), at_rest.RADIUS)),
        slip=False,
        end=end,
        interval=end / 10,
        courant=0.5,
        largest_step=0.5 * end / STATIC_STEPS,
        sigma=1.0,
        gravity=0.0,
    )
    done = interfoam.run(flow, folder)
    speed = fluids[0].viscosity * float(done.speed[-1])
    return {"capillary_number": speed, "seconds": done.seconds, "steps": done.steps, "code_version": done.version}


def tipfem_drop(across: int) -> Figures:
    """tipfem's drop at rest with so many spacings in its diameter."""
    fluids, width, spacing, end = static_drop(across)
    tank = tp.tank((width, width), spacing).fill(fluids[1])
    simulation = at_rest.simulated(tank.fill(fluids[0], disc=((width / 2, width / 2), at_rest.RADIUS)), fluids)
    figures = timed(simulation, end)
    return {"capillary_number": fluids[0].viscosity * simulation.particles.max_speed, **figures}


def timed(simulation: tp.Simulation, end: float) -> Figures:
    """Run to a time [s]; processor time after the first step, and the number of steps."""
    simulation.step(end)
    begun = time.process_time()
    simulation.run(end, progress=False)
    return {"seconds": time.process_time() - begun, "steps": len(simulation.history), "code_version": tp.__version__}


def alone(function: str, *arguments: float) -> Figures:
    """The figures of a function of this module that runs tipfem, in a process of its own, on one thread.

    Raises:
        RuntimeError: it fails.
    """
    code = (
        "import json; import tipfem as tp; from tipfem.demos.benchmarks import peers; tp.init(threads=1); "
        f"print(json.dumps(peers.{function}(*{arguments!r})))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"tipfem failed: {done.stderr.strip()[-300:]}")
    return dict(json.loads(done.stdout.splitlines()[-1]))


def median(runs: Sequence[Figures]) -> Figures:
    """The medians of numbers of equal runs."""
    return {
        name: value if isinstance(value, str) else statistics.median(run[name] for run in runs)
        for name, value in runs[0].items()
    }


def better(rows: Sequence[Figures]) -> list[str]:
    """Where interFoam is better than tipfem: a sentence for each resolution and figure."""
    lines = []
    for one, other in zip(rows[::2], rows[1::2], strict=True):
        where = f"{one['flow'].replace('_', ' ')}, {one['resolution']}"
        if one["seconds"] < other["seconds"]:
            lines.append(f"{where}: interFoam takes {other['seconds'] / one['seconds']:.1f} times less processor time.")
        for name in ("amplitude", "period", "front_rms", "height", "velocity", "capillary_number", "head"):
            if name in one and one[name] < other[name]:
                errors = f"{one[name]:.2%}, that of tipfem by {other[name]:.2%}"
                lines.append(f"{where}: interFoam's {WORDS[name]} is off by {errors}.")
    return lines or ["interFoam is better in none of these figures."]


def table(rows: Sequence[Figures]) -> str:
    """All figures in Markdown, and where interFoam is better."""
    lines = ["| flow | resolution | code | CPU s | steps | error | further |", "|---|---|---|---|---|---|---|"]
    for row in rows:
        error = row[ERRORS[row["flow"]][0]]
        shown = f"{error:.1e}" if row["flow"] == "static_drop" else f"{error:.2%}"
        further = ", ".join(f"{name} {row[name]:.2%}" for name in ("period", "velocity") if name in row)
        further += f"coefficient {row['coefficient']:.3f} of {row['expected']:.3f}" if "coefficient" in row else ""
        further += f"shift {row['shift']:.3f} T" if "shift" in row else ""
        lines.append(
            f"| {row['flow'].replace('_', ' ')} | {row['resolution']} | {row['code']} {row['code_version']} "
            f"| {row['seconds']:.1f} | {row['steps']:.0f} | {shown} | {further} |"
        )
    return "\n".join([*lines, "", "Where interFoam is better:", "", *(f"- {line}" for line in better(rows)), ""])


def plot(out: Path, rows: Sequence[Figures]) -> None:
    """Draw peers.png, error against cost, and time.png, processor time side by side.

    Raises:
        ImportError: there is no matplotlib.
    """
    from matplotlib.ticker import LogLocator

    flows = list(dict.fromkeys(row["flow"] for row in rows))
    for name, size in (("peers", 5.4), ("time", 5.4)):
        figure = new_figure(size * len(flows), 4.4)
        for axes, flow in zip(np.atleast_1d(figure.subplots(1, len(flows))), flows, strict=True):
            key, label = ERRORS[flow]
            for number, code in enumerate(CODES):
                colour = COLOURS[number]
                own = [row for row in rows if row["flow"] == flow and row["code"] == code]
                seconds = [row["seconds"] for row in own]
                if name == "time":
                    bars = axes.bar(np.arange(len(own)) + 0.4 * number, seconds, 0.38, color=colour, label=code)
                    axes.bar_label(bars, fmt="%.1f")
                    axes.set_xticks(np.arange(len(own)) + 0.2, [row["resolution"] for row in own])
                    axes.set_ylabel("processor time [s]")
                    axes.margins(y=0.1)
                else:
                    style = {"color": colour, "marker": MARKERS[number]}
                    axes.loglog(seconds, [row[key] for row in own], label=code, **style)
                    for row, x in zip(own, seconds, strict=True):
                        axes.annotate(row["resolution"], (x, row[key]), (4, 5), textcoords="offset points", fontsize=8)
                    axes.set_xlabel("processor time [s]")
                    axes.set_ylabel(label)
                    for axis in (axes.xaxis, axes.yaxis):
                        axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
                        axis.set_major_formatter("{x:g}")
                        axis.set_minor_formatter("")
                    axes.margins(0.15)
                    axes.grid(alpha=0.3, which="both")
            axes.set_title(flow.replace("_", " "))
            axes.legend()
        save(figure, out / f"{name}.png")


def commit() -> str:
    """The commit of this tipfem, where it is a clone."""
    words = ["git", "rev-parse", "--short", "HEAD"]
    told = subprocess.run(words, capture_output=True, text=True, check=False, cwd=Path(__file__).parent)
    return told.stdout.strip() or "unknown"


def keep(path: Path, rows: Sequence[Figures], command: str, commit: str) -> None:
    """Add figures to a table that has those of earlier versions: one row a figure, with its commit and command."""
    begun = not path.exists()
    path.parent.mkdir(parents=True, exist_ok=True)
    today = datetime.datetime.now(datetime.timezone.utc).date().isoformat()
    units = {"seconds": "s CPU", "steps": "", "amplitude": "1", "period": "1", "front_rms": "1", "shift": "T"}
    units |= dict.fromkeys(("height", "velocity", "capillary_number", "head", "coefficient", "expected"), "1")
    units |= {"step": "ms", "first_step": "s", "newton": "", "krylov": "", "memory": "MB"}
    with path.open("a", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        if begun:
            writer.writerow(KEPT)
        for row in rows:
            head = (today, row["code_version"], commit, machine(), command)
            for name in units.keys() & row.keys():
                value = f"{row[name]:.4g}"
                writer.writerow((*head, row["flow"], row["code"], row["resolution"], name, value, units[name]))


def machine() -> str:
    """The processor's name, where the system tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), platform.machine())


def main(
    *,
    only: Several[Literal["wave", "dam_break", "weir", "broad_weir", "bubble", "static_drop"]] = (
        "wave",
        "dam_break",
        "weir",
        "broad_weir",
        "bubble",
        "static_drop",
    ),
    across: Counts = (20, 40),
    diameter: Counts = (8, 16),
    over: Counts = (6, 12),
    spacing: Positives = (0.01, 0.005),
    periods: Positive = 5.0,
    scheme: Literal["euler", "crank-nicolson"] = "euler",
    rounds: Count = 3,
    keep_in: Path | None = None,
    out: Path = Path("out/peers"),
) -> int:
    """Run both codes in turns.

    Args:
        only: which flows.
        across: cells or spacings along the wave's tank, and across the bubble's.
        diameter: cells or spacings in the diameter of the drop at rest.
        over: cells or spacings in the depth of the water over a weir.
        spacing: sizes of the dam break's cells, or distances between particles [m].
        periods: how long the waves run.
        scheme: time integration of interFoam's wave.
        rounds: turns of both codes, whose medians are told.
        keep_in: a CSV file that the figures are added to, such as demos/benchmarks/figures.csv.
        out: folder for tables, pictures and interFoam's cases.
    """
    interfoam.require()
    out.mkdir(parents=True, exist_ok=True)
    # What differs between the runs of a flow, its name, interFoam's run and tipfem's.
    flows: dict[str, tuple[Sequence[Any], Callable[[Any], str], Callable[..., Figures], Callable[..., Figures]]] = {
        "wave": (
            across,
            "{} across".format,
            lambda n, folder: interfoam_wave(n, periods, scheme, folder),
            lambda n: alone("tipfem_wave", n, periods),
        ),
        "dam_break": (
            spacing,
            lambda h: f"{h * 1e3:g} mm",
            interfoam_dam_break,
            lambda h: alone("tipfem_dam_break", h),
        ),
        "weir": (
            over,
            "{} over the crest".format,
            lambda n, folder: interfoam_weir(n, False, folder),
            lambda n: alone("tipfem_weir", n, False),
        ),
        "broad_weir": (
            over,
            "{} over the crest".format,
            lambda n, folder: interfoam_weir(n, True, folder),
            lambda n: alone("tipfem_weir", n, True),
        ),
        "bubble": (across, "{} across".format, interfoam_bubble, lambda n: alone("tipfem_bubble", n)),
        "static_drop": (diameter, "{} in the diameter".format, interfoam_drop, lambda n: alone("tipfem_drop", n)),
    }
    rows: list[Figures] = []
    begun_with = commit()  # the files may change while it runs
    for flow, (values, resolution_of, interfoam_run, tipfem_run) in flows.items():
        for value in values if flow in only else ():
            resolution = resolution_of(value)
            folder = out / f"{flow}_{resolution.replace(' ', '_')}"
            turns = [(interfoam_run(value, folder), tipfem_run(value)) for _ in range(rounds)]
            for code, runs in zip(CODES, zip(*turns, strict=True), strict=True):
                rows.append({"flow": flow, "resolution": resolution, "code": code, **median(runs)})
                cost = f"{rows[-1]['seconds']:.1f} s, {rows[-1]['steps']:.0f} steps"
                print(f"{flow}, {resolution}, {code}: {cost}", flush=True)
    (out / "peers.md").write_text(table(rows), encoding="utf-8")
    print(table(rows))
    if keep_in is not None:
        words = [f"--only {' '.join(only)}", f"--rounds {rounds}", f"--periods {periods:g}", f"--scheme {scheme}"]
        keep(keep_in, rows, " ".join(["tipfem demo benchmarks/peers", *words]), begun_with)
    plot(out, rows)
    return harness.report(out, {"figures": rows}, [])


if __name__ == "__main__":
    harness.command(__name__)
