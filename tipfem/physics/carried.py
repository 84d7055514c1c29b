"""Carried: what a physics carries from one step to the next, beside the particles.

A state has such parts by the names of their physics (`tipfem.physics.state.State.parts`). Each is a frozen dataclass,
so that checkpoints hold it as it is. `tipfem.physics.physics.Physics` moves it through a remeshing.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from tipfem.case.case import Case
from tipfem.case.particles import Particles
from tipfem.geometry.plane.vectors import nonzero
from tipfem.mesh.mesh import Mesh
from tipfem.mesh.relabelled import Relabelled
from tipfem.scratch import filled
from tipfem.typing import Array


class Carried:
    """A part of the state that belongs to a physics."""

    moves = False  # whether it has velocities of its own, which those of particles follow
    along: Array | None = None  # (N, 2) unit vectors along which wall particles slide on it, 0 for others
    stuck: Array | None = None  # (N,) mask of those that slide next to nothing, for the layer there is resolved
    in_gaps: Array | None = None  # (N,) mask of those of closed gaps, which do not slide
    full = False  # whether all empty cells, if any, are those of closed gaps, for the tank is full
    tense: Array = np.zeros(0, dtype=np.int64)  # numbers of the particles at which the pressure jumps
    films: Array | None = None  # (P, 7) those that broke in the remeshing which made it, see `mesh.relabelled.FILM`
    poses: Array = np.zeros((0, 3))  # of what is rigid and moves: position x, y of its reference [m] and angle [rad]
    lost: float = 0.0  # energy that the remeshing which made it released for good, see `energy` [J]

    def energy(self, position: Array) -> float:
        """Energy that it has by the places (N, d) of the particles, gravity's excepted [J, per metre of depth]."""
        return 0.0

    def shut(self, case: Case, time: float) -> tuple[int, ...]:
        """Numbers of the openings of a case that are closed at a time [s]."""
        return ()

    def imposed(self, particles: Particles) -> Particles:
        """The particles with the velocities and accelerations that the part prescribes."""
        return particles

    def lasting(self, end: Any) -> Carried:
        """The part with accelerations that last until the step's ``end``, see `fem.time_integration.lasting`."""
        return self

    def targets(self, position: Array, spacing: float) -> Array | None:
        """The largest target spacings (N,) that it asks for, inf for none [m]; None where it asks for none at all."""
        return None

    def wetting_forces(
        self, mesh: Mesh, particles: Particles, cosines: Sequence[Any], on: Callable[[Array, Array], Array]
    ) -> Array | None:
        """Forces (N, 2) by which contacts are drawn along what lies in the fluids [N/m]; None for none.

        ``cosines`` of each, see `Case.contact_cosines`; sides of the hull between particles (K,) are ``on`` which, or
        -1.
        """
        return None


class OwnInertia(Carried, ABC):
    """A part in which fluids have other velocities than those of the particles alone."""

    cell: Array  # (K,) numbers of the cells with such fluids

    @abstractmethod
    def without(self, left: Array) -> OwnInertia:
        """The same on a mesh without some of its cells, by a mask (M,)."""

    @abstractmethod
    def products(self, a: Array, b: Array, lumpings: Sequence[float | Array]) -> list[float]:
        """Contribution to a^T M b of two fields (N, d), for the lumped part of each M, see `tipfem.fem.mass`."""

    @abstractmethod
    def work(self, acceleration: Array, displacement: Array, lumping: float | Array = 1.0) -> float:
        """Contribution to the work of accelerations (N, d) along displacements (N, d) [J]."""

    @abstractmethod
    def at_corners(self, field: Array) -> Array:
        """Contribution at the corners of its cells (K, d + 1, d) to a field of velocities (N, d)."""

    @abstractmethod
    def total(self, field: Array) -> Array:
        """Contribution to the sum (d,) of mass times a field (N, d)."""

    @abstractmethod
    def without_momentum(self, field: Array, mass: Array) -> Array:
        """Changes of velocities (N, d), whose sum with masses (N,) is 0, changed so that no momentum is made here."""


Part = TypeVar("Part", bound=Carried)


class HasParts:
    """State with parts by the names of their physics."""

    parts: Mapping[str, Carried]  # of the physics that carry something

    def part(self, kind: type[Part]) -> Part | None:
        """The part of a class; None where there is none."""
        return next((part for part in self.parts.values() if isinstance(part, kind)), None)

    def energies(self, position: Array) -> dict[str, float]:
        """Energies that the parts have by the places (N, d) of the particles, see `Carried.energy` [J]."""
        return {name: part.energy(position) for name, part in self.parts.items()}

    def stored(self, position: Array) -> float:
        """The sum of `energies` [J]."""
        return sum(self.energies(position).values())

    @property
    def own_inertia(self) -> list[OwnInertia]:
        """The parts in which fluids have other velocities than those of the particles."""
        return own_inertia(self.parts)


def own_inertia(parts: Mapping[str, Carried]) -> list[OwnInertia]:
    """Parts of a state in which fluids have other velocities than those of the particles."""
    return [part for part in parts.values() if isinstance(part, OwnInertia)]


def held_by_gaps(parts: Mapping[str, Carried]) -> Array | None:
    """Mask (N,) of the particles of closed gaps; None for none."""
    return next((part.in_gaps for part in parts.values() if part.in_gaps is not None), None)


def sliding(parts: Mapping[str, Carried], count: int) -> Array:
    """Mask (``count``,) of the wall particles that slide on parts of a state."""
    slides = filled(False, "", count, bool)
    for part in parts.values():
        if part.along is not None:
            slides |= nonzero(part.along)
    return slides


def kept_where_sliding(parts: Mapping[str, Carried], given: Particles, imposed: Particles) -> Particles:
    """The particles with what walls have ``imposed``, but on parts of a state that they slide on as ``given``."""
    slides = sliding(parts, len(given))
    if not slides.any():
        return imposed
    rates = {name: getattr(imposed, name).copy() for name in ("velocity", "acceleration")}
    for name, values in rates.items():
        values[slides] = getattr(given, name)[slides]
    return imposed.shallow_copy(**rates)


@dataclass(frozen=True)
class Remap:
    """A remeshing, from N particles to N'."""

    before: Mesh  # the mesh before it, with its components
    mesh: Mesh  # the mesh after it
    renumbered: Array | None  # (N,) new number of each particle, -1 for those removed; None if no number changes
    relocated: Array  # (N',) mask of the particles that were relocated or are new
    force: Array  # (N, d) acceleration by gravity and body force, or (1, d) where it is the same [m/s^2]
    # what cells that changed their fluid, as where films break, did to interfaces; None for nothing
    relabelled: Relabelled | None = None

    @classmethod
    def none(cls, mesh: Mesh) -> Remap:
        """Map to the first mesh: nothing has changed, and nothing is accelerated yet."""
        count, dimension = mesh.position.shape
        return cls(mesh, mesh, None, np.zeros(count, dtype=bool), np.zeros((1, dimension)))
