"""Fluids whose viscosity follows a law, against closed forms and experiments.

plates   a force drives a fluid between two plates: the velocity over the width, with the plug of a yield stress
slump    a column of mud that slumps along a dry floor, and stops: its length and shape against those at which the
         weight and the yield stress are in balance, h^2 = 2 tau_y / (rho g) (x_f - x)
stop     the same with a regularisation of 1000 s: how slowly it creeps when it has stopped
column   columns of dry grains that fall down, 0.5, 1.42 and 6.26 times as high as they are long: how far they run,
         against simulations of single grains in two dimensions (Staron & Hinch, 2005)
beads    a column of glass beads: how far it runs, against experiments in channels, 1.2 of its height (Lube et al.,
         2005) to 1.8 (Lajeunesse et al., 2005)

summary.json    figures of all runs
table.md        the same as a table
rheology.png    velocities between the plates, and shapes of the mud

python -m tipfem demo validation/rheology --flow plates slump
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from tipfem.demos import harness
from tipfem.demos.support.figures import COLOURS, new_figure, save, table, with_legend
from tipfem.demos.support.options import Arch, Count, Several

import tipfem as tp

Array = NDArray[np.float64]
Flow = Literal["plates", "slump", "stop", "column", "beads"]

GRAVITY = 9.81  # [m/s^2]
HALF, FORCE = 0.5, 1.0  # of the channel: half its width [m], the force that drives the fluid [m/s^2]
DENSITY, STIFF = 1.0, 1000.0  # of the fluids there [kg/m^3], and their regularisation [s]
# Laws, and the yield stress, consistency and index of the exact profile.
PLATES: dict[str, tuple[tp.Bingham | tp.HerschelBulkley | tp.PowerLaw, tuple[float, float, float]]] = {
    "bingham": (tp.Bingham(0.2, 1.0, regularisation=STIFF), (0.2, 1.0, 1.0)),
    "herschel-bulkley": (tp.HerschelBulkley(0.2, 0.7, 0.6, regularisation=STIFF), (0.2, 0.7, 0.6)),
    "thinning power law": (tp.PowerLaw(0.5, 0.5), (0.0, 0.5, 0.5)),
    "thickening power law": (tp.PowerLaw(1.0, 1.5), (0.0, 1.0, 1.5)),
}
LENGTH, HEIGHT = 0.2, 0.1  # of the column of mud [m]
MUD = tp.Fluid("mud", 1000.0, tp.Bingham(60.0, 1.0, regularisation=20.0))
STIFF_MUD = tp.Fluid("mud", 1000.0, tp.Bingham(60.0, 1.0, regularisation=STIFF))
BEADS = tp.Fluid("grains", 1500.0, tp.Granular(0.48, 0.73, 0.7e-3, 2500.0, inertial_number=0.279))
# Columns of grains of 5 mm: height over length, height [m], and within how many heights 95 and 99 % of them end.
COLUMNS = ((0.5, 0.149, (3.084, 3.593)), (1.42, 0.324, (2.365, 2.846)), (6.26, 0.67, (1.666, 2.000)))
IN_CHANNELS = 1.2, 1.8  # run-out of columns of beads over their height
LIMITS = {"profile": 0.01, "length": 0.03, "shape": 0.035, "creep": 1e-4}
LIMITS |= {"reach_95": 0.1, "reach_99": 0.1, "in_channels": 0.0}


def profile(y: Array, numbers: tuple[float, float, float]) -> Array:
    """Velocities (K,) [m/s] at distances (K,) from the middle between the plates [m]."""
    yield_stress, consistency, index = numbers
    power, force = 1 + 1 / index, DENSITY * FORCE

    def moved(at: Any) -> Any:
        return np.maximum(force * at - yield_stress, 0.0) ** power / (power * force) / consistency ** (1 / index)

    return np.asarray(moved(HALF) - moved(y))


def plates(name: str, across: int, end: float = 2.0) -> tuple[dict[str, float], Array]:
    """A law of `PLATES` between the plates; error of the velocity, over the largest: root mean square, and largest."""
    law, numbers = PLATES[name]
    fluid = tp.Fluid("fluid", DENSITY, law)
    tank = tp.tank((max(8, across // 2) / across, 2 * HALF), 1 / across, jitter=0.1, periodic="x").fill(fluid)
    simulation = tp.Simulation(tp.Case(tank, [fluid], (FORCE, 0.0)))
    simulation.run(end, progress=False)
    y = simulation.particles.position[:, 1] - HALF
    velocity, exact = simulation.particles.velocity[:, 0], profile(abs(y), numbers)
    error = (velocity - exact) / exact.max()
    figures = {"profile": float(np.sqrt((error**2).mean())), "largest_error": float(abs(error).max())}
    return figures, np.stack([y, velocity], axis=1)


def slump(spacings: int, end: float = 1.0, mud: tp.Fluid = MUD) -> tuple[dict[str, float], Array]:
    """Mud that stops: errors of its length, and of its shape over its first height; and the shape (K, 2) [m]."""
    assert isinstance(mud.viscosity, tp.Bingham)
    tank = tp.tank((5 * LENGTH, 1.5 * HEIGHT), HEIGHT / spacings, jitter=0.1)
    tank.fill(mud, box=((0, 0), (LENGTH, HEIGHT))).wall("left", slip=True)
    simulation = tp.Simulation(tp.Case(tank, [mud], (0, -GRAVITY), free_surface=True))
    area, slope = simulation.volume("mud"), mud.viscosity.yield_stress / (mud.density * GRAVITY)
    simulation.run(end, progress=False)
    length = (9 * area**2 / (8 * slope)) ** (1 / 3)
    top = surface(simulation)
    error = top[:, 1] - np.sqrt(2 * slope * np.maximum(length - top[:, 0], 0.0))
    figures = {
        "length": float(simulation.particles.position[simulation.state.mesh.used, 0].max() / length - 1),
        "shape": float(np.sqrt((error**2).mean()) / HEIGHT),
        "speed": simulation.particles.max_speed,
    }
    if mud is STIFF_MUD:
        figures["creep"] = figures["speed"] / max(row["max_speed"] for row in simulation.history)
    return figures, top


def fallen(fluid: tp.Fluid, length: float, height: float, spacings: int, end: float) -> tp.Simulation:
    """Grains that have fallen, ``end`` times sqrt(height / gravity) after they were let go."""
    tank = tp.tank((1.5 * length + 3 * height, 1.3 * height), min(length, height) / spacings, jitter=0.1)
    tank.fill(fluid, box=((0, 0), (length, height))).wall("left", slip=True)
    simulation = tp.Simulation(tp.Case(tank, [fluid], (0, -GRAVITY), free_surface=True))
    simulation.run(end * math.sqrt(height / GRAVITY), progress=False)
    return simulation


def surface(simulation: tp.Simulation) -> Array:
    """Particles (K, 2) of the free surface, from left to right [m]."""
    x, mesh = simulation.particles.position, simulation.state.mesh
    top = x[mesh.used & mesh.surface.front]
    return np.asarray(top[np.argsort(top[:, 0])])


def column(
    spacings: int, tall: float, height: float, reach: tuple[float, float], end: float = 6.0
) -> tuple[dict[str, float], Array]:
    """Errors of how far 95 and 99 % of grains are, whose column was ``tall`` times as high as long; and the shape.

    The numbers of the law, and ``reach`` in heights, are of grains computed one by one; the density is the heap's.
    """
    fluid = tp.Fluid("grains", 1500.0, tp.Granular(0.32, 0.60, 5e-3, 1500.0, inertial_number=0.4))
    simulation = fallen(fluid, height / tall, height, spacings, end)
    mesh, figures = simulation.state.mesh, {"speed": simulation.particles.max_speed}
    x = mesh.position[mesh.cells, 0].mean(axis=1)
    order = np.argsort(x)
    part = np.cumsum(mesh.measure[order]) / mesh.measure.sum()
    for share, expected in zip((0.95, 0.99), reach, strict=True):
        found = float(np.interp(share, part, x[order])) / height
        figures |= {f"reach_{100 * share:.0f}": found / expected - 1, f"over_height_{100 * share:.0f}": found}
    return figures, surface(simulation)


def beads(spacings: int, end: float = 6.0) -> tuple[dict[str, float], Array]:
    """Run-out over the height of beads in a column as high as long, and how far it is out of `IN_CHANNELS`."""
    length = 0.1
    simulation = fallen(BEADS, length, length, spacings, end)
    x, (least, most) = simulation.particles.position[simulation.state.mesh.used, 0], IN_CHANNELS
    run_out = float(x.max()) / length - 1
    return {
        "in_channels": max(least - run_out, run_out - most, 0.0),
        "over_height": run_out,
        "speed": simulation.particles.max_speed,
    }, surface(simulation)


def check(name: str, figures: Mapping[str, float]) -> list[str]:
    """What is out of its limits."""
    return [
        f"{name}: {key} is off by {value:.3g}, more than {LIMITS[key]:g}"
        for key, value in figures.items()
        if key in LIMITS and not abs(value) <= LIMITS[key]
    ]


def plot(path: Path, drawn: Mapping[str, Array]) -> None:
    """Draw velocities between the plates, and the shapes of what slumps, beside closed forms."""
    figure = new_figure(9.0, 3.6)
    left, right = figure.subplots(1, 2)
    for number, (name, data) in enumerate(drawn.items()):
        colour = COLOURS[number % len(COLOURS)]
        if name in PLATES:
            y = np.linspace(-HALF, HALF, 200)
            left.plot(data[:, 1], data[:, 0], ".", markersize=4, color=colour, label=name)
            left.plot(profile(abs(y), PLATES[name][1]), y, color=colour, linewidth=0.8)
        else:
            right.plot(data[:, 0], data[:, 1], ".", markersize=4, color=colour, label=name)
    if "slump" in drawn:
        assert isinstance(MUD.viscosity, tp.Bingham)
        slope = MUD.viscosity.yield_stress / (MUD.density * GRAVITY)
        length = (9 * (LENGTH * HEIGHT) ** 2 / (8 * slope)) ** (1 / 3)
        x = np.linspace(0, length, 200)
        right.plot(x, np.sqrt(2 * slope * (length - x)), "k-", linewidth=0.8, label="balance of the mud")
    left.set_xlabel("velocity [m/s]; lines: exact")
    left.set_ylabel("y [m]")
    right.set_xlabel("x [m]")
    right.set_ylabel("height [m]")
    for axes in (left, right):
        with_legend(axes)
    save(figure, path)


def main(
    *,
    flow: Several[Flow] | None = None,
    spacings: Count = 12,
    arch: Arch = "cpu",
    threads: Count | None = None,
    out: Path = Path("out/validation/rheology"),
) -> int:
    """Run the flows.

    Args:
        flow: which flows; by default all.
        spacings: in the height of what slumps; between the plates there are a third more.
        arch: where the kernels run.
        threads: of the processor; by default all.
        out: folder for the results.
    """
    tp.init(arch=arch, threads=threads)
    results: dict[str, Any] = {}
    drawn: dict[str, Array] = {}
    for name in flow or ("plates", "slump", "stop", "column", "beads"):
        if name == "plates":
            for law in PLATES:
                results[law], drawn[law] = plates(law, 4 * spacings // 3)
        elif name == "stop":
            results[name], drawn[name] = slump(spacings, mud=STIFF_MUD)
        elif name == "column":
            for numbers in COLUMNS:
                at = f"column {numbers[0]:g}"
                results[at], drawn[at] = column(spacings, *numbers)
        elif name == "beads":
            results[name], drawn[name] = beads(spacings)
        else:
            results[name], drawn[name] = slump(spacings)
    out.mkdir(parents=True, exist_ok=True)
    (out / "table.md").write_text(table(results), encoding="utf-8")
    plot(out / "rheology.png", drawn)
    print(table(results))
    return harness.report(out, {"runs": results}, [text for name, one in results.items() for text in check(name, one)])


if __name__ == "__main__":
    harness.command(__name__)
