"""FlowProblem: the nonlinear problem of one time step, which connects the kernels, the terms and the solvers."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tipfem.backend.arrays import download, expect
from tipfem.backend.launch import launch
from tipfem.backend.runtime import on_gpu
from tipfem.case.boundary.boundary import IN_FLIGHT
from tipfem.case.particles import Particles
from tipfem.case.rheology import WIDTH
from tipfem.errors import StepRefused
from tipfem.fem import residual as assembly
from tipfem.fem import step_limits
from tipfem.fem import work as work_kernels
from tipfem.fem.bundles import Elements, Iterate, Linearisation
from tipfem.fem.time_integration import TimeScheme
from tipfem.linalg import fgmres, vector_kernels
from tipfem.linalg.queued_fgmres import QueuedSolve
from tipfem.mesh.mesh import Mesh
from tipfem.physics.term import ElementProperties, Equations, StepWork, Term, TermWork
from tipfem.scratch import owned, scratch
from tipfem.step.linear_system import LinearSystem, Workspace, covering_box
from tipfem.timers import timer
from tipfem.typing import Array


@dataclass(frozen=True)
class StepLimits:
    """Largest motion of the particles and deformation of the elements in a solution."""

    smallest_jacobian: float  # smallest J_{n+1} of an element; the element is inverted when it is <= 0
    largest_displacement: float  # of a particle, in its target spacings, less in free flight
    finite: bool  # whether all unknowns are finite

    def require(self, smallest_jacobian: float, reach: float) -> None:
        """Raises StepRefused unless all is finite, J >= ``smallest_jacobian``, displacements <= ``reach`` targets."""
        if not self.finite:
            raise StepRefused("the solution is not finite")
        if self.smallest_jacobian < smallest_jacobian:
            raise StepRefused(f"an element would be inverted or nearly so (J = {self.smallest_jacobian:.3g})")
        if self.largest_displacement > reach:
            raise StepRefused(f"a particle would move by {self.largest_displacement:g} spacings, more than {reach:g}")


class FlowProblem:
    """Momentum and continuity of one step; unknowns are displacements [m] and pressures [Pa].

    Args:
        mesh: simplices on the positions at the step's start.
        particles: the state there.
        properties: of the elements.
        body_force: (N, d) acceleration by gravity and the like [m/s^2], at the step's intermediate time.
        stabilisation: c in tau = c dt T, with the flow's own time T, taken as at least half a step, at most 100.
        workspace: arrays and grids that steps reuse.
        terms: the physics beside that of the elements, walls included, in the order in which they prescribe.
        stores_rows, exact: see `LinearSystem`.
        box: (2, d) that the multigrid's grids covered in the last step, see `covering_box`.
        flow_time: T [s], see `tipfem.step.solve.flow_time`; 0 for the length of the step.
    """

    @timer("set-up")
    def __init__(
        self,
        mesh: Mesh,
        particles: Particles,
        properties: ElementProperties,
        scheme: TimeScheme,
        body_force: Array,
        stabilisation: float,
        workspace: Workspace,
        terms: Sequence[Term] = (),
        *,
        stores_rows: bool = True,
        exact: bool = False,
        box: Array | None = None,
        flow_time: float = 0.0,
    ) -> None:
        self.mesh, self.particles, self.scheme, self.properties = mesh, particles, scheme, properties
        cut, frame = (
            next((value for term in terms if (value := getattr(term, name)) is not None), None)
            for name in ("cut", "frame")
        )
        self.terms, self.cut, self.frame = terms, cut, frame
        # c T / dt: what the kernels take for c.
        flow_time = min(flow_time, MOST_TIME * scheme.dt)
        time = max(flow_time, LEAST_TIME * scheme.dt) if flow_time > 0 else scheme.dt
        self.stabilisation = stabilisation * time / scheme.dt
        floor = stabilisation * scheme.dt * max(0.0, flow_time - scheme.dt)
        self.buffers = buffers = workspace.buffers
        put, get, d = buffers.upload, buffers.get, mesh.dimension
        owner, solved = (cut.owner, cut.mesh) if cut else (np.arange(len(particles), dtype=np.int32), mesh)
        self._copied = cut.owner[cut.copied] if cut else owner[:0]
        of_nodes = self._of_nodes
        self.nodes, self.elements, self.dimension = len(owner), len(mesh.cells), d
        self.rows = self.nodes + sum(term.extra_nodes for term in terms)
        self.size = self.rows * (d + 1)
        velocity, acceleration = scheme.history(particles.velocity, particles.acceleration, "problem.history")
        for term in terms:
            velocity, acceleration = term.histories(velocity, acceleration)
        walls = particles.wall
        for term in terms:
            walls = walls if term.unheld is None else walls & ~term.unheld
        self.equations = e = Equations(
            mesh,
            solved,
            owner,
            particles,
            properties,
            scheme,
            body_force,
            self.stabilisation,
            np.subtract(acceleration, body_force, out=acceleration),
            self.rows,
            walls,
            buffers,
            buffers.beside("period", mesh.period.array),
            workspace.topology(solved),
        )
        lumping, source, filled = properties.lumping, properties.source, buffers.filled
        self.source = source  # (M,) growth of the elements at the last residual
        self._target = target = particles.target
        if mesh.flies.any():
            self._target = target = np.where(mesh.flies, 1 / IN_FLIGHT, 1.0) * target
        same = target.min() == target.max()  # as without grading and flight
        self._targets = filled("target", self.nodes, target[0]) if same else put("target", of_nodes(target))
        fluid, laws = np.zeros(1, dtype=np.int32), np.zeros((1, WIDTH))
        if properties.laws is not None and properties.fluid is not None:
            fluid, laws = properties.fluid.astype(np.int32), properties.laws
        e.elements = Elements(
            put("density", properties.density),
            put("viscosity", properties.viscosity),
            put("source", source) if source.any() else filled("source", self.elements, 0.0),
            filled("lumping", self.elements, 1.0) if lumping is None else put("lumping", lumping),
            put("fluid", fluid),
            put("laws", laws),
            properties.laws is not None,
        )
        motion = buffers.draft("motion", self.nodes, 3 * d)
        fields = map(np.ascontiguousarray, (mesh.position, velocity, e.relative))
        launch(assembly.place_motion, *fields, owner, motion, d, work=(self.nodes, assembly.UNKNOWN))
        e.motion = put("motion", motion)
        e.scale, self._r, self._dx = (get(name, self.size) for name in ("scale", "residual", "correction"))
        # Entries of terms' rows that have no equation are set by nothing else, and would be those of an earlier step.
        for vector in (e.scale, self._r) if self.rows > self.nodes else ():
            launch(vector_kernels.fill, vector, 0.0, self.size, work=(self.size, vector_kernels.ENTRY))
        width = assembly.record_width(d, lawful=properties.laws is not None, axial=e.mesh.period.axial)
        local = get("local", self.elements * (d + 1), d + 1)
        e.linear = Linearisation(get("record", self.elements, width), local)
        self._wall = put("wall", of_nodes(walls))
        self._held_nodes = e.nodes_of(walls)
        self._held = put("reactions.nodes", self._held_nodes), get("reactions.force", len(self._held_nodes), d)
        self._linearised = self._corrected = False
        self._base = -1  # place of the iterate from which the last correction started; see `tipfem.fem.rheology`
        self._taken = (0.0, 0.0)  # parts of the last correction in the unknowns, of displacements and of pressures
        self._before = math.inf  # norm of the residual at the last `correct`
        self._norm = self._smallest = math.nan
        self._limits: StepLimits | None = None  # of the present unknowns
        # What is decided by limits that are measured, but not read yet; see `_by_limits`.
        self._measured: Any = None
        self._decide: Callable[[], bool] | None = None
        # A solve that may not be finished, and the unknowns before its correction.
        self._queued: QueuedSolve | None = None
        self._first: Any = None
        held = scratch("problem.held", (2, len(particles)), bool)
        held.fill(False)
        first = self.nodes
        for term in terms:
            term.begin(e, first)
            term.held(*held)
            first += term.extra_nodes
        # The grid moves with the tank, in whose frame the Laplacian is the same.
        position = mesh.position if frame is None else frame.position
        self.box = covering_box(position, particles.spacing, box, mesh.period)
        with timer("preconditioner"):
            self.system = LinearSystem(
                e,
                terms,
                put("held", of_nodes(held.T)),
                workspace.multigrid(self.box, particles.spacing, periodic=mesh.period.axes),
                solved.position if frame is None else of_nodes(position),
                floor,
                stores_rows=stores_rows,
                exact=exact,
            )
        self._reduces = self.system.reducible

    def _of_nodes(self, values: Array) -> Array:
        """Values (P, ...) of the nodes from those (N, ...) of particles, which are the first nodes."""
        if not len(self._copied):
            return values
        result, count = owned((self.nodes, *values.shape[1:]), values.dtype), len(values)
        result[:count], result[count:] = values, values[self._copied]
        return result

    def predict(self) -> Any:
        """First iterate: constant acceleration and pressure, or no motion where that would invert an element."""
        given = self.particles
        predicted = self.scheme.predict(given.velocity, given.acceleration, "problem.predicted")
        x = self.vector(predicted, given.pressure)
        self._by_limits(x, lambda: self._rest(x))
        return x

    def _rest(self, x: Any) -> bool:
        """Set the first iterate to no motion if another would invert an element; whether that is so."""
        self._smallest = self.limits(x).smallest_jacobian
        inverts = self._smallest < 0.3
        if inverts:
            for term in self.terms:
                term.rest()
            self.vector(np.zeros_like(self.mesh.position), self.particles.pressure)
            self._smallest = 1.0
        return inverts

    def _by_limits(self, x: Any, decide: Callable[[], bool]) -> None:
        """Decide by the `limits` of ``x``; where the host waits to read them, with the norm of the next `residual`."""
        if on_gpu() and self.frame is None:
            self._measured, self._decide = self._measure(x), decide
            expect(self._measured, 3)
        else:
            decide()

    def vector(self, displacement: Array, pressure: Array) -> Any:
        """Device vector of unknowns from (N, d), which is changed, and (N,), with what terms prescribe."""
        self._limits = self.equations.solution = None
        for term in self.terms:
            displacement, pressure = term.prescribe(displacement, pressure)
        x = self.buffers.draft("unknowns", self.rows * (self.dimension + 1))
        fields, table = map(np.ascontiguousarray, (displacement, pressure)), x.reshape(self.rows, self.dimension + 1)
        owner, work = self.equations.owner, (self.rows, assembly.UNKNOWN)
        launch(assembly.join_unknowns, *fields, owner, table, self.dimension, work=work)
        for term in self.terms:
            term.start(table)
        return self.buffers.upload("unknowns", x)

    def split(self, x: Any) -> tuple[Array, Array]:
        """Displacements (N, d) and pressures (N,) of a device vector of unknowns.

        Where there are several, the pressure is that of the heaviest fluid.
        """
        count = len(self.mesh.position)
        displacement, pressure = owned((count, self.dimension)), owned(count)
        fields, work = (displacement, pressure), (count, assembly.UNKNOWN)
        launch(assembly.split_unknowns, self.equations.values(x), *fields, self.dimension, work=work)
        return displacement, pressure

    @timer("residual")
    def residual(self, x: Any) -> float:
        """Evaluate the scaled residual at ``x`` and linearise; largest entry in spacings.

        Every row is scaled to a length [m], the displacement that would remove its residual.
        """
        self._evaluate(x)
        while self._queued and not self._queued.finished():
            self._copy(self._first, x)
            self._add_part(x, *(-part for part in self._taken))
            if self._decide:
                self._by_limits(x, self._decide)
            self._evaluate(x)
        if self._queued:
            _require_solved(self._queued.done(), self._queued.tolerance)
            self._queued = None
        decide, self._decide = self._decide, None
        if decide and decide():
            self._evaluate(x)
        return self._norm

    def _evaluate(self, x: Any) -> None:
        e = self.equations
        for term in self.terms:
            term.place(x)
        self._prescribe_growth(x)
        launch(
            assembly.residual,
            e.topology,
            e.period,
            e.motion,
            e.elements,
            Iterate(x, self._base),
            e.scale,
            e.linear,
            self._r,
            self.scheme.factors,
            self.stabilisation,
            e.sizes,
            work=(self.elements, assembly.ELEMENT),
        )
        for term in self.terms:
            term.residual(x, self._r)
        for term in self.terms:
            term.collect(x, self._r)
        self.system.condensation.collect(self._r)
        self._norm = fgmres.largest(self._r, self.size, self.buffers) / self.particles.spacing

    def _prescribe_growth(self, x: Any) -> None:
        """Set what terms prescribe at ``x``: growth of elements, and the volume by which all together are to grow."""
        grown = [volume for term in self.terms if (volume := term.growth(x)) is not None]
        sources = [each for term in self.terms if (each := term.sources()) is not None]
        if grown or sources:
            source, measure, more = self.properties.source, self.mesh.measure, 0.0
            if grown:
                # By einsum: BLAS would wake threads of its own, which look for more work for longer than a step takes.
                more = (sum(grown) - float(np.einsum("e,e->", measure, source))) / measure.sum()
            self.source = sum(sources, source)
            elements = self.equations.elements
            self.equations.elements = elements._replace(source=self.buffers.upload("source", self.source + more))

    @timer("jacobian")
    def linearise(self, *, reduced: bool = False) -> None:
        """Gather the Jacobian at the last `residual`, ``reduced`` to the pressures or not."""
        self.system.gather(reduced=reduced)
        self._linearised = True

    def acceleration(self, displacement: Array) -> Array:
        """a_alpha - b (N, d) [m/s^2] at displacements (N, d), with gravity and body force b."""
        result = np.multiply(self.scheme.cm, displacement, out=owned(displacement.shape))
        result += self.equations.relative
        return np.asarray(result)

    def conclude(self, x: Any) -> None:
        """Find what `work` and `reactions` tell of the solution ``x``; to be called where the last `residual` was."""
        self.equations.solution, self.equations._values = x, None
        e, held, sums = self.equations, len(self._held_nodes), work_kernels.WORKS + self.dimension
        get = self.buffers.get
        self._sums = get("work.sums", sums, double=True), get("work.left", 2, double=True)
        launch(
            work_kernels.step_work,
            e.topology,
            e.period,
            e.linear,
            e.elements.source,
            self._wall,
            x,
            self.buffers.partials("work", sums),
            self._sums[0],
            self.scheme.factors,
            e.sizes,
        )
        given = self._r, e.scale, self._wall, x, self.buffers.partials("left", 2), self._sums[1]
        launch(work_kernels.left_over, *given, self.nodes, self.dimension, work=(self.nodes, work_kernels.SUM))
        self._launch_forces(*self._held, held)
        read = (self._sums[0], sums), (self._sums[1], 2), (self._held[1], held), (x, self.nodes * (self.dimension + 1))
        for array, rows in read:
            expect(array, rows)
        for term in self.terms:
            term.expect()

    def settle(self, x: Any) -> None:
        """Pass the solution ``x`` to the terms; to be called where the last `residual` was."""
        for term in self.terms:
            term.settle(x, self._node_forces)

    def reactions(self, x: Any) -> Array:
        """(W, d) force of the walls and bodies on each of their particles at ``x``, after `conclude`.

        It is what the equation of momentum of the particle's row leaves, with its inertia and weight: their sum is the
        change of momentum of all fluids, less gravity and body force, at the intermediate time [N, per metre of depth
        in 2-D].
        """
        index, walls = self._held_nodes, self.particles.wall.nonzero()[0]
        force = self._with_terms(download(self._held[1], len(index)), x, index)
        of = np.searchsorted(walls, self.equations.owner[index])
        return np.stack([np.bincount(of, axis, minlength=len(walls)) for axis in force.T], axis=1)

    def _node_forces(self, x: Any, index: Array) -> Array:
        """(K, d) force that holds each of the nodes (K,) at ``x``, after `conclude`."""
        held = self._held_nodes
        if np.isin(index, held).all():
            return self._with_terms(download(self._held[1], len(held))[np.searchsorted(held, index)], x, index)
        out = self.buffers.get("held.force", len(index), self.dimension)
        self._launch_forces(self.buffers.upload("held.nodes", index), out, len(index))
        return self._with_terms(download(out, len(index)), x, index)

    def _launch_forces(self, nodes: Any, out: Any, count: int) -> None:
        """Set the forces ``out`` that hold ``nodes``, but for those of terms, on the device."""
        e = self.equations
        lists = e.topology.offsets, e.topology.corners, e.linear.local
        launch(work_kernels.node_forces, nodes, *lists, out, count, self.dimension)

    def _with_terms(self, force: Array, x: Any, index: Array) -> Array:
        """These forces (K, d) on the nodes (K,), with those of terms."""
        force = force.astype(np.float64)
        for term in self.terms:
            more = term.forces(x)
            if more is not None:
                force += more[index]
        return force

    def work(self, x: Any, displacement: Array) -> StepWork:
        """Work of each term at ``x`` with its displacements (N, d), after `conclude`."""
        result, left = download(self._sums[0], work_kernels.WORKS + self.dimension), download(self._sums[1], 2)
        viscous_dissipation, viscous, geometry, stabilisation, source, walls, *force = result.tolist()
        elements = TermWork(
            viscous=viscous,
            viscous_dissipation=viscous_dissipation,
            geometry=geometry,
            stabilisation=stabilisation,
            walls=walls - float(left[1]),
            wall_force=np.array(force),
            left=float(left.sum()),
        )
        return StepWork.of([elements, *(term.work(x, displacement) for term in self.terms)], source)

    def product(self, v: Any, out: Any) -> None:
        """out = K v, the derivative of the scaled residual at the last `linearise` along ``v``."""
        self.system.product(v, out)

    def precondition(self, r: Any, z: Any) -> None:
        """z ~ K^-1 r, see `LinearSystem`."""
        self.system.precondition(r, z)

    def correct(self, x: Any, tolerance: float) -> fgmres.KrylovResult | QueuedSolve:
        """Solve K dx = -r, linearised at the last `residual`, by preconditioned FGMRES and add dx to ``x``.

        Where ``tolerance`` is no tighter than the change of K since the last correction, K is not gathered again. It is
        reduced to the pressures where it can be and ``tolerance`` is loose, until a correction leaves much of the
        residual.
        The displacements of dx are damped, see `_add`. What a GPU does is known at the next `residual` only.

        Raises:
            StepRefused: see `_require_solved`; from a GPU, by the next `residual`.
        """
        if self._norm > (SLOW if self._norm < NEARLY_LINEAR else STUCK) * self._before:
            # Nor is the matrix kept that is reduced now: it would serve on wherever tolerances are loose.
            self._reduces, self._linearised = False, self._linearised and not self._reduces
        self._before = self._norm
        if tolerance < KEEPS_JACOBIAN or not self._linearised:
            self.linearise(reduced=self._reduces and tolerance >= LOOSE)
        with timer("krylov"):
            result = self.system.solve(self._r, self._dx, tolerance, MAX_KRYLOV_ITERATIONS)
        if isinstance(result, QueuedSolve) and (self.frame is not None or any(term.remembers for term in self.terms)):
            result = result.done()
        if isinstance(result, QueuedSolve):
            self._queued, self._first = result, self.buffers.get("queued.first", self.size)
            self._copy(x, self._first)
        else:
            _require_solved(result, tolerance)
        self._add(x)
        self._base = 1 if self._base == 0 else 0
        return result

    def _add(self, x: Any) -> None:
        """Subtract the solution of the linear problem from ``x``; of its displacements as much as elements bear.

        If the first residual is above `GUESSED`, the pressures of light elements, whose particles changed in the last
        remeshing, were a bad guess, and so is the Jacobian: then only the pressures are corrected, in which the
        equations are nearly linear. If an element would be inverted, or nearly, the displacements are halved until J is
        above `DAMPED`, or half of what it was: there is no way back from iterates with J < 0, although the residual
        often falls on the way there.
        """
        first, self._corrected = not self._corrected, True
        part = 0.0 if first and self._norm > GUESSED else 1.0
        self._add_part(x, -part, -1.0)
        self._taken = part, 1.0
        if part == 0.0:
            return
        bound = min(DAMPED, 0.5 * self._smallest)
        self._by_limits(x, lambda: self._damp(x, bound))

    def _damp(self, x: Any, bound: float) -> bool:
        """Halve the displacements that were added to ``x`` until J is above the bound; whether any were."""
        part = 1.0
        self._smallest = self.limits(x).smallest_jacobian
        while self._smallest < bound and part > SMALLEST_PART:
            part *= 0.5
            self._add_part(x, part, 0.0)
            self._taken = part, 1.0
            self._smallest = self.limits(x).smallest_jacobian
        return part < 1.0

    def halve(self, x: Any) -> None:
        """Take half of the last correction back from ``x``."""
        motion, pressure = (0.5 * part for part in self._taken)
        self._taken = motion, pressure
        self._add_part(x, motion, pressure)

    def _copy(self, x: Any, to: Any) -> None:
        launch(vector_kernels.copy_entries, x, 0, to, self.size, work=(self.size, vector_kernels.ENTRY))

    def _add_part(self, x: Any, motion_factor: float, pressure_factor: float) -> None:
        size, work = self.size, (self.size, vector_kernels.ENTRY)
        factors, self._limits = (motion_factor, pressure_factor), None
        self.equations.solution = None
        launch(step_limits.add_correction, self._dx, x, *factors, size, self.dimension, work=work)

    def limits(self, x: Any) -> StepLimits:
        """Smallest J_{n+1} and largest displacement of ``x``, relative to the tank's motion."""
        found, self._measured = self._measured, None
        result = download(self._measure(x) if found is None else found, 3)
        if self.frame is not None:
            square = (self.frame.relative(self.split(x)[0]) ** 2).sum(axis=1)
            result[1] = (square / self._target**2).max()
        self._limits = StepLimits(float(result[0]), float(np.sqrt(result[1])), result[2] == 0)
        return self._limits

    def _measure(self, x: Any) -> Any:
        """An array with what `limits` reads."""
        found = self.buffers.get("limits.found", 3, double=True)
        launch(
            step_limits.step_limits,
            self.equations.topology.cells,
            self.equations.motion,
            self.equations.period,
            self._targets,
            x,
            self.buffers.partials("limits", 3),
            found,
            self.equations.sizes,
            work=(self.elements, step_limits.ELEMENT),
        )
        return found

    def last_limits(self, x: Any) -> StepLimits:
        """`limits` of the unknowns ``x`` of the last `vector` or `correct`, computed only if they are not known."""
        return self._limits or self.limits(x)


