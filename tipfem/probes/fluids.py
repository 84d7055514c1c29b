"""Heights, fronts, volumes and energies of fluids."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt, Le, Len

from tipfem.case.case import Case
from tipfem.case.declaration import Unit
from tipfem.mesh import measures
from tipfem.mesh.mesh import Mesh
from tipfem.probes.probe import Frame, Probe, contents, pose_of, require_plane
from tipfem.results.history_columns import per_depth

if TYPE_CHECKING:
    from tipfem.step.stepper import Stepper  # which starts Taichi


@dataclass(frozen=True, kw_only=True)
class WaveGauge(Probe, kind="wave gauge"):
    """Height of a fluid's highest point on a vertical line, and the length of the line in the fluid.

    Attributes:
        x: place of the line [m].
        y: the second coordinate of its place in 3-D, where it is along the axis of gravity and x and y are the other
            two coordinates in their order [m]; None in 2-D.
        fluid: name of the fluid.
        width: of a strip around the line over which the depth is the mean [m]; at a wall, of the part that is in the
            tank. 0 for the line alone, as always in 3-D. At a wall it tells the level beside it from what climbs it.
        frame: "laboratory": the line stands still and is vertical; "tank": it moves and turns with the tank, and
            heights are along it, from where y = 0 was in the tank at t = 0. A gauge on a wall of a tank that moves
            needs this.

    Raises:
        ValueError: see `Probe`; no such fluid; an unknown frame; the line does not cross the tank at the start.
    """

    x: Annotated[float, Unit("m")]
    fluid: str
    width: Annotated[float, Ge(0), Unit("m")] = 0.0
    frame: Frame = "laboratory"
    y: Annotated[float | None, Unit("m")] = None

    def columns(self, case: Case) -> list[tuple[str, str]]:
        """Names and units of the values; raises ValueError if the probe does not fit the case."""
        self._fluid(case, self.fluid)
        if case.particles.dimension == 3:
            self._check_in_space(case)
            return [("height", "m"), ("depth", "m")]
        if self.y is not None:
            raise self.invalid("y", f"is {self.y!r} m; it is for 3-D, leave it out")
        if self.width > 0 and (case.period or case.period.axial):
            where = "between periodic sides" if case.period else "in an axisymmetric flow"
            raise self.invalid("width", f"is {self.width!r} m; {where} it must be 0")
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
        if self.y is not None:
            return list(measures.spans(mesh, index, np.array([x, self.y]), _vertical(simulation.case)))
        if self.frame == "tank":
            # A gauge on a wall stays within all particles of the wall in spite of round-off.
            left, right = float(mesh.position[:, 0].min()), float(mesh.position[:, 0].max())
            slack = 1e-9 * (right - left)
            x = min(max(x, left + slack), right - slack) if left - slack <= x <= right + slack else x
        try:
            if self.width > 0:
                left, right = measures.ends(mesh)
                left, right = max(left, x - 0.5 * self.width), min(right, x + 0.5 * self.width)
                depth = _area_within(simulation, mesh, index, (left, -math.inf), (right, math.inf)) / (right - left)
            else:
                depth = measures.depth(mesh, simulation.particles.fluid, index, x)
            return [measures.surface_height(mesh, simulation.particles.fluid, index, x), depth]
        except ValueError:
            return [math.nan, math.nan]

    def _check_in_space(self, case: Case) -> None:
        if case.interface != "sharp":
            raise self.invalid("", f": in 3-D it needs interface = 'sharp', and that is {case.interface!r}")
        if self.width != 0:
            raise self.invalid("width", f"is {self.width!r} m; in 3-D it must be 0")
        if self.y is None:
            raise self.invalid("y", "is None; in 3-D the line needs a second coordinate")
        lower, upper = (np.delete(end(case.particles.position, axis=0), _vertical(case)) for end in (np.min, np.max))
        for k, (name, value) in enumerate((("x", self.x), ("y", self.y))):
            if not lower[k] <= value <= upper[k]:
                raise self.invalid(name, f"is {value!r} m; it must lie between {lower[k]:g} and {upper[k]:g} m")


def _vertical(case: Case) -> int:
    """The axis of gravity, the last one without."""
    return int(np.argmax(np.abs(case.gravity))) if np.any(case.gravity) else case.particles.dimension - 1


@dataclass(frozen=True, kw_only=True)
class FrontProbe(Probe, kind="front"):
    """The largest coordinate that a fluid reaches along an axis, or the least [m].

    Attributes:
        fluid: name of the fluid.
        axis: 0 for x, 1 for y, 2 for z.
        end: "upper" for the largest coordinate, "lower" for the least: of water that runs to the left.

    Raises:
        ValueError: see `Probe`; no such fluid or axis.
    """

    fluid: str
    axis: Annotated[int, Ge(0), Le(2)] = 0
    end: Literal["upper", "lower"] = "upper"

    def columns(self, case: Case) -> list[tuple[str, str]]:
        """Names and units of the values; raises ValueError if the probe does not fit the case."""
        self._fluid(case, self.fluid)
        if self.axis not in range(case.particles.dimension):
            raise self.invalid("axis", f"is {self.axis!r}; it must lie between 0 and {case.particles.dimension - 1}")
        return [("front", "m")]

    def sample(self, simulation: Stepper) -> list[float]:
        """The front at the present time; NaN without any of the fluid."""
        index = simulation.case.fluid_index(self.fluid)
        mesh = simulation.mesh
        if self.end == "lower":
            mirrored = replace(mesh, position=-mesh.position)
            return [-measures.extent(mirrored, simulation.particles.fluid, index, self.axis)]
        return [measures.extent(mesh, simulation.particles.fluid, index, self.axis)]


@dataclass(frozen=True, kw_only=True)
class VolumeProbe(Probe, kind="volume"):
    """Volume of a fluid [m^2 in 2-D, m^3 in 3-D], in the whole tank or in a box.

    Attributes:
        fluid: name of the fluid.
        box: lower left and upper right corner [m] of a box that stands still; None for the whole tank, spray included.

    Raises:
        ValueError: see `Probe`; no such fluid; the corners are not those of a box, or the case is periodic, or 3-D
            without a sharp interface.
    """

    fluid: str
    box: Annotated[Sequence[Sequence[float]], Len(2, 2), Unit("m")] | None = None

    def columns(self, case: Case) -> list[tuple[str, str]]:
        """Names and units of the values; raises ValueError if the probe does not fit the case."""
        self._fluid(case, self.fluid)
        if self.box is not None:
            if case.particles.dimension == 3 and case.interface != "sharp":
                raise self.invalid("box", f": in 3-D it needs interface = 'sharp', and that is {case.interface!r}")
            lower, upper = (self._point(case, "box", corner) for corner in self.box)
            if not (lower < upper).all():
                text = f"is {self.box!r} m; its first corner must be to the lower left of its second"
                raise self.invalid("box", text)
            if case.period:
                raise self.invalid("box", ": a volume in a box is not measured between periodic sides")
        return [("volume", f"m{contents(case)}")]

    def sample(self, simulation: Stepper) -> list[float]:
        """The volume at the present time."""
        if self.box is None:
            return [simulation.volume(self.fluid)]
        index, mesh = simulation.case.fluid_index(self.fluid), simulation.mesh
        if mesh.dimension == 3:
            corners = mesh.position[mesh.cells[np.asarray(mesh.fluid) == index]]
            return [measures.volume_within(corners, *np.asarray(self.box, dtype=float))]
        return [_area_within(simulation, mesh, index, *self.box)]


@dataclass(frozen=True, kw_only=True)
class WaveProbe(Probe, kind="wave"):
    """Amplitude of one wave of a fluid's surface along x; 2-D.

    Between walls a distance L apart the surface is a sum of a_n cos(n pi (x - x_0) / L), n = 1, 2, ...; along a
    periodic axis of the length L of a_n cos(2 n pi x / L) + b_n sin(2 n pi x / L). With the depth d of the fluid over
    x, a_n = (2 / L) int d cos(...) dx, which is an integral over the area of the fluid. The walls are those at the
    start; in a tank that moves, x is along it.

    Attributes:
        fluid: name of the fluid; the upper one of two has the amplitudes of its own depth, with the other sign.
        number: n, half waves between walls, whole waves along a periodic axis.

    Raises:
        ValueError: see `Probe`; no such fluid; the case is 3-D.
    """

    fluid: str
    number: Annotated[int, Gt(0)] = 1

    def columns(self, case: Case) -> list[tuple[str, str]]:
        """Names and units of the values; raises ValueError if the probe does not fit the case."""
        self._fluid(case, self.fluid)
        require_plane(self, case)
        return [("cosine", "m"), ("sine", "m")] if case.period else [("amplitude", "m")]

    def sample(self, simulation: Stepper) -> list[float]:
        """The amplitudes at the present time."""
        case, mesh = simulation.case, simulation.mesh
        start = case.particles.position[:, 0]
        left, length = (0.0, float(case.period.width[0])) if case.period else (float(start.min()), float(np.ptp(start)))
        x = pose_of(case, simulation.time).origin(mesh.position)[:, 0]
        corners = x[mesh.cells] - left
        if case.period:
            corners = corners[:, :1] + mesh.period.shortest(corners - corners[:, :1], 0)
        area = mesh.measure * simulation.state.material.fraction[:, case.fluid_index(self.fluid)]
        waves = (2 if case.period else 1) * self.number
        found = measures.wave_integrals(corners, area, waves * math.pi / length)
        return [2 / length * value for value in (found if case.period else found[:1])]


def _area_within(simulation: Stepper, mesh: Mesh, index: int, lower: Sequence[float], upper: Sequence[float]) -> float:
    """Area of a fluid in a box [m^2]; of cells with several fluids, the part that each has of the cell."""
    low, high = np.asarray(lower, dtype=float), np.asarray(upper, dtype=float)
    fraction = simulation.state.material.fraction[:, index]
    corners = mesh.position[mesh.cells]
    least, most = corners.min(axis=1), corners.max(axis=1)
    apart = np.any((least > high) | (most < low), axis=1)
    inside = np.all((least >= low) & (most <= high), axis=1)
    cut = np.flatnonzero(~apart & ~inside & (fraction > 0))
    whole = float(mesh.measure[inside] @ fraction[inside])
    part = measures.area_within(corners[cut], low, high, axial=mesh.period.axial)
    return whole + float(part @ fraction[cut])


@dataclass(frozen=True, kw_only=True)
class EnergyProbe(Probe, kind="energy"):
    """Kinetic and potential energy of all fluids [J, per metre of depth in 2-D]."""

    def columns(self, case: Case) -> list[tuple[str, str]]:
        """Names and units of the values."""
        unit = per_depth("J", contents(case))
        return [("kinetic_energy", unit), ("potential_energy", unit)]

    def sample(self, simulation: Stepper) -> list[float]:
        """The energies at the present time."""
        energy = simulation.energy()
        return [energy.kinetic, energy.potential]
