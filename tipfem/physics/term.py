"""Term: a physics in the equations of a step.

The bulk flow on the elements is in `tipfem.fem`. Everything else that acts in a step is a `Term`: walls, pressures on
both sides of interfaces, liquids that slide, bodies, a free surface. The problem and the linear system of a step call
the methods below on all terms in turn, and name none of them. A term has the methods that it needs; the others do
nothing. docs/develop/adding-a-term.md walks through one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from tipfem.backend.arrays import Buffers, download
from tipfem.case.particles import Particles
from tipfem.fem.bundles import Elements, Linearisation, Sizes, Topology
from tipfem.fem.condensation import Follows
from tipfem.fem.time_integration import TimeScheme
from tipfem.linalg.low_rank import LowRank
from tipfem.linalg.sparsity import Csr
from tipfem.mesh.cut import CutMesh
from tipfem.mesh.mesh import Mesh
from tipfem.physics.carried import Carried
from tipfem.scratch import scratch
from tipfem.typing import Array


@dataclass(frozen=True)
class ElementProperties:
    """Properties of the M elements in a step."""

    density: Array  # (M,) [kg/m^3]
    viscosity: Array  # (M,) [Pa s]
    source: Array  # (M,) relative growth of volume in the step, s in J - 1 = s
    lumping: Array | None = None  # (M,) part of the mass matrix that is lumped; None for all, see `tipfem.fem.mass`
    # (F, 8) of the viscosity, which is that at the step's start, see `tipfem.case.rheology`; None where it is constant
    laws: Array | None = None
    fluid: Array | None = None  # (M,) that they are of; None with them

    @property
    def lumped(self) -> Array:
        """(M,) part of the mass matrix that is lumped."""
        return np.ones(len(self.density)) if self.lumping is None else self.lumping


@dataclass
class Equations:
    """The equations of a step: P nodes on N particles, and the unknowns that terms add behind those of the nodes."""

    mesh: Mesh  # M cells on the particles, at their positions at the step's start
    nodes: Mesh  # the same cells on the nodes
    owner: Array  # (P,) the particle of each node; the first N are the particles themselves
    particles: Particles  # at the step's start
    properties: ElementProperties  # of the elements
    scheme: TimeScheme  # time integration, with the step's length
    force: Array  # (N, d) acceleration by gravity and body force at the intermediate time [m/s^2]
    stabilisation: float  # c T / dt, see `tipfem.step.problem`
    relative: Array  # (N, d) part of a_alpha - b that does not depend on the step's displacements [m/s^2]
    rows: int  # number of nodes, with those of terms: each has d + 1 entries in vectors of unknowns
    walls: Array  # (N,) mask of the particles that walls and bodies hold, but not those where fluids enter and leave
    buffers: Buffers  # device arrays by name
    period: Any  # the array of the mesh's period, beside device arrays
    # topology, motion, scale, elements, linear: device arrays, see `tipfem.fem.residual`; the latter are set there
    topology: Topology
    motion: Any = None
    scale: Any = None
    elements: Elements = None  # type: ignore[assignment]
    linear: Linearisation = None  # type: ignore[assignment]
    solution: Any = None  # the vector of unknowns that does not change any more, None before
    _values: Array | None = None

    @property
    def dimension(self) -> int:
        """d."""
        return self.mesh.dimension

    @cached_property
    def sizes(self) -> Sizes:
        """Numbers of elements and nodes, and d."""
        return Sizes(len(self.mesh.cells), len(self.owner), self.mesh.dimension)

    @property
    def size(self) -> int:
        """Number of entries of a vector of unknowns."""
        return self.rows * (self.dimension + 1)

    @cached_property
    def viscous_number(self) -> float:
        """Largest nu dt / h^2: the square of the part of a spacing by which viscosity moves momentum in a step."""
        ratio = scratch("viscous_number.ratio", len(self.properties.density))
        nu = np.divide(self.properties.viscosity, self.properties.density, out=ratio).max(initial=0.0)
        return float(nu * self.scheme.cv / self.scheme.cm / self.particles.spacing**2)

    def values(self, x: Any) -> Array:
        """(P, d + 1) displacements and pressures of the nodes in a device vector of unknowns; to be read only."""
        if x is self.solution and self._values is not None:
            return self._values
        count, width = len(self.owner), self.dimension + 1
        # The solution is not changed before the next problem.
        given = download(x, count * width, copy=x is not self.solution)
        values = given.astype(np.float64, copy=False).reshape(count, width)
        if x is self.solution:
            values.flags.writeable = False
            self._values = values
        return values

    def nodes_of(self, particles: Array) -> Array:
        """(K,) numbers of the nodes of the particles in a mask (N,), int32."""
        copies = len(particles) + np.flatnonzero(particles[self.owner[len(particles) :]])
        return np.concatenate([np.flatnonzero(particles), copies]).astype(np.int32)


@dataclass(frozen=True)
class TermWork:
    """Work of a term in a step, tested with displacements and pressures [J, per metre of depth in 2-D]."""

    inertia: float = 0.0  # of mass times acceleration, beside that of the particles
    # viscous, viscous_dissipation: work against viscous stress, and what it dissipates
    viscous: float = 0.0
    viscous_dissipation: float = 0.0
    geometry: float = 0.0  # of pressure and weight between the intermediate and the last positions
    stabilisation: float = 0.0  # loss by the stabilisation of pressure
    # friction, friction_dissipation: work against friction, and what it dissipates
    friction: float = 0.0
    friction_dissipation: float = 0.0
    # against forces that have a potential, gravity excepted; see `tipfem.physics.carried.Carried.energy`
    stored: float = 0.0
    walls: float = 0.0  # of the forces that walls and bodies exert in addition
    weight: float = 0.0  # of the volumes that the term moves; a part of ``geometry``
    passed: float = 0.0  # of those that pass thin edges when particles are put back; a part of ``weight``
    wall_force: Array | float = 0.0  # (d,) resultant of these forces [N]; 0 for none
    force: Array | float = 0.0  # (d,) part of the sum of mass times acceleration [N]; 0 for none
    passing: float = 0.0  # of the forces where fluids enter and leave
    passing_force: Array | float = 0.0  # (d,) resultant of these [N]; 0 for none
    # of the forces on what is moved, with its velocity at the time of the forces, less that with displacements
    lag: float = 0.0
    # of the residual that Newton's method has left, but for that at walls, which counts as their force
    left: float = 0.0


@dataclass(frozen=True)
class StepWork(TermWork):
    """Work of all terms of a step, those of the elements included."""

    source: float = 0.0  # of pressure on the prescribed growth
    stored_by: tuple[float, ...] = ()  # ``stored`` of each term, in their order, that of the elements first

    @classmethod
    def of(cls, parts: Sequence[TermWork | None], source: float) -> StepWork:
        """The sum of the terms' parts, None for none."""
        there = [part.__dict__ for part in parts if part is not None]
        sums = {name: sum([part[name] for part in there]) for name in TermWork.__dataclass_fields__}
        stored = tuple(0.0 if part is None else part.stored for part in parts)
        return cls(**sums, source=source, stored_by=stored)

    @property
    def dissipated(self) -> float:
        """By viscosity and by friction along walls [J, per metre of depth in 2-D]."""
        return self.viscous_dissipation + self.friction_dissipation


