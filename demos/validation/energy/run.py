"""Where the energy of a dam break goes: viscosity, time integration, pressure, remeshing.

Runs the dam break of water in air until shortly before the water hits the far wall, once for
each spectral radius rho_inf of the time integration, and adds up the budget of every step's history:

    summary.json      figures of all runs
    table.md          the same as a table
    energy.png        kinetic and potential energy, and what was dissipated by what, over time
    rho_inf_<...>/    history.csv and summary.json of each run

    python -m tipfem demo validation/energy --spacing 0.01 --rho-inf 0 0.8
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tipfem.demos import harness
from tipfem.demos.support.figures import BLUE, GREEN, ORANGE, PURPLE, VERMILION, new_figure, save
from tipfem.demos.support.options import Arch, Positive, Rule, Several
from tipfem.demos.validation.dam_break import case as dam_break

import tipfem as tp

PARTS = ("time", "geometry", "stabilisation", "source", "newton", "remeshing")
SPACING = 0.01  # [m]
END_TIME = 0.25  # [s], before the impact
TIME_STEP = 1e-3  # [s]
LARGEST_RESIDUAL = 0.01  # of what was dissipated: how far the balance may be from closing
LARGEST_MOMENTUM_RESIDUAL = 5e-4  # of gravity's impulse, at the default tolerance of Newton's method


def measure(
    spacing: float = SPACING,
    *,
    rho_inf: float = 0.0,
    interface: str = "interpolated",
    end_time: float = END_TIME,
    time_step: float = TIME_STEP,
    out: str | Path | None = None,
    **numerics: Any,
) -> tuple[dict[str, float], list[dict[str, float]]]:
    """Run the dam break and add up its budget.

    Args:
        spacing: distance between particles [m].
        rho_inf: of the time integration, 0 to 1.
        interface: rule for elements between two fluids; one of `tipfem.case.case.INTERFACES`.
        end_time: end of the run [s].
        time_step: largest time step [s].
        out: folder for the history, or None.
        numerics: further numbers of the method, as `tp.Numerics` has them.

    Returns:
        The figures, see `figures`, and the history.

    Raises:
        ValueError: an argument is out of range.
        SimulationError: the run cannot go on.
    """
    case = dam_break.build(
        spacing, law="no-slip", interface=interface, numerics=tp.Numerics(rho_inf=rho_inf, **numerics)
    )
    simulation = tp.Simulation(case, out, time_step=time_step)
    start = simulation.energy()
    simulation.run(end_time)
    result = {"spacing": spacing, "rho_inf": rho_inf, **figures(simulation.history, sum(start))}
    simulation.write_summary({"status": "complete", "budget": result})
    return result, simulation.history


def figures(history: Sequence[Mapping[str, float]], start: float) -> dict[str, float]:
    """The budget of a whole run, all energies in J per metre of depth.

    Args:
        history: the simulation's history, one row per step.
        start: kinetic and potential energy at the run's beginning [J].

    Returns:
        Energies at the end; what was dissipated by what; `closure`, the sum of the absolute residuals of energy
        over what was dissipated; `momentum_closure`, the largest residual of momentum over gravity's impulse of
        the step; what remeshing added to momentum, as its sum and as the sum of its absolute values [N s]; the
        largest volume of water that the solve and that remeshing moved in a step, over that of all water.
    """

    def column(name: str) -> NDArray[np.float64]:
        return np.array([row[name] for row in history])

    end = history[-1]
    dissipated = column("viscous_dissipation") + column("numerical_dissipation")
    weight = dam_break.GRAVITY * (
        column("volume_water") * dam_break.WATER.density + column("volume_air") * dam_break.AIR.density
    )
    left = np.hypot(column("momentum_residual_x"), column("momentum_residual_y"))
    parts = {f"{part}_dissipation": float(column(f"{part}_dissipation").sum()) for part in PARTS}
    return {
        "steps": len(history),
        "end_time": end["time"],
        "kinetic_energy": end["kinetic_energy"],
        "potential_energy": end["potential_energy"],
        "lost_energy": start - end["kinetic_energy"] - end["potential_energy"],
        "viscous_dissipation": float(column("viscous_dissipation").sum()),
        "numerical_dissipation": float(column("numerical_dissipation").sum()),
        **parts,
        "remeshing_absolute": float(np.abs(column("remeshing_dissipation")).sum()),
        "remeshing_potential_energy": float(column("remeshing_potential_energy").sum()),
        "energy_residual": float(column("energy_residual").sum()),
        "closure": float(np.abs(column("energy_residual")).sum() / abs(dissipated.sum())),
        "momentum_closure": float((left / (column("time_step") * weight)).max()),
        "remeshing_momentum_x": float(column("remeshing_momentum_x").sum()),
        "remeshing_momentum_y": float(column("remeshing_momentum_y").sum()),
        "remeshing_momentum_absolute": float(
            np.hypot(column("remeshing_momentum_x"), column("remeshing_momentum_y")).sum()
        ),
        "solve_volume": float(np.abs(column("solve_volume_water") / column("volume_water")).max()),
        "remeshing_volume": float(np.abs(column("remeshing_volume_water") / column("volume_water")).max()),
    }


def check(result: Mapping[str, float]) -> list[str]:
    """What a run misses of what is expected of it; an empty list when all is well."""
    missed = []
    if not result["closure"] <= LARGEST_RESIDUAL:
        missed.append(f"the energy closes to {result['closure']:.2%} of what was dissipated, not to 1 %")
    if not result["momentum_closure"] <= LARGEST_MOMENTUM_RESIDUAL:
        missed.append(f"momentum closes to {result['momentum_closure']:.1e} of gravity's impulse")
    unexplained = result["lost_energy"] - result["viscous_dissipation"] - result["numerical_dissipation"]
    if not abs(unexplained) <= abs(LARGEST_RESIDUAL * result["lost_energy"]):
        missed.append("what was lost is not what was dissipated")
    return missed


ROWS = {
    "steps": "steps",
    "kinetic_energy": "kinetic energy at the end [J/m]",
    "lost_energy": "energy lost [J/m]",
    "viscous_dissipation": "by viscosity [J/m]",
    "numerical_dissipation": "numerically [J/m]",
    "time_dissipation": "- time integration [J/m]",
    "geometry_dissipation": "- pressure on J at n + 1 against the intermediate positions [J/m]",
    "stabilisation_dissipation": "- stabilisation of pressure [J/m]",
    "source_dissipation": "- volume source [J/m]",
    "remeshing_dissipation": "- remeshing, relocation, transfer of momentum [J/m]",
    "remeshing_absolute": "the same, sum of its absolute values [J/m]",
    "closure": "what is left, part of the energy lost",
    "momentum_closure": "momentum that no force accounts for, part of gravity's impulse",
    "remeshing_momentum_x": "horizontal momentum added by remeshing [N s/m]",
    "remeshing_momentum_y": "vertical momentum added by remeshing [N s/m]",
    "solve_volume": "water's volume: largest change in a solve",
    "remeshing_volume": "water's volume: largest change by a remeshing",
}


def table(results: Sequence[Mapping[str, float]]) -> str:
    """Figures of several runs as a table in Markdown, a column each."""
    lines = ["| | " + " | ".join(f"{r['spacing'] * 1e3:g} mm, rho_inf {r['rho_inf']:g}" for r in results) + " |"]
    lines.append("|---|" + "---|" * len(results))
    lines += [f"| {text} | " + " | ".join(f"{r[name]:.3g}" for r in results) + " |" for name, text in ROWS.items()]
    return "\n".join(lines) + "\n"


def plot(path: Path, runs: Mapping[str, Sequence[Mapping[str, float]]]) -> None:
    """Draw the budgets of runs, label -> history: energies gained and lost, and the parts of the dissipation.

    Raises:
        ImportError: there is no matplotlib.
    """
    figure = new_figure(10.0, 4.2 * len(runs), dpi=120)
    axes = figure.subplots(len(runs), 2, squeeze=False)
    colors = (BLUE, VERMILION, GREEN, ORANGE, PURPLE, "#888888", "#000000")
    for (energies, parts), (label, history) in zip(axes, runs.items(), strict=True):
        t = np.array([row["time"] for row in history])
        kinetic, potential, viscous, numerical = (
            np.array([row[name] for row in history])
            for name in ("kinetic_energy", "potential_energy", "viscous_dissipation", "numerical_dissipation")
        )
        fallen = (potential + kinetic + np.cumsum(viscous + numerical))[0] - potential
        energies.plot(t, fallen, color=colors[0], label="potential energy given up")
        energies.plot(t, kinetic, color=colors[1], label="kinetic energy")
        energies.plot(t, np.cumsum(viscous + numerical), color=colors[-1], label="dissipated")
        for name, color in zip((*PARTS, "viscous"), colors, strict=True):
            total = np.cumsum([row[f"{name}_dissipation"] for row in history])
            parts.plot(t, total, color=color, label=name if name != "viscous" else "viscosity")
        energies.set_title(f"{label}: energy [J/m]")
        parts.set_title(f"{label}: dissipated by [J/m]")
        for each in (energies, parts):
            each.set_xlabel("t [s]")
            each.grid(alpha=0.3)
            each.legend(fontsize=9)
    save(figure, path)


def main(
    *,
    spacing: Positive = SPACING,
    end_time: Positive = END_TIME,
    time_step: Positive = TIME_STEP,
    rho_inf: Several[float] = (0.0, 0.8),
    interface: Rule = "interpolated",
    arch: Arch = "cpu",
    out: Path = Path("out/validation/energy"),
) -> int:
    """Run the dam break with each time integration.

    Args:
        spacing: distance between particles [m].
        end_time: simulated time to run to [s].
        time_step: largest time step [s].
        rho_inf: of generalized-alpha, 0 to 1.
        interface: rule for the elements between two fluids.
        arch: where the kernels run.
        out: folder for the results.
    """
    tp.init(arch=arch)
    results: list[dict[str, float]] = []
    runs: dict[str, list[dict[str, float]]] = {}
    for rho in rho_inf:
        result, runs[f"rho_inf = {rho:g}"] = measure(
            spacing,
            rho_inf=rho,
            interface=interface,
            end_time=end_time,
            time_step=time_step,
            out=out / f"rho_inf_{rho:g}",
        )
        results.append(result)
    (out / "table.md").write_text(table(results), encoding="utf-8")
    plot(out / "energy.png", runs)
    print(table(results))
    missed = [f"rho_inf {r['rho_inf']:g}: {text}" for r in results for text in check(r)]
    return harness.report(out, {"interface": interface, "runs": results}, missed)


if __name__ == "__main__":
    harness.command(__name__)