def _require_solved(result: fgmres.KrylovResult, tolerance: float) -> None:
    """Raises StepRefused if the iterations reached their limit and left more than `USEFUL` of the residual."""
    if not result.relative_residual <= max(tolerance, USEFUL):
        raise StepRefused(
            f"the linear system was not solved in {result.iterations} iterations: its residual is "
            f"{result.relative_residual:.1e} of the first, the tolerance {tolerance:.1e}"
        )


# Krylov iterations of a correction; and the part of a residual at which one that has not reached its tolerance by then
# is of use, and Newton's method goes on from it.
MAX_KRYLOV_ITERATIONS, USEFUL = 80, 0.1
LEAST_TIME, MOST_TIME = 0.5, 100.0  # T in the stabilisation's tau, in steps; see `tipfem.step.solve.flow_time`
GUESSED = 3.0  # first residual above which pressures are corrected before displacements [spacings]
DAMPED = 0.2  # J that a correction leaves to every element
SMALLEST_PART = 1e-3  # of the displacements of a correction
# A linear tolerance from which on a system is reduced to the pressures; a residual [spacings] below which little of it
# is due to what is not linear, and the parts of it, and of a larger one, that a slow correction leaves.
LOOSE, NEARLY_LINEAR, SLOW, STUCK = 1e-2, 0.1, 0.2, 0.8
KEEPS_JACOBIAN = 3e-2  # linear tolerance above which an iteration reuses the last Jacobian
