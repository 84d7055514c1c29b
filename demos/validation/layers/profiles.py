"""Profiles along the height of a tank: pressure against that of layers at rest, density and viscosity."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tipfem.demos.support.figures import COLOURS, new_figure, save

import tipfem as tp
from tipfem.mesh import measures

Array = NDArray[np.float64]
Layers = Sequence[tuple[tp.Fluid, float]]
MARKERS = ("o", "x", "s", "+")


def along_height(simulation: tp.Simulation, count: int = 1500) -> tuple[Array, Array, Array]:
    """Density and viscosity of the elements along the middle of a 2-D tank, as the solver has them.

    Returns:
        Heights (K,) [m], densities (K,) [kg/m^3] and viscosities (K,) [Pa s].
    """
    from matplotlib.tri import Triangulation

    position = simulation.mesh.position
    low, high = position.min(axis=0), position.max(axis=0)
    # Slightly off the middle, so that the line does not run along edges.
    x = low[0] + (0.5 + 1e-4) * (high[0] - low[0])
    y = np.linspace(low[1], high[1], count + 2)[1:-1]
    triangulation = Triangulation(position[:, 0], position[:, 1], simulation.mesh.cells)
    element = np.asarray(triangulation.get_trifinder()(np.full_like(y, x), y))
    material, found = simulation.state.material, element >= 0
    return y[found], material.density[element[found]], material.viscosity[element[found]]


class PressureWatch:
    """The largest error of pressure against layers at rest, as a column of the history; its mean over a time.

    Args:
        layers: (fluid, thickness [m]) from the floor up.
        gravity: magnitude [m/s^2].
        since: time from which on the mean is taken [s].
        bins: along the height, for the mean.
    """

    def __init__(self, layers: Layers, gravity: float, since: float, bins: int = 40) -> None:
        self.layers, self.gravity, self.since = layers, gravity, since
        top = sum(thickness for _, thickness in layers)
        self._edges = np.linspace(0.0, top, bins + 1)
        self._sum, self._weight, self._time = np.zeros(bins), np.zeros(bins), since
        self.largest = float(self.exact(np.zeros(1))[0])

    def exact(self, height: Array) -> Array:
        """Pressure (K,) [Pa] of the layers at rest at heights (K,) [m]."""
        return measures.hydrostatic_pressure(height, self.layers, self.gravity)

    def __call__(self, simulation: tp.Simulation) -> float:
        """The largest error of a particle's pressure over the largest pressure; the step is added to the mean."""
        particles = simulation.particles
        height = particles.position[:, 1]
        error = (particles.pressure - self.exact(height)) / self.largest
        if simulation.time > self.since:
            step, self._time = simulation.time - self._time, simulation.time
            number = np.clip(np.searchsorted(self._edges, height) - 1, 0, len(self._sum) - 1)
            self._sum += step * np.bincount(number, weights=error, minlength=len(self._sum))
            self._weight += step * np.bincount(number, minlength=len(self._sum))
        return float(np.abs(error).max())

    @property
    def mean(self) -> tuple[Array, Array]:
        """Middles of the bins (K,) [m] that held particles, and the mean error (K,) there, part of the largest."""
        held = self._weight > 0
        middle = 0.5 * (self._edges[1:] + self._edges[:-1])
        return middle[held], self._sum[held] / self._weight[held]


def plot_layers(path: Path, states: Mapping[str, tp.Simulation], layers: Layers, gravity: float) -> Path:
    """Draw pressure, density and viscosity along the height of a tank of layers at rest.

    Args:
        path: of the picture, which is returned.
        states: label -> simulation at that time; properties are the last one's.
        layers: (fluid, thickness [m]) from the floor up.
        gravity: magnitude [m/s^2].

    Raises:
        ImportError: there is no matplotlib.
    """
    figure = new_figure(13.0, 5.2, dpi=130)
    pressure, density, viscosity = figure.subplots(1, 3, sharey=True, width_ratios=(1.6, 1, 1))
    _pressure(pressure, states, layers, gravity)
    y, rho, mu = along_height(list(states.values())[-1])
    top = np.cumsum([0.0, *(thickness for _, thickness in layers)])
    for axes, values, attribute, text in (
        (density, rho, "density", "density [kg/m³]"),
        (viscosity, mu, "viscosity", "viscosity [Pa s]"),
    ):
        exact = [getattr(fluid, attribute) for fluid, _ in layers]
        axes.plot(np.repeat(exact, 2), np.repeat(top, 2)[1:-1], color="black", linewidth=4, alpha=0.35, label="fluids")
        axes.plot(values, y, color=COLOURS[0], linewidth=1.6, label="elements")
        axes.set_xlabel(text, fontsize=12)
        axes.grid(alpha=0.3)
    viscosity.set_xscale("log")
    if min(fluid.density for fluid, _ in layers) < 0.1 * max(fluid.density for fluid, _ in layers):
        density.set_xscale("log")
    density.legend(fontsize=11, loc="best")
    return save(figure, path)


def plot_pressure(path: Path, simulation: tp.Simulation, watch: PressureWatch) -> Path:
    """Draw a state's pressure along the height, and its mean over a time, against that of layers at rest.

    Args:
        path: of the picture, which is returned.
        simulation: at the end of the time.
        watch: that saw the run.

    Raises:
        ImportError: there is no matplotlib.
    """
    figure = new_figure(7.5, 5.6, dpi=130)
    axes = figure.add_subplot()
    _pressure(axes, {f"t = {simulation.time:g} s": simulation}, watch.layers, watch.gravity)
    height, error = watch.mean
    axes.plot(
        watch.exact(height) + error * watch.largest,
        height,
        MARKERS[1],
        color=COLOURS[1],
        markersize=8,
        markeredgewidth=1.8,
        linestyle="none",
        label=f"mean over {watch.since:g} to {simulation.time:g} s",
    )
    axes.legend(fontsize=11, loc="upper right")
    return save(figure, path)


def _pressure(axes: Any, states: Mapping[str, tp.Simulation], layers: Layers, gravity: float) -> None:
    height = np.linspace(0.0, sum(thickness for _, thickness in layers), 400)
    for number, (label, simulation) in enumerate(states.items()):
        particles = simulation.particles
        axes.plot(
            particles.pressure,
            particles.position[:, 1],
            MARKERS[number],
            color=COLOURS[number],
            markersize=5,
            markerfacecolor="none",
            markeredgewidth=1.0,
            linestyle="none",
            label=label,
        )
    exact = measures.hydrostatic_pressure(height, layers, gravity)
    axes.plot(exact, height, color="black", linewidth=1.4, label="analytic")
    for place in np.cumsum([thickness for _, thickness in layers])[:-1]:
        axes.axhline(place, color="black", linewidth=0.8, linestyle=":")
    axes.set_xlabel("pressure [Pa]", fontsize=12)
    axes.set_ylabel("height [m]", fontsize=12)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=11, loc="upper right")
