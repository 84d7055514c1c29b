"""Physics: what a case has beside the bulk flow, in its steps and between them.

A physics is a file or a folder here, and a line in `tipfem.physics.registry`. The step, the remeshers, the budget and
the checkpoints call the methods below for all of them in turn, and name none. Objects have what the case says and
nothing that a step changes: that is the physics' part of the state, see `tipfem.physics.carried`. A physics has the
methods that it needs; docs/develop/adding-a-term.md walks through one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Generic, TypeVar, cast

import numpy as np

from tipfem.backend.arrays import taken
from tipfem.case.boundary.boundary import Boundary
from tipfem.case.case import Case
from tipfem.case.fluid import Fluid
from tipfem.case.openings import LIQUID
from tipfem.case.particles import Particles
from tipfem.fem.time_integration import TimeScheme
from tipfem.mesh.components import ON_INTERFACE
from tipfem.mesh.cut import CutMesh, cut_along_interfaces
from tipfem.mesh.mesh import Mesh
from tipfem.mesh.relabelled import SideEnergies
from tipfem.physics.carried import Carried, Remap, held_by_gaps
from tipfem.physics.term import Term
from tipfem.physics.walls.step import WallsInStep, WallStep
from tipfem.typing import Array


@dataclass(frozen=True)
class StepStart:
    """State at the start of a step; N particles, M cells."""

    particles: Particles  # at the step's start
    mesh: Mesh  # of them
    boundary: Boundary  # which of them lie on which walls
    density: Array  # (M,) of the cells [kg/m^3]
    rank: Array  # (F,) of the fluids, see `tipfem.case.fluid.ranks`
    viscosity: Array  # (M,) of the cells [Pa s]
    scheme: TimeScheme  # time integration, with the step's length
    time: float  # [s]
    parts: Mapping[str, Carried]  # of the state
    fluids: Sequence[Fluid]  # of the case

    @cached_property
    def walls(self) -> WallsInStep:
        """Walls of the step; see `tipfem.physics.walls.step.WallStep` for errors."""
        start = self.boundary, self.mesh, self.particles
        if not self.boundary.active:
            return WallsInStep(*start, self.scheme)
        of_walls, closed = cast(Any, self.parts.get("walls")), held_by_gaps(self.parts)
        return WallStep(*start, self.viscosity, self.scheme, self.time, self.density, of_walls, closed)

    @property
    def leaving(self) -> Array | None:
        """(N,) mask of the particles of the hull that move freely, where fluids enter and leave; None for none."""
        return None if self.boundary.passages is None else self.boundary.passages.free

    @cached_property
    def cut(self) -> CutMesh:
        """The mesh, cut along the interfaces between fluids."""
        rank = taken((self.rank,), np.asarray(self.mesh.fluid), "cut.rank")[0]
        return cut_along_interfaces(self.mesh, rank, self._one_pressure())

    def _one_pressure(self) -> Array | None:
        """(N,) mask of the contacts at which liquids have one pressure; None for none.

        A contact that slides has one component of velocity, too few for two equations of continuity: with two pressures
        the tips of fluids that flow along walls lag behind by a part of a spacing. Where there is tension the pressure
        jumps, and that of a gas has no part in a liquid's.
        """
        density = np.array([fluid.density for fluid in self.fluids])
        ratio = np.sort(density)
        if not (ratio[1:] < LIQUID * ratio[:-1]).any():
            return None
        components, slides = cast(Any, self.mesh.components), np.zeros(len(self.particles), dtype=bool)
        slides[self.walls.sliding] = True
        if self.boundary.passages is not None:
            slides[self.boundary.passages.crossing] = False
        for part in self.parts.values():
            if part.along is not None:
                slides |= part.along.any(axis=1)
        for part in self.parts.values():
            slides[part.tense] = False
        at = np.flatnonzero(slides & (components.mark & ON_INTERFACE > 0))
        there = np.where(components.at_particle[:, at] >= 0, density[:, None], np.nan)
        slides[:] = False
        slides[at] = np.nanmax(there, axis=0, initial=0) < LIQUID * np.nanmin(there, axis=0, initial=np.inf)
        return slides


@dataclass(frozen=True)
class Entered:
    """Fluids that have entered from outside in a step; less than 0 for what has left."""

    volume: Array  # (F,) of each fluid [m^2]
    energy: float  # kinetic and potential, or that of the physics' part [J, per metre of depth]
    momentum: Array  # (d,) [N s]


@dataclass(frozen=True)
class Moved:
    """The end of a step, before its mesh is repaired."""

    start: Particles  # the N particles at the step's start
    boundary: Boundary  # which of them lie on which walls
    particles: Particles  # at the end
    # the step's mesh, of the start. Where volume enters, the areas of its cells are their own and that, so that what
    # the solve has changed of them is still the difference to those at the end.
    mesh: Mesh
    time: float  # at the end [s]
    dt: float  # length of the step [s]
    # positions (N, d) before and after those where fluids enter and leave are put back; else None [m]
    through: tuple[Array, Array] | None = None
    left: Array | None = None  # mask of the cells at the start that the mesh has no more; None where it has all
    curved: Array | None = None  # (N,) mask of the particles on curves of what is in a closed tank; None without any
    # volume that the cells have gained where a fluid ran over brinks, as particles were set back there [m^2]: the
    # repair takes it from the fluid again, so it has not come in by openings
    kept: float = 0.0


def no_particles() -> Array:
    """Numbers of no particles."""
    return np.zeros(0, dtype=np.int64)


@dataclass(frozen=True)
class Balance:
    """Energies of what has unknowns of its own in a step, for the budget [J, per metre of depth in 2-D]."""

    change: float = 0.0  # of its energy
    dissipated: float = 0.0  # what it takes of energy, by dampers for instance
    numerical: float = 0.0  # what the time integration takes
    # work of forces from outside, and of the fluids, for which it is one: positive when energy is gained
    external: float = 0.0
    columns: Mapping[str, float] = field(default_factory=dict)  # of the history, named by `Physics.balance_columns`


Part = TypeVar("Part", bound=Carried | None)


class Physics(Generic[Part]):
    """A physics of a case; see the module. ``part`` is what it carries, None for one that may carry nothing."""

    name: str  # of its part of the state
    # Longest time step that resolves it [s], see `tipfem.physics.registry.step_frequency`. What a case knows without it
    # is in `Case.natural_frequency`, from which runs are estimated before they start.
    longest_step: float = math.inf
    columns: tuple[str, ...] = ()  # names of its columns in the history, see `row`
    balance_columns: tuple[str, ...] = ()  # names of its columns in the budget, see `balance`
    # Where its part has an energy, names of the columns of that, of what remeshing adds to it, of what its forces
    # dissipate, and of what is lost for good, see `tipfem.physics.carried.Carried`; or the first of these.
    stored_columns: tuple[str, ...] = ()
    open = False  # whether fluids enter or leave by it: remeshing makes and removes particles; see `before_repair`
    curved = False  # whether what it carries has curves, on which new particles are put; see `put_on_curves`

    @classmethod
    def of(cls, case: Case) -> Physics[Part] | None:
        """Physics of a case; None for a case without it."""
        raise NotImplementedError

    def start(self, particles: Particles, step: float) -> Any:
        """Carried state at t = 0, of particles not meshed yet; ``step`` [s] is of finite differences."""
        return None

    def terms(self, part: Part, step: StepStart) -> Iterable[Term]:
        """The terms of a step; `ValueError` if a function of time returns an invalid value."""
        return ()

    def remeshed(self, part: Part, particles: Particles, remap: Remap) -> tuple[Part, Particles]:
        """Carried state on the new mesh, and the particles with the fields that it changed.

        Also at the start, when the first mesh has been made. Particles come before walls and parts impose their
        velocities.
        """
        return part, particles

    def flooded(self, part: Part, mesh: Mesh, boundary: Boundary, position: Array, until: float) -> Mesh:
        """A mesh with cells of other fluids: the first one, and each one that has cells of empty space.

        Their number is that after the last fluid. Positions (N, 2) are before the repair, and the next step ends at the
        time ``until``, or later [s].
        """
        return mesh

    def taken_up(self, part: Part, mesh: Mesh, position: Array) -> Array | None:
        """Volume (F,) of fluids that flowed out of cells in a step from a mesh to positions (N, 2); None for none."""
        return None

    def closed(self, part: Part, particles: Particles) -> Callable[[Array, Array, Array], Array] | None:
        """Closed gaps between solids, which no repair of films fills, told from other empty cells; None for none.

        A function of positions (N', 2), of the N particles first, cells (M, 3), and the mask (M,) of the empty ones to
        that of those that no repair of films changes.
        """
        return None

    def put_on_curves(self, part: Part, position: Array, new: Array, ends: Array) -> Array:
        """Positions (N, 2) with those of new particles (K,), on chords, put on curves of what it carries.

        ``ends`` (K, 2) are the particles before and after each of them along the boundary that are not new.
        """
        return position

    def sides(self, part: Part, count: int, boundary: Boundary) -> SideEnergies | None:
        """Energies of the sides of cells, by which films of ``count`` particles may break; None for thickness alone."""
        return None

    def set_back(self, part: Part, particles: Particles) -> tuple[Part, Particles, Array]:
        """Carried state, and the particles, those that slid out of corners there again, before walls set back theirs.

        And the numbers of those over brinks, and before them, see `Moved.kept`.
        """
        return part, particles, no_particles()

    def before_repair(self, part: Part, moved: Moved) -> tuple[Part, Moved]:
        """Carried state, and the end of a step, before the mesh is repaired."""
        return part, moved

    def imposed(self, part: Part, particles: Particles, boundary: Boundary, time: float, step: float) -> Particles:
        """Remeshed particles with the velocities and accelerations that the physics prescribes on the boundary.

        Walls have prescribed theirs; ``step`` is of finite differences [s].
        """
        return particles

    def handed_over(
        self, before: Part, part: Part, particles: Particles, remap: Remap, boundary: Boundary
    ) -> Array | None:
        """Velocities (N', 2) of the next particles with those of fluid that was not meshed before; None for no change.

        It carried the part ``before`` at the start of the step.
        """
        return None

    def booked(self, part: Part, energy: float, momentum: Array) -> Part:
        """Carried state that has the kinetic energy and the momentum (d,) of what it handed over, see `entered`."""
        return part

    def entered(self, part: Part) -> Entered | None:
        """Fluids that entered in the last step; None for nothing."""
        return None

    def stopped(self, part: Part, particles: Particles, loose: Array) -> Particles:
        """The particles at the end of a step, with those of a mask (N,), which fly freely, not where they cannot be."""
        return particles

    def consistent(self, part: Part, whole: Part, half: Part) -> Part:
        """Carried state at t = 0, from that at the start, with the rates that follow from the equations.

        ``whole`` is at the end of a step that is not taken, ``half`` at that of one of half its length; what is in
        proportion to 1 / dt is not in 2 whole - half.
        """
        return part

    def again(self, part: Part, found: Part) -> tuple[Part, bool]:
        """Whether a step has been solved, with forces that its own end asks for.

        What it carries at the end, ``found``, and true; or that at the start to solve the step again with, and false.
        `StepRefused` if there are none for a step of this length.
        """
        return found, True

    def jumps(self, part: Part) -> bool:
        """Whether velocities of what it carries jumped in a step, by the part at its start or its end: an impact."""
        return False

    def settled(self, part: Part, particles: Particles, mesh: Mesh, boundary: Boundary, time: float) -> Part:
        """State that the next step starts from, from the last one's end; `SimulationError` if the run cannot go on."""
        return part

    # Accounts.

    def row(self, part: Part, particles: Particles) -> dict[str, float]:
        """Columns of the history after a step, named by ``columns``."""
        return {}

    def balance(self, before: Part, after: Part, scheme: TimeScheme, force: Array) -> Balance | None:
        """Balance of energy of what has unknowns of its own in a step, to its end, not remeshed; None without any.

        ``force`` (N, d) is the acceleration by gravity and body force [m/s^2].
        """
        return None
