"""Checks of the demos that have no reference: volumes, energies, and where the fluids end."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tipfem.demos import harness
from tipfem.demos.support.figures import COLOURS, DASHES, new_figure, plot_lines, save
from tipfem.demos.validation.dam_break.check import front_figures

import tipfem as tp
from tipfem.mesh import measures

Array = NDArray[np.float64]

# The drop: the largest figures that a run may show.
LARGEST_DROP_VOLUME_ERROR = 0.01  # of each fluid
LARGEST_SPEED = 8.0  # at any time, of the air that gives way too; the drop meets the water at 0.6 [m/s]
SUNK_AFTER = 1.0  # [s]; from then on:
LARGEST_DRY = 0.02  # part of the glycerin that is above the water's depth at the start
HIGHEST_CENTRE = 0.5  # of the drop's centre of mass, in water depths: it lies on the floor

# A column in 3-D: the largest figures that a run may show.
LARGEST_COLLAPSE = {"volume_error": 1e-9, "gain": 0.02, "front_ahead": 1.0}
REACHED_AFTER = 2.5  # times the front's least time to the far wall, by which it must be there

# Oil on water: the largest figures that a run may show.
LARGEST_OIL_VOLUME_ERROR = 1e-12  # of each fluid
BEFORE_IMPACT = 0.25  # [s]; until then the oil must be on top
LARGEST_GAIN = 1e-4  # of energy above that of the start, relative to what potential energy can give
LARGEST_RMS = 0.05  # of dZ/Z against Martin & Moyce


def _fluid_in_cells(simulation: tp.Simulation, index: int) -> tuple[Array, Array]:
    """Volume of a fluid in each cell (M,) [m^2], and the height (M,) of the cell's middle [m]."""
    mesh = simulation.mesh
    fraction = simulation.state.material.fraction
    return fraction[:, index] * mesh.measure, mesh.position[mesh.cells].mean(axis=1)[:, 1]


def mean_height(simulation: tp.Simulation, index: int) -> float:
    """Mean height [m] of a fluid over the floor; particles in no cell do not count."""
    volume, height = _fluid_in_cells(simulation, index)
    return float(volume @ height / volume.sum())


@dataclass
class DropSinks(harness.Check):
    """Every fluid keeps its volume, and the first of three, a drop, ends under the second.

    Attributes:
        depth: of the second fluid at the start [m].
        start: volume of each fluid at the start [m^2].
    """

    depth: float
    start: dict[str, float] = field(init=False, default_factory=dict)

    def columns(self) -> dict[str, harness.Probe]:
        """Height of the drop's centre of mass [m]."""
        return {"centre_height": lambda simulation: mean_height(simulation, 0)}

    def begin(self, simulation: tp.Simulation, options: harness.Options) -> None:
        """Keep the volumes at the start."""
        self.start = {fluid.name: simulation.volume(fluid.name) for fluid in simulation.case.fluids}

    def figures(self, simulation: tp.Simulation) -> dict[str, float]:
        """Figures of a run at its end.

        Returns:
            Largest relative change of each fluid's volume; largest speed of the run [m/s]; height of the drop's
            centre of mass in depths; part of the drop above the depth at the start.
        """
        history = simulation.history
        volume, height = _fluid_in_cells(simulation, 0)
        return {
            **{
                f"volume_error_{name}": float(np.max([abs(row[f"volume_{name}"] / begun - 1) for row in history]))
                for name, begun in self.start.items()
            },
            "largest_speed": float(np.max([row["max_speed"] for row in history])),
            "centre": mean_height(simulation, 0) / self.depth,
            "dry": float(volume[height > self.depth].sum() / volume.sum()),
        }

    def missed(self, figures: Mapping[str, float], options: harness.Options) -> list[str]:
        """What a run misses of what is expected of it; where the drop is counts once it had time to sink."""
        limits = {name: LARGEST_DROP_VOLUME_ERROR for name in figures if name.startswith("volume_error_")}
        limits["largest_speed"] = LARGEST_SPEED
        if options.end_time >= SUNK_AFTER:
            limits |= {"centre": HIGHEST_CENTRE, "dry": LARGEST_DRY}
        return harness.above(figures, limits)

    def plot(self, simulation: tp.Simulation, figures: Mapping[str, float], options: harness.Options) -> None:
        """drop.png: height of the drop's centre over time, and the change of each fluid's volume."""
        history = simulation.history
        figure = new_figure(11.0, 4.6, dpi=130)
        height, volume = figure.subplots(1, 2)
        time = np.array([row["time"] for row in history])
        height.plot(time, [row["centre_height"] for row in history], color=COLOURS[0], label="centre of the glycerin")
        height.axhline(self.depth, color="black", linewidth=1.0, linestyle=":", label="water's depth at the start")
        height.set_ylabel("height [m]", fontsize=12)
        height.set_ylim(bottom=0.0)
        for number, (name, begun) in enumerate(self.start.items()):
            change = np.abs(np.array([row[f"volume_{name}"] for row in history]) / begun - 1)
            volume.semilogy(time, np.maximum(change, 1e-17), DASHES[number], color=COLOURS[number], label=name)
        volume.set_ylabel("change of volume / volume", fontsize=12)
        for axes in (height, volume):
            axes.set_xlabel("t [s]", fontsize=12)
            axes.grid(alpha=0.3)
            axes.legend(fontsize=11, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False)
        save(figure, Path(options.out) / "drop.png")


