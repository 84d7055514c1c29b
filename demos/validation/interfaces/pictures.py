"""Pictures of the comparison of interface rules."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from tipfem.demos.support.figures import BLUE, VERMILION, new_figure, save

import tipfem as tp

Array = NDArray[Any]
STYLE: dict[str, dict[str, Any]] = {
    "interpolated": {"color": VERMILION, "linestyle": "--", "linewidth": 2.0},
    "sharp": {"color": BLUE, "linestyle": "-", "linewidth": 2.0},
}
FILL = [BLUE, "#F0F0F0"]  # the first fluid, and the second


class State(NamedTuple):
    """What a picture of a simulation needs: time [s], positions (N, 2) [m], cells, fluids of particles and cells."""

    time: float
    position: Array
    cells: Array
    fluid: Array
    cell_fluid: Array | None

    @staticmethod
    def of(simulation: tp.Simulation) -> State:
        """The present one, copied."""
        mesh, particles = simulation.mesh, simulation.particles
        return State(simulation.time, particles.position.copy(), mesh.cells.copy(), particles.fluid.copy(), mesh.fluid)


def _label(axes: Any, title: str, x: str, y: str) -> None:
    axes.set_title(title, fontsize=14)
    axes.set_xlabel(x, fontsize=13)
    axes.set_ylabel(y, fontsize=13)
    axes.tick_params(labelsize=12)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=11)


def rest(path: Path, speeds: Mapping[str, Mapping[tuple[str, str], tuple[Array, Array]]]) -> None:
    """Largest speed over time of fluids at rest.

    speeds: pair -> (rule, how gravity points) -> time [s] (K,) and speed [m/s] (K,).
    """
    figure = new_figure(11.0, 4.6, dpi=120)
    row = figure.subplots(1, len(speeds))
    for axes, (pair, curves) in zip(row, speeds.items(), strict=True):
        for (rule, gravity), (time, speed) in curves.items():
            style = {**STYLE[rule], "linestyle": "-" if gravity == "level" else ":"}
            axes.semilogy(time, np.maximum(speed, 1e-16), label=f"{rule}, {gravity}", **style)
        axes.set_ylim(1e-14, 1e1)
        _label(axes, pair, "t [s]", "largest speed [m/s]")
        axes.legend(fontsize=11, ncols=2, loc="center")
    save(figure, path)


def states(path: Path, shown: Mapping[str, Sequence[State]], size: Sequence[float]) -> None:
    """The fluids at some times, a row a time and a column a rule, each interface where the rule has it.

    size: what is shown, from the origin [m].
    """
    from matplotlib.colors import ListedColormap

    times = next(iter(shown.values()))
    figure = new_figure(5.6 * len(shown), 3.7 * len(times), dpi=120)
    grid = figure.subplots(len(times), len(shown), squeeze=False)
    for column, (rule, several) in enumerate(shown.items()):
        for axes, state in zip(grid[:, column], several, strict=True):
            x, y = state.position.T
            if state.cell_fluid is None:  # through the middle of the edges: where interpolated labels are one half
                axes.tricontourf(x, y, state.cells, state.fluid.astype(float), levels=[-1, 0.5, 2], colors=FILL)
            else:
                axes.tripcolor(
                    x,
                    y,
                    state.cells,
                    facecolors=state.cell_fluid.astype(float),
                    cmap=ListedColormap(FILL),
                    vmin=0,
                    vmax=1,
                    antialiased=False,
                )
            axes.set_aspect("equal")
            axes.set_xlim(0, size[0])
            axes.set_ylim(0, size[1])
            axes.set_title(f"{rule}, t = {state.time:.2f} s", fontsize=14)
            axes.tick_params(labelsize=12)
            axes.label_outer()
    for axes in grid[-1]:
        axes.set_xlabel("x [m]", fontsize=13)
    for axes in grid[:, 0]:
        axes.set_ylabel("y [m]", fontsize=13)
    save(figure, path)


def budget(path: Path, histories: Mapping[str, Sequence[Mapping[str, float]]], volume: Mapping[str, float]) -> None:
    """Energy lost, sizes of the momentum that remeshing adds, summed, and the error of volume of dam breaks over time.

    histories: rule -> rows of history.csv.  volume: rule -> the water's at the start [m^2].
    """
    figure = new_figure(14.0, 4.6, dpi=120)
    energy, momentum, error = figure.subplots(1, 3)
    for rule, history in histories.items():
        table = {name: np.array([line[name] for line in history]) for name in history[0]}
        t, style = table["time"], STYLE[rule]
        lost = np.cumsum(table["viscous_dissipation"] + table["numerical_dissipation"])
        energy.plot(t, lost, label=f"{rule}: all", **style)
        thin = {**style, "linewidth": 1.2, "marker": "o", "markevery": max(len(t) // 8, 1), "mfc": "none"}
        energy.plot(t, np.cumsum(table["remeshing_dissipation"]), label=f"{rule}: by remeshing", **thin)
        added = np.hypot(table["remeshing_momentum_x"], table["remeshing_momentum_y"])
        momentum.plot(t, np.cumsum(added), label=rule, **style)
        change = np.abs(table["volume_water"] / volume[rule] - 1)
        error.semilogy(t, np.maximum(change, 1e-16), label=rule, **style)
    _label(energy, "Energy lost", "t [s]", "[J/m]")
    _label(momentum, "Momentum changed by remeshing", "t [s]", "[N s/m]")
    _label(error, "Change of the water's volume", "t [s]", "relative")
    save(figure, path)


def decay(path: Path, curves: Mapping[str, tuple[Array, Array]]) -> None:
    """Kinetic energy over time: rule -> time [s] and energy over its largest (K,)."""
    figure = new_figure(8.0, 4.8, dpi=120)
    axes = figure.add_subplot()
    for rule, (time, energy) in curves.items():
        axes.semilogy(time, energy, label=rule, **STYLE[rule])
    _label(axes, "Two viscous layers come to rest", "t [s]", "kinetic energy / largest")
    save(figure, path)
