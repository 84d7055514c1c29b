"""Values at points and along lines, interpolated in the cells of the mesh."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np
from annotated_types import Ge, Le, MinLen

from tipfem.case.case import Case
from tipfem.mesh.measures import locate
from tipfem.probes.probe import Frame, Place, Probe, floats, in_laboratory, pressure_in, require_inside
from tipfem.typing import Array

if TYPE_CHECKING:
    from tipfem.step.stepper import Stepper  # which starts Taichi

QUANTITIES = {"pressure": "Pa", "velocity_x": "m/s", "velocity_y": "m/s", "velocity_z": "m/s", "density": "kg/m3"}

MOST_POINTS = 100_000  # of a line: each is a column of its table


@dataclass(frozen=True, kw_only=True)
class PointProbe(Probe, kind="point"):
    """Values at a point, interpolated in the cell that contains it; NaN where there is no fluid.

    Attributes:
        at: (d,) place [m].
        quantities: of pressure [Pa], velocity_x, velocity_y, velocity_z [m/s] and density [kg/m^3].
        frame: "laboratory": the place stands still; "tank": it moves with the tank.

    Raises:
        ValueError: see `Probe`; an unknown quantity or frame; the place is outside of the tank at the start.
    """

    at: Place
    quantities: Annotated[Sequence[str], MinLen(1)] = ("pressure",)
    frame: Frame = "laboratory"

    def columns(self, case: Case) -> list[tuple[str, str]]:
        """Names and units of the values; raises ValueError if the probe does not fit the case."""
        _require_quantities(self, case, self.quantities)
        require_inside(self, case, "at", self._point(case, "at", self.at))
        return [(name, QUANTITIES[name]) for name in self.quantities]

    def sample(self, simulation: Stepper) -> list[float]:
        """The values at the present time; NaN where there is no fluid."""
        place = in_laboratory(simulation, np.array([self.at], dtype=float), self.frame)
        return [float(value) for value in values_at(simulation, place, self.quantities)[0]]


@dataclass(frozen=True, kw_only=True)
class LineProbe(Probe, kind="line"):
    """Values at evenly spaced points of a line; see `PointProbe`.

    Attributes:
        start, end: (d,) ends of the line [m].
        count: number of points, both ends included.
        quantities: of pressure [Pa], velocity_x, velocity_y, velocity_z [m/s] and density [kg/m^3].
        frame: "laboratory": the line stands still; "tank": it moves with the tank.

    Raises:
        ValueError: see `PointProbe`; fewer than two points.
    """

    start: Place
    end: Place
    count: Annotated[int, Ge(2), Le(MOST_POINTS)]
    quantities: Annotated[Sequence[str], MinLen(1)] = ("pressure",)
    frame: Frame = "laboratory"

    def places(self) -> Array:
        """(count, d) the points [m], in the frame of the probe."""
        return np.linspace(floats(self.start), floats(self.end), self.count)

    def columns(self, case: Case) -> list[tuple[str, str]]:
        """Names and units of the values; raises ValueError if the probe does not fit the case."""
        _require_quantities(self, case, self.quantities)
        for what in ("start", "end"):
            require_inside(self, case, what, self._point(case, what, getattr(self, what)))
        return [(f"{name}_{k}", QUANTITIES[name]) for k in range(self.count) for name in self.quantities]

    def sample(self, simulation: Stepper) -> list[float]:
        """The values at the present time, point by point."""
        places = in_laboratory(simulation, self.places(), self.frame)
        return [float(value) for value in values_at(simulation, places, self.quantities).ravel()]


def values_at(simulation: Stepper, places: Array, quantities: Sequence[str]) -> Array:
    """Values (K, Q) of ``quantities`` at ``places`` (K, d) [m], those of the fluid there; NaN outside of all fluids."""
    case, particles, mesh = simulation.case, simulation.particles, simulation.mesh
    cell, weights = locate(mesh, places)
    found = cell >= 0
    result = np.full((len(places), len(quantities)), np.nan)
    corners = mesh.cells[cell[found]]
    density = np.array([fluid.density for fluid in case.fluids])
    velocity = particles.velocity[corners]
    for part in simulation.state.own_inertia:  # where the fluid of a cell has velocities of its own
        number = np.full(len(mesh.cells), -1)
        number[part.cell] = np.arange(len(part.cell))
        own = number[cell[found]]
        velocity[own >= 0] += part.at_corners(particles.velocity)[own[own >= 0]]
    for k, name in enumerate(quantities):
        if name == "density" and mesh.fluid is not None:
            result[found, k] = density[mesh.fluid[cell[found]]]
            continue
        if name == "density":
            values = density[particles.fluid][corners]
        elif name == "pressure":
            values = pressure_in(
                simulation.state, simulation.mesh, corners, np.broadcast_to(cell[found][:, None], corners.shape)
            )
        else:
            values = velocity[:, :, "xyz".index(name[-1])]
        result[found, k] = (values * weights[found]).sum(axis=1)
    return result


def _require_quantities(probe: Probe, case: Case, quantities: Sequence[str]) -> None:
    known = [name for name in QUANTITIES if name != "velocity_z" or case.particles.dimension == 3]
    unknown = [name for name in quantities if name not in known] if not isinstance(quantities, str) else [quantities]
    if unknown or not quantities:
        raise probe.invalid("quantities", f"is {quantities!r}; it must be a list of some of {known}")
