"""FlowProblem: the nonlinear problem of one time step, which connects the kernels and the solvers."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from tipfem.backend.arrays import download
from tipfem.backend.launch import launch
from tipfem.case.boundary import Boundary
from tipfem.case.particles import Particles
from tipfem.errors import StepRefused
from tipfem.fem import residual as assembly
from tipfem.fem import step_limits
from tipfem.fem import work as work_kernels
from tipfem.fem.time_integration import TimeScheme
from tipfem.linalg import fgmres, vector_kernels
from tipfem.mesh.cut import cut_along_interfaces
from tipfem.mesh.interface_slip import InterfaceSlip
from tipfem.mesh.mesh import Mesh, parabola, volume_gradient
from tipfem.state import StepWork
from tipfem.step.body_rows import BodyRows
from tipfem.step.interface_ties import InterfaceTies
from tipfem.step.linear_system import LinearSystem, Workspace, covering_box
from tipfem.step.matrix_free import MatrixFreeSystem
from tipfem.step.slip_rows import SlipRows
from tipfem.timers import timer
from tipfem.typing import Array
from tipfem.walls.bodies import BodyWalls
from tipfem.walls.constraints import WallRows
from tipfem.walls.step import FixedWalls, Walls


@dataclass(frozen=True)
class ElementProperties:
    """Properties of the M elements in a step.

    Attributes:
        density: (M,) [kg/m^3].
        viscosity: (M,) [Pa s].
        source: (M,) relative growth of volume in the step, s in J - 1 = s.
        lumping: (M,) part of the mass matrix that is lumped; None for all, see `tipfem.fem.mass`.
    """

    density: Array
    viscosity: Array
    source: Array
    lumping: Array | None = None


@dataclass(frozen=True)
class StepLimits:
    """How far a solution moves the particles and deforms the elements.

    Attributes:
        smallest_jacobian: smallest J_{n+1} of an element; the element is inverted when it is <= 0.
        largest_displacement: of a particle, in its target spacings.
        finite: whether all unknowns are finite.
    """

    smallest_jacobian: float
    largest_displacement: float
    finite: bool

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
        scheme: time integration, with the step's length.
        body_force: (N, d) acceleration by gravity and the like [m/s^2], at the step's intermediate time.
        stabilisation: c in tau = c dt T, with the flow's own time T, taken as at least half a step, at most 100.
        workspace: arrays and grids that steps reuse.
        walls: their constraints in the step; by default all are fixed and no-slip.
        jacobian: "rows" or "matrix-free", see `tipfem.Numerics`.
        box: (2, d) that the multigrid's grids covered in the last step, see `covering_box`.
        pressure_jump: (F, N) first guess of the pressure of each fluid at each particle less that of the particle
            [Pa]; None for a pressure that is continuous, see `tipfem.Numerics`.
        flow_time: T [s], see `tipfem.step.solve.flow_time`; 0 for the length of the step.
        slip: where liquids slide along each other, if they do; with ``pressure_jump``.
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
        walls: Walls | None = None,
        jacobian: str = "rows",
        box: Array | None = None,
        pressure_jump: Array | None = None,
        flow_time: float = 0.0,
        slip: InterfaceSlip | None = None,
    ) -> None:
        system = MatrixFreeSystem if jacobian == "matrix-free" else LinearSystem
        self.mesh, self.particles, self.scheme, self.properties = mesh, particles, scheme, properties
        self.walls = walls = walls or FixedWalls(Boundary(particles, (), None), mesh, particles, scheme)
        # c T / dt: what the kernels take for c.
        flow_time = min(flow_time, MOST_TIME * scheme.dt)
        time = max(flow_time, LEAST_TIME * scheme.dt) if flow_time > 0 else scheme.dt
        self.stabilisation = stabilisation * time / scheme.dt
        floor = stabilisation * scheme.dt * max(0.0, flow_time - scheme.dt)
        self.dimension = d = mesh.dimension
        self.buffers = buffers = workspace.buffers
        put = buffers.upload
        # Nodes are the particles, and the copies of those on interfaces where each side has its own pressure.
        self._cut = None if pressure_jump is None else cut_along_interfaces(mesh, properties.density)
        self._pressure_jump = pressure_jump
        self._ties = InterfaceTies(self._cut, walls, buffers) if self._cut and self._cut.copies else None
        of_node: Array | slice = self._cut.owner if self._cut else slice(None)
        solved = self._cut.mesh if self._cut else mesh
        self.nodes, self.elements = len(solved.position), len(mesh.cells)
        floating = int(walls.floating.sum()) if isinstance(walls, BodyWalls) else 0
        self.size = self.nodes * (d + 1) + 3 * floating
        self._topology = workspace.topology(solved)
        self._target = put("target", particles.target[of_node])
        self._density = put("density", properties.density)
        self._viscosity = put("viscosity", properties.viscosity)
        self._source = put("source", properties.source)
        lumping = np.ones(self.elements) if properties.lumping is None else properties.lumping
        self._lumping = put("lumping", lumping)
        velocity, acceleration = walls.histories(*scheme.history(particles))
        self._scale = buffers.get("scale", self.size)
        self._slip = None if slip is None else self._slip_rows(slip, acceleration, body_force, lumping)
        acceleration -= body_force
        self._motion = put("motion", np.hstack([mesh.position, velocity, acceleration])[of_node])
        self._owner = self._cut.owner if self._cut else None
        self._wall, self._relative = put("wall", particles.wall[of_node]), acceleration
        self._local = buffers.get("local", self.elements * (d + 1), d + 1)
        self._record = buffers.get("record", self.elements, assembly.record_width(d))
        self._r = buffers.get("residual", self.size)
        self._linearised = self._corrected = False
        self._norm = self._smallest = math.nan
        self._limits: StepLimits | None = None  # of the present unknowns
        self._dx = buffers.get("correction", self.size)
        self._force, free = body_force, mesh.surface
        # Where fluids end at a surface, its particles move by what curved walls do not.
        self._curves = None if free.exists else walls.curves
        # The grid moves with the tank, in whose frame the Laplacian is the same.
        frame = walls.frame
        self.box = covering_box(frame, particles.spacing, box, mesh.period)
        extremes = (properties.density.min(initial=np.inf), properties.density.max(initial=0.0))
        with timer("preconditioner"):
            self.system = system(
                self._topology,
                solved,
                self._motion,
                (self._density, self._viscosity, self._lumping),
                extremes,
                put("held", np.stack([walls.fixed | free.loose, free.pinned], axis=1)[of_node]),
                self._scale,
                scheme,
                workspace.multigrid(self.box, particles.spacing, periodic=mesh.period.axes),
                solved.position if frame is mesh.position else frame[of_node],
                particles.spacing,
                buffers,
                self._ties,
                self._surface_volume() if free.exists else None,
                floor,
                self._slip,
            )
        self._rows = self.system.walls = WallRows(walls, d, self._scale, buffers, solved.cells, self._owner)
        if self._ties:
            self._ties.spread(self._scale)  # which friction of walls has changed
        self._bodies: BodyRows | None = None
        if floating:
            assert isinstance(walls, BodyWalls)
            with timer("bodies"):
                material = properties.density, properties.viscosity, lumping
                pinned, owner = free.pinned[of_node], self._owner
                self._bodies = BodyRows(
                    walls, solved, owner, material, body_force, pinned, self.system, self._scale, buffers
                )
            self.system.bodies = self._bodies

    def _slip_rows(self, slip: InterfaceSlip, acceleration: Array, body_force: Array, lumping: Array) -> SlipRows:
        """The equations of liquids that slide, from the part (N, 2) of a_alpha that the step does not change."""
        assert self._cut is not None
        scheme, cell, given = self.scheme, slip.cell, self.properties
        position = self.mesh.position + scheme.cf * scheme.predict(self.particles)
        length2 = 4 / math.pi * self.mesh.measure[cell]
        viscous = 12 * given.viscosity[cell] / (given.density[cell] * length2)
        tau = scheme.dt / np.hypot(1 / (self.stabilisation * scheme.dt), viscous)
        motion = scheme, position, acceleration, body_force
        return SlipRows(slip, self._cut, tau, lumping[cell], *motion, self._scale, self.buffers)

    def _surface_volume(self) -> tuple[Array, Array]:
        """The free particles (K,) on the surface, and the derivatives (K, d) of the volume by their displacements."""
        mesh, walls, d = self.mesh, self.walls, self.dimension
        index = np.flatnonzero(mesh.surface.front & ~walls.fixed)
        near = np.zeros(len(mesh.position), dtype=bool)
        near[index] = True
        gradient = volume_gradient(mesh, near)
        if len(walls.sliding):
            projected = np.einsum("kij,kj->ki", walls.columns.reshape(-1, d, d), gradient[walls.sliding])
            gradient[walls.sliding] = projected
        return index, gradient[index]

    def predict(self) -> Any:
        """First iterate: constant acceleration and pressure, or no motion where that would invert an element."""
        x = self.vector(self.scheme.predict(self.particles), self.particles.pressure)
        self._smallest = self.limits(x).smallest_jacobian
        if self._smallest < 0.3:
            if isinstance(self.walls, BodyWalls):
                self.walls.solved(np.zeros_like(self.walls.increment))
            x = self.vector(np.zeros_like(self.mesh.position), self.particles.pressure)
            self._smallest = 1.0
        return x

    def vector(self, displacement: Array, pressure: Array) -> Any:
        """Device vector of unknowns from (N, d) and (N,); wall particles are displaced as their walls prescribe.

        Bodies that float have their present increments in ``walls``.
        """
        self._limits = None
        x = np.empty((len(displacement), self.dimension + 1))
        x[:, :-1], x[:, -1] = self.walls.constrain(displacement), pressure
        if self.mesh.surface.exists:
            flight = parabola(self.particles.velocity, self._force, self.scheme.dt)
            x[:, :-1], x[:, -1] = self.mesh.surface.constrain(x[:, :-1], pressure, flight)
        if self._cut:
            assert self._pressure_jump is not None
            x = x[self._cut.owner]
            x[self._cut.copied, -1] += self._pressure_jump[self._cut.fluid, self._cut.owner][self._cut.copied]
        if self._bodies:
            assert isinstance(self.walls, BodyWalls)
            return self.buffers.upload("unknowns", np.append(x.ravel(), self._bodies.vector(self.walls.increment)))
        return self.buffers.upload("unknowns", x.ravel())

    def split(self, x: Any) -> tuple[Array, Array]:
        """Displacements (N, d) and pressures (N,) of a device vector of unknowns.

        Where there are several, the pressure is that of the heaviest fluid.
        """
        width = self.dimension + 1
        values = download(x, self.nodes * width).astype(np.float64, copy=False).reshape(self.nodes, width)
        values = values[: len(self.mesh.position)]
        return values[:, :-1].copy(), values[:, -1].copy()

    def pressure_jump(self, x: Any) -> Array | None:
        """(F, N) pressure of each fluid less that of the particle in a device vector of unknowns; None if continuous.

        Where a particle is in several components of a fluid, it is that of one of them.
        """
        if not self._cut:
            return None
        assert self._pressure_jump is not None
        values = download(x, self.nodes * (self.dimension + 1)).astype(np.float64, copy=False)
        pressure = values.reshape(self.nodes, -1)[:, -1]
        copied, owner = self._cut.copied, self._cut.owner[self._cut.copied]
        result = np.zeros_like(self._pressure_jump)
        result[self._cut.fluid[copied], owner] = pressure[copied] - pressure[owner]
        return result

    @timer("residual")
    def residual(self, x: Any) -> float:
        """Evaluate the scaled residual at ``x`` and linearise; largest entry in spacings.

        Every row is scaled to a length [m], the displacement that would remove its residual.
        """
        s = self.scheme
        if self._bodies:
            self._bodies.place(x, self._motion)
        if self._curves:
            self._displacement = self.split(x)[0]
            growth = self._curves.growth(self._displacement) - float(self.mesh.measure @ self.properties.source)
            self._source = self.buffers.upload("source", self.properties.source + growth / self.mesh.measure.sum())
        launch(
            assembly.residual,
            *self._topology,
            self.mesh.period.array,
            self._motion,
            self._density,
            self._viscosity,
            self._source,
            self._lumping,
            x,
            self._scale,
            self._record,
            self._local,
            self._r,
            s.cm,
            s.cv,
            s.cf,
            s.dt,
            self.stabilisation,
            self.elements,
            self.nodes,
            self.dimension,
        )
        if self._ties:
            self._ties.collect(self._r)
        if self._slip:
            self._slip.residual(x, self._r)
        self._rows.residual(self._motion, x, self._r)
        if self._bodies:
            self._bodies.residual(x, self._r)
        self._norm = fgmres.largest(self._r, self.size, self.buffers) / self.particles.spacing
        return self._norm

    @timer("jacobian")
    def linearise(self) -> None:
        """Gather the Jacobian at the last `residual`."""
        if self._curves:
            here, rows = self.walls.on_curves
            self._rows.turn(here, self._curves.projector_at(self._displacement)[rows])
        self.system.gather(self._record)
        if self._bodies:
            self._bodies.linearise(self._density, self._lumping, self._record)
        self._linearised = True

    def acceleration(self, displacement: Array) -> Array:
        """a_alpha - b (N, d) [m/s^2] at displacements (N, d), with gravity and body force b."""
        return self.scheme.cm * displacement + self._relative

    def settle_bodies(self, x: Any) -> None:
        """Tell the walls where the solution ``x`` puts the bodies, and what forces the fluids exert on them.

        To be called where the last `residual` was.
        """
        walls = self.walls
        if not isinstance(walls, BodyWalls):
            return
        if self._bodies:
            walls.solved(self._bodies.increments(x))
            index, (_, acceleration) = walls.index, walls.rates()
            u = walls.displacements(walls.increment)
            self._relative[index] = acceleration - self._force[index] - self.scheme.cm * u
        index = self._nodes_where(walls.states.label >= 0)
        walls.measured(index if self._owner is None else self._owner[index], -self._node_forces(x, index))

    def reactions(self, x: Any) -> Array:
        """(W, d) force of the walls and bodies on each of their particles at ``x``, where the last `residual` was.

        It is what the equation of momentum of the particle's row leaves, with its inertia and weight: their sum is the
        change of momentum of all fluids, less gravity and body force, at the intermediate time [N, per metre of depth
        in 2-D].
        """
        wall = self.particles.wall
        index, rank = self._nodes_where(wall), np.cumsum(wall) - 1
        force, of = self._node_forces(x, index), rank[index if self._owner is None else self._owner[index]]
        return np.stack([np.bincount(of, axis, minlength=int(wall.sum())) for axis in force.T], axis=1)

    def _nodes_where(self, mask: Array) -> Array:
        """The nodes (K,) of the particles in a mask (N,)."""
        return np.flatnonzero(mask if self._owner is None else mask[self._owner]).astype(np.int32)

    def _node_forces(self, x: Any, index: Array) -> Array:
        """(K, d) force that holds each of the nodes (K,) at ``x``, where the last `residual` was."""
        count, d = len(index), self.dimension
        out, nodes = self.buffers.get("held.force", count, d), self.buffers.upload("held.nodes", index)
        offsets, corners = self._topology.offsets, self._topology.corners
        launch(work_kernels.node_forces, nodes, offsets, corners, self._local, out, count, d)
        force = download(out, count).astype(np.float64)
        return force + self._slip.forces(x)[index] if self._slip else force

    def work(self, x: Any) -> StepWork:
        """Work of each term at ``x``, where the last `residual` was; no `product` may come between."""
        result = np.zeros(work_kernels.WORKS + self.dimension)
        launch(
            work_kernels.step_work,
            *self._topology,
            self._record,
            self._source,
            self._local,
            self._wall,
            x,
            self.buffers.partials("work", len(result)),
            result,
            self.scheme.cf,
            self.scheme.dt,
            self.elements,
            self.nodes,
            self.dimension,
        )
        viscous_dissipation, viscous, geometry, stabilisation, source, walls, *force = result.tolist()
        terms = viscous, geometry, stabilisation, source, walls, *self._rows.friction(self.split(x)[0])
        work = StepWork(viscous_dissipation, *terms, np.array(force))
        return self._slip.work(x, self.particles.wall).added_to(work) if self._slip else work

    def product(self, v: Any, out: Any) -> None:
        """out = K v, the derivative of the scaled residual at the last `linearise` along ``v``."""
        self.system.product(v, out)

    def precondition(self, r: Any, z: Any) -> None:
        """z ~ K^-1 r, see `LinearSystem`."""
        self.system.precondition(r, z)

    def correct(self, x: Any, tolerance: float) -> fgmres.KrylovResult:
        """Solve K dx = -r, linearised at the last `residual`, by preconditioned FGMRES and add dx to ``x``.

        Where ``tolerance`` is no tighter than the change of K since the last correction, K is not gathered again.
        The displacements of dx are damped, see `_add`.

        Raises:
            StepRefused: the iterations reached their limit before the tolerance.
        """
        if tolerance < KEEPS_JACOBIAN or not self._linearised:
            self.linearise()
        with timer("krylov"):
            result = fgmres.fgmres(
                self.product,
                self.precondition,
                self._r,
                self._dx,
                self.size,
                tolerance=tolerance,
                max_iterations=MAX_KRYLOV_ITERATIONS,
                buffers=self.buffers,
                iteration=self.system.iteration,
            )
        if not result.converged:
            raise StepRefused(
                f"the linear system was not solved in {result.iterations} iterations: its residual is "
                f"{result.relative_residual:.1e} of the first, the tolerance {tolerance:.1e}"
            )
        self._add(x)
        return result

    def _add(self, x: Any) -> None:
        """Subtract the solution of the linear problem from ``x``; of its displacements as much as elements bear.

        The equations are nearly linear in the pressures, but not in the displacements, for pressure acts on elements
        that they deform. Two things make displacements useless. If the first residual is above `GUESSED`, the pressures
        of light elements, whose particles changed in the last remeshing, were a bad guess, and so is the Jacobian:
        then only the pressures are corrected. If an element would be inverted, or nearly, the displacements are halved
        until J is above `DAMPED`, or half of what it was: there is no way back from iterates with J < 0, although the
        residual often falls on the way there.
        """
        first, self._corrected = not self._corrected, True
        part = 0.0 if first and self._norm > GUESSED else 1.0
        self._add_part(x, -part, -1.0)
        if part == 0.0:
            return
        bound = min(DAMPED, 0.5 * self._smallest)
        self._smallest = self.limits(x).smallest_jacobian
        while self._smallest < bound and part > SMALLEST_PART:
            part *= 0.5
            self._add_part(x, part, 0.0)
            self._smallest = self.limits(x).smallest_jacobian

    def _add_part(self, x: Any, motion_factor: float, pressure_factor: float) -> None:
        size, work = self.size, (self.size, vector_kernels.ENTRY)
        factors, self._limits = (motion_factor, pressure_factor), None
        launch(step_limits.add_correction, self._dx, x, *factors, self.nodes, size, self.dimension, work=work)

    def limits(self, x: Any) -> StepLimits:
        """Smallest J_{n+1} and largest displacement of ``x``, relative to the tank's motion."""
        result = np.array([1e30, 0.0, 0.0])
        launch(
            step_limits.step_limits,
            self._topology[0],
            self._motion,
            self.mesh.period.array,
            self._target,
            x,
            self.buffers.partials("limits", 3),
            result,
            self.elements,
            self.nodes,
            self.dimension,
            work=(self.elements, step_limits.ELEMENT),
        )
        if self.walls.tank_moves:
            square = (self.walls.relative(self.split(x)[0]) ** 2).sum(axis=1)
            result[1] = (square / self.particles.target**2).max()
        self._limits = StepLimits(float(result[0]), float(np.sqrt(result[1])), result[2] == 0)
        return self._limits

    def last_limits(self, x: Any) -> StepLimits:
        """`limits` of the unknowns ``x`` of the last `vector` or `correct`, computed only if they are not known."""
        return self._limits or self.limits(x)


MAX_KRYLOV_ITERATIONS = 80
LEAST_TIME, MOST_TIME = 0.5, 100.0  # T in the stabilisation's tau, in steps; see `tipfem.step.solve.flow_time`
GUESSED = 0.3  # first residual above which pressures are corrected before displacements [spacings]
DAMPED = 0.2  # J that a correction leaves to every element
SMALLEST_PART = 1e-3  # of the displacements of a correction
KEEPS_JACOBIAN = 3e-2  # linear tolerance above which an iteration reuses the last Jacobian
