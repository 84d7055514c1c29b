"""Heights, fronts, volumes and energies of fluids."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated

from annotated_types import Ge, Le

from tipfem.case.case import Case
from tipfem.case.declaration import Unit
from tipfem.mesh import measures
from tipfem.probes.probe import Frame, Probe, per_depth, pose_of, require_plane

if TYPE_CHECKING:
    from tipfem.step.stepper import Stepper  # which starts Taichi


@dataclass(frozen=True, kw_only=True)
class WaveGauge(Probe):
    """Height of a fluid's highest point over the vertical line x = ``x``, and the length of the line in the fluid; 2-D.

    Attributes:
        x: place of the line [m].
        fluid: name of the fluid.
        frame: "laboratory": the line stands still and is vertical; "tank": it moves and turns with the tank, and
            heights are along it, from where y = 0 was in the tank at t = 0. A gauge on a wall of a tank that moves
            needs this.

    Raises:
        ValueError: see `Probe`; no such fluid; an unknown frame; the line does not cross the tank at the start.
    """

    x: Annotated[float, Unit("m")]
    fluid: str
    frame: Frame = "laboratory"

    def columns(self, case: Case) -> list[tuple[str, str]]:
        """Names and units of the values; raises ValueError if the probe does not fit the case."""
        self._fluid(case, self.fluid)
        require_plane(self, case)
        lower, upper = case.particles.position[:, 0].min(), case.particles.position[:, 0].max()
        if case.period:
            lower, upper = 0.0, case.period.width[0]
        if not lower <= self.x <= upper:
            raise self.invalid("x", f"is {self.x!r} m; it must lie between {lower:g} and {upper:g} m")
        return [("height", "m"), ("depth", "m")]

    def sample(self, simulation: Stepper) -> list[float]:
        """Height and depth at the present time; NaN where the line has left the tank or meets none of the fluid."""
        mesh, index, x = simulation.mesh, simulation.case.fluid_index(self.fluid), self.x
        if self.frame == "tank":
            mesh = replace(mesh, position=pose_of(simulation.case, simulation.time).origin(mesh.position))
            # A gauge on a wall stays within all particles of the wall in spite of round-off.
            left, right = float(mesh.position[:, 0].min()), float(mesh.position[:, 0].max())
            slack = 1e-9 * (right - left)
            x = min(max(x, left + slack), right - slack) if left - slack <= x <= right + slack else x
        try:
            depth = measures.depth(mesh, simulation.particles.fluid, index, x)
            return [measures.surface_height(mesh, simulation.particles.fluid, index, x), depth]
        except ValueError:
            return [math.nan, math.nan]


@dataclass(frozen=True, kw_only=True)
class FrontProbe(Probe):
    """The largest coordinate that a fluid reaches along an axis.

    Attributes:
        fluid: name of the fluid.
        axis: 0 for x, 1 for y, 2 for z.

    Raises:
        ValueError: see `Probe`; no such fluid or axis.
    """

    fluid: str
    axis: Annotated[int, Ge(0), Le(2)] = 0

    def columns(self, case: Case) -> list[tuple[str, str]]:
        """Names and units of the values; raises ValueError if the probe does not fit the case."""
        self._fluid(case, self.fluid)
        if self.axis not in range(case.particles.dimension):
            raise self.invalid("axis", f"is {self.axis!r}; it must lie between 0 and {case.particles.dimension - 1}")
        return [("front", "m")]

    def sample(self, simulation: Stepper) -> list[float]:
        """The front at the present time; NaN without any of the fluid."""
        index = simulation.case.fluid_index(self.fluid)
        return [measures.extent(simulation.mesh, simulation.particles.fluid, index, self.axis)]


@dataclass(frozen=True, kw_only=True)
class VolumeProbe(Probe):
    """Volume of a fluid [m^2 in 2-D, m^3 in 3-D], spray included.

    Attributes:
        fluid: name of the fluid.

    Raises:
        ValueError: see `Probe`; no such fluid.
    """

    fluid: str

    def columns(self, case: Case) -> list[tuple[str, str]]:
        """Names and units of the values; raises ValueError if the probe does not fit the case."""
        self._fluid(case, self.fluid)
        return [("volume", f"m{case.particles.dimension}")]

    def sample(self, simulation: Stepper) -> list[float]:
        """The volume at the present time."""
        return [simulation.volume(self.fluid)]


@dataclass(frozen=True, kw_only=True)
class EnergyProbe(Probe):
    """Kinetic and potential energy of all fluids [J, per metre of depth in 2-D]."""

    def columns(self, case: Case) -> list[tuple[str, str]]:
        """Names and units of the values."""
        return [("kinetic_energy", per_depth("J", case)), ("potential_energy", per_depth("J", case))]

    def sample(self, simulation: Stepper) -> list[float]:
        """The energies at the present time."""
        energy = simulation.energy()
        return [energy.kinetic, energy.potential]
