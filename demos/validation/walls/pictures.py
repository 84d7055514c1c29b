"""Pictures of the flows along walls."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tipfem.demos.support.figures import COLOURS, DASHES, MARKERS, new_figure, save

import tipfem as tp

Array = NDArray[np.float64]


def _figure(columns: int, width: float = 11.0) -> tuple[Any, Any]:
    figure = new_figure(width, 5.0)
    axes = figure.subplots(1, columns, squeeze=False)[0]
    for one in axes:
        one.tick_params(labelsize=12)
        one.grid(alpha=0.3)
    return figure, axes


def _label(axes: Any, title: str, x: str, y: str) -> None:
    axes.set_title(title, fontsize=14)
    axes.set_xlabel(x, fontsize=13)
    axes.set_ylabel(y, fontsize=13)


def decay(
    path: Path, histories: Mapping[int, Array], time: float, cells: Sequence[int], errors: Sequence[float]
) -> None:
    """Decay of the Taylor-Green vortex, and its errors against the spacing.

    histories: (2, K) time [s] and amplitude by cells a side; time: to 1/e [s]; errors: RMS of velocity [m/s].
    """
    figure, (left, right) = _figure(2)
    t = np.linspace(0, time, 100)
    left.plot(t, np.exp(-t / time), "k-", linewidth=1.2, label=r"$\exp(-2\nu k^2 t)$")
    for k, (number, (at, amplitude)) in enumerate(histories.items()):
        every = max(len(at) // 9, 1)
        label = f"{number} cells a side"
        left.plot(at[::every], amplitude[::every], MARKERS[k], color=COLOURS[k], mfc="none", label=label)
    _label(left, "Taylor-Green vortex, free slip", "t [s]", "amplitude / initial")
    left.legend(fontsize=11)
    h = 1 / np.array(cells)
    right.loglog(h, errors, "o-", color=COLOURS[0], label="RMS of velocity")
    right.loglog(h, errors[-1] * (h / h[-1]) ** 2, "k--", linewidth=1.2, label="second order")
    _label(right, "Convergence", "h [m]", "error [m/s]")
    right.legend(fontsize=11)
    save(figure, path)


def profiles(path: Path, curves: Mapping[str, tuple[Array, Array, Callable[[Array], Array]]]) -> None:
    """u / U over the height of long cavities: by name y, measured u and the exact function."""
    figure, axes = _figure(1, 7.5)
    fine = np.linspace(0, 1, 200)
    for k, (name, (y, u, exact)) in enumerate(curves.items()):
        axes[0].plot(exact(fine), fine, DASHES[k], color=COLOURS[k], label=f"{name}, closed form")
        axes[0].plot(u, y, MARKERS[k], color=COLOURS[k], mfc="none", label=f"{name}, tipfem")
    _label(axes[0], "Middle of a long cavity under a lid", "u / U", "y / H")
    axes[0].legend(fontsize=10)
    save(figure, path)


def cavity(path: Path, curves: Mapping[int, Sequence[tuple[Array, Array, Array]]]) -> None:
    """Centre lines of the driven cavity: by Reynolds number (place, reference, measured) of u and of v."""
    figure, axes = _figure(2)
    for k, (reynolds, lines) in enumerate(curves.items()):
        for one, (place, reference, measured) in zip(axes, lines, strict=True):
            order = np.argsort(place)
            one.plot(place, reference, MARKERS[k], color=COLOURS[k], mfc="none", label=f"Re {reynolds}, Ghia et al.")
            one.plot(place[order], measured[order], DASHES[k], color=COLOURS[k], label=f"Re {reynolds}, tipfem")
    _label(axes[0], "Driven cavity, x = 1/2", "y", "u / U")
    _label(axes[1], "Driven cavity, y = 1/2", "x", "v / U")
    axes[0].legend(fontsize=11)
    save(figure, path)


def slosh(path: Path, simulation: tp.Simulation, time: Array, moment: Array, linear: Array) -> None:
    """The two layers in a tank that sways, and the lower one's first moments (K,) [m^3] over time (K,) [s]."""
    figure, (left, right) = _figure(2)
    mesh, fluid = simulation.mesh, simulation.particles.fluid
    left.tripcolor(*mesh.position.T, mesh.cells, fluid[mesh.cells].mean(axis=1), cmap="cividis_r", linewidth=0)
    left.set_aspect("equal")
    _label(left, f"Two layers in a tank that sways, t = {simulation.time:g} s", "x [m]", "y [m]")
    right.plot(time, linear, "k-", linewidth=1.2, label="linear theory")
    every = max(len(time) // 30, 1)
    right.plot(time[::every], moment[::every], "o", color=COLOURS[1], mfc="none", label="tipfem")
    _label(right, "First moment of the lower layer", "t [s]", "m³ per metre")
    right.legend(fontsize=11)
    save(figure, path)


def arrows(path: Path, position: Array, velocity: Array, exact: Array) -> None:
    """Velocities (N, 2) at positions (N, 2) [m] in a rolled tank, over those in closed form."""
    figure, axes = _figure(1, 6.5)
    series = ((exact, COLOURS[1], 0.006, "closed form"), (velocity, "#000000", 0.002, "tipfem"))
    for values, colour, width, label in series:
        axes[0].quiver(*position.T, *values.T, color=colour, width=width, scale=4.0, label=label)
    axes[0].set_aspect("equal")
    _label(axes[0], "Rolled tank, free slip", "x [m]", "y [m]")
    figure.legend(fontsize=11, loc="outside lower center", ncols=2)
    save(figure, path)


def pistons(path: Path, simulation: tp.Simulation, time: Array, mean: Array) -> None:
    """The mesh between two pistons, and the mean velocity (K,) [m/s] over time (K,) [s]."""
    figure, (left, right) = _figure(2)
    left.triplot(*simulation.mesh.position.T, simulation.mesh.cells, color=COLOURS[0], linewidth=0.5)
    left.axvline(0.0, color="k", linestyle="--", linewidth=1.2)
    left.axvline(1.0, color="k", linestyle="--", linewidth=1.2)
    left.set_aspect("equal")
    _label(left, f"Pistons at t = {simulation.time:g} s (dashed: at the start)", "x [m]", "y [m]")
    right.plot(time, 0.3 * np.sin(2 * time), "k-", linewidth=1.2, label="speed of the pistons")
    right.plot(time[::8], mean[::8], "o", color=COLOURS[1], mfc="none", label="mean of the fluid")
    _label(right, "Flow between them", "t [s]", "u [m/s]")
    right.legend(fontsize=11)
    save(figure, path)