def front(simulation: tp.Simulation) -> float:
    """Largest x of all fluids [m], single drops not counted."""
    return measures.extent(simulation.mesh, np.zeros_like(simulation.particles.fluid), 0, axis=0)


class OilStaysOnTop(harness.Check):
    """Volumes, energy, the order of the layers, and the front of a collapsing column of water and oil."""

    def columns(self) -> dict[str, harness.Probe]:
        """The front, and the mean heights of both fluids."""
        return {
            "front": front,
            "water_height": lambda simulation: mean_height(simulation, 0),
            "oil_height": lambda simulation: mean_height(simulation, 1),
        }

    def figures(self, simulation: tp.Simulation) -> dict[str, float]:
        """See `figures_of`."""
        return self.figures_of(simulation.history)

    def figures_of(self, history: Sequence[Mapping[str, float]]) -> dict[str, float]:
        """Figures of a run.

        Args:
            history: the simulation's history, one row per step.

        Returns:
            Largest relative change of each fluid's volume since the first step; the largest gain of energy since then,
            relative to the start's potential energy; the smallest height of the oil's middle over the water's before
            the impact [m]; and the front's RMS and shift against Martin & Moyce, if the run is long enough.
        """
        energy = np.array([row["kinetic_energy"] + row["potential_energy"] for row in history])
        figures = {}
        for name in ("water", "oil"):
            volume = np.array([row[f"volume_{name}"] for row in history])
            figures[f"volume_error_{name}"] = float(np.abs(volume / volume[0] - 1).max())
        figures["energy_gain"] = float((energy / energy[0]).max() - 1)
        figures["oil_over_water"] = float(
            np.min([row["oil_height"] - row["water_height"] for row in history if row["time"] <= BEFORE_IMPACT])
        )
        against = front_figures(history)
        return figures | {name: against[name] for name in ("front_rms", "front_shift") if name in against}

    def missed(self, figures: Mapping[str, float], options: harness.Options) -> list[str]:
        """What a run misses of what is expected of it."""
        limits = {
            "volume_error_water": LARGEST_OIL_VOLUME_ERROR,
            "volume_error_oil": LARGEST_OIL_VOLUME_ERROR,
            "energy_gain": LARGEST_GAIN,
            "front_rms": LARGEST_RMS,
        }
        missed = harness.above(figures, limits)
        if not figures["oil_over_water"] > 0:
            missed.append(f"oil_over_water is {figures['oil_over_water']:.4f} m: the oil has sunk")
        return missed

    def plot(self, simulation: tp.Simulation, figures: Mapping[str, float], options: harness.Options) -> None:
        """heights.png: the mean heights of both fluids over time."""
        time, water, oil = (
            np.array([row[name] for row in simulation.history]) for name in ("time", "water_height", "oil_height")
        )
        lines = {"water": (time, water), "oil": (time, oil)}
        plot_lines(Path(options.out) / "heights.png", lines, "t [s]", "mean height over the floor [m]")


class Collapse(harness.Check):
    """A column of water in 3-D keeps its volume, gains no energy, and its front is slower than 2 sqrt(g h).

    Args:
        case: whose last fill is the column, at the left wall, with gravity along the last axis.
    """

    def __init__(self, case: tp.Case) -> None:
        (self._left, *_, low), (right, *_, high) = case.tank.regions[-1].given["box"]
        self._width, height = right - self._left, high - low
        self._length, self._spacing = float(case.tank.size[0]), case.particles.spacing
        gravity, fluid = float(np.linalg.norm(case.gravity)), case.tank.regions[-1].fluid
        self._fastest = 2.0 * (gravity * height) ** 0.5
        self._volume = float(np.prod(np.subtract(*reversed(case.tank.regions[-1].given["box"]))))
        level = height * self._width / self._length
        self._energy = fluid.density * gravity * self._volume * (height - level) / 2  # that it can give [J]

    def columns(self) -> dict[str, harness.Probe]:
        """Largest x of the water's cells [m]."""
        return {"front": lambda run: float(run.mesh.position[run.mesh.used, 0].max())}

    def figures(self, simulation: tp.Simulation) -> dict[str, float]:
        """Figures of a run at its end.

        Returns:
            Largest relative change of the volume; largest gain of energy, relative to what the column can give; how far
            the front was ahead of its greatest speed [spacings]; when it was within two spacings of the far wall [s],
            NaN if never.
        """
        history = simulation.history
        volume, time, front = (np.array([row[name] for row in history]) for name in ("volume_water", "time", "front"))
        energy = np.array([row["kinetic_energy"] + row["potential_energy"] for row in history])
        there = time[front > self._length - 2 * self._spacing]
        return {
            "volume_error": float(np.abs(volume / volume[0] - 1).max()),
            "gain": float((energy - energy[0]).max()) / self._energy,
            "front_ahead": float((front - self._width - self._fastest * time).max()) / self._spacing,
            "reached": float(there[0]) if len(there) else float("nan"),
        }

    def missed(self, figures: Mapping[str, float], options: harness.Options) -> list[str]:
        """See `Check.missed`; the far wall counts in runs that are long enough."""
        found = harness.above(figures, LARGEST_COLLAPSE)
        latest = REACHED_AFTER * (self._length - self._width) / self._fastest
        if options.end_time >= latest and not figures["reached"] <= latest:
            found.append(f"the front was at the far wall at {figures['reached']:.3g} s, not by {latest:.3g} s")
        return found