@dataclass(frozen=True)
class Frame:
    """The frame of a tank that moves."""

    position: Array  # (N, d) of the particles at the step's start, in it [m]
    # displacements (N, d) relative to its motion, from those in the frame of the laboratory [m]
    relative: Callable[[Array], Array]


class Term:
    """A physics in the equations of a step; see the module. ``x`` is a device vector of unknowns."""

    cut: CutMesh | None = None  # nodes that each have a pressure, where particles have several; None where each has one
    frame: Frame | None = None  # of the tank, if it moves; None otherwise
    extra_nodes = 0  # nodes of unknowns of its own; their numbers begin with ``first_node``, see `begin`
    # device array of nodes at one place, see `tipfem.linalg.multigrid.mesh_transfer`, and their number; None for none
    groups: tuple[Any, int] | None = None
    # what few unknowns of its own add to the Schur complement, set by `prepare`; None for nothing
    low_rank: LowRank | None = None
    unheld: Array | None = None  # (N,) mask of wall particles that no wall holds; None for none
    grounds = False  # whether it gives the pressure somewhere, beside free surfaces
    tolerance = 0.0  # of the residual, up to which the step is solved [spacings]; set before it is
    noise = 0.0  # residual that round-off leaves in it [spacings]
    remembers = False  # whether a residual depends on those before it: none may be in vain, as on a GPU some are
    unfinished = False  # whether it asks for a correction more, though the residual may be within the tolerance

    # What is prescribed.

    def held(self, displacement: Array, pressure: Array) -> None:
        """Set masks (N,) of the particles whose displacements and pressures are prescribed."""

    def histories(self, velocity: Array, acceleration: Array) -> tuple[Array, Array]:
        """v_alpha and a_alpha (N, d) at u = 0, from those of free particles, which may be changed."""
        return velocity, acceleration

    def prescribe(self, displacement: Array, pressure: Array) -> tuple[Array, Array]:
        """Displacements (N, d) and pressures (N,) with what the term prescribes; displacements may be changed."""
        return displacement, pressure

    def start(self, x: Array) -> None:
        """Set what is not of particles in a first vector of unknowns (R, d + 1), on the host."""

    # The equations.

    def begin(self, equations: Equations, first_node: int) -> None:
        """Take the equations of the step, whose device arrays exist, before the rows have their scale."""

    def follows(self) -> Follows | None:
        """Relations of displacements at the last `residual`; always of the same nodes. None for none.

        Where they have not changed, the same object spares the linear system to take them in again.
        """
        return None

    def couplings(self, *, near: bool) -> tuple[Array, Array] | None:
        """Rows and columns (K,) of the nodes that `gather` couples, integers; None for none.

        Those that have a cell in common are needed only if ``near``: where the elements' rows are not stored.
        """
        return None

    def diagonal(self) -> None:
        """Add to the diagonal of the momentum equations, one over which the rows' scale is."""

    def diagonal_done(self) -> None:
        """Read the final row scaling."""

    def schur_complement(self, laplacian: Csr) -> Csr:
        """The preconditioner's approximate Schur complement of the pressure, with what the term adds to it."""
        return laplacian

    def labels(self) -> Array | None:
        """(P,) which connected part of the pressure each node belongs to; None for those of the mesh."""
        return None

    def prepare(self, solve_laplacian: Callable[[], None], vectors: Any) -> None:
        """Prepare the preconditioner: its cycle for the pressure Laplacian acts on the multigrid's ``vectors``."""

    def place(self, x: Any) -> None:
        """Set in ``x`` what follows from other unknowns, before the elements are evaluated."""

    def sources(self) -> Array | None:
        """Relative growth (M,) of the elements in the step at the last `place`, beside others'; None for none."""
        return None

    def growth(self, x: Any) -> float | None:
        """Volume by which all elements together are to grow [m^2, or m^3]; None where nothing is prescribed."""
        return None

    def residual(self, x: Any, out: Any) -> None:
        """Add the term's forces and volumes at ``x`` to the scaled residual of all nodes."""

    def collect(self, x: Any, out: Any) -> None:
        """Set the rows of the term's own unknowns, from the rows of the nodes that follow them."""

    def gather(self, matrix: Csr) -> None:
        """Add the derivative at the last `residual` to the matrix's rows, before it is condensed."""

    def gather_own(self, matrix: Csr) -> None:
        """Add the derivative of the rows of the term's own unknowns, after the matrix is condensed."""

    # The solution.

    def expect(self) -> None:
        """Announce the device arrays read of the solution, where the last `residual` was; see `arrays.expect`."""

    def rest(self) -> None:
        """Zero the term's own unknowns in the initial guess."""

    def settle(self, x: Any, forces: Callable[[Any, Array], Array]) -> None:
        """Take the solution, where the last `residual` was; ``forces`` (K, d) of ``x`` hold nodes (K,) [N]."""

    def finish(self, displacement: Array, particles: Particles) -> Particles:
        """The particles at the end of the step, which the solution moved by (N, d), with what the term prescribes.

        The arrays of their positions, velocities and accelerations may be changed.
        """
        return particles

    def carried(self, x: Any) -> Carried | None:
        """Carried state after the solution, on the particles of the step; None for the state before."""
        return None

    def forces(self, x: Any) -> Array | None:
        """(P, d) forces on the nodes beside those of the elements, at ``x`` [N]; None for none."""
        return None

    def work(self, x: Any, displacement: Array) -> TermWork | None:
        """Work in the step, where the last `residual` was; None for none."""
        return None
