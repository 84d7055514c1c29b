"""LinearSystem: the linear problem of a Newton iteration, K dx = -r, with its preconditioner."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from scipy import sparse

from tipfem.backend.arrays import Buffers, download
from tipfem.backend.launch import launch
from tipfem.backend.runtime import require_short_loops
from tipfem.case.period import Period
from tipfem.fem import jacobian, schur
from tipfem.fem.time_integration import TimeScheme
from tipfem.linalg import sparsity
from tipfem.linalg.fgmres import Iteration
from tipfem.linalg.multigrid.deflation import SubdomainDeflation
from tipfem.linalg.multigrid.multigrid import BackgroundMultigrid
from tipfem.linalg.sparsity import Csr
from tipfem.mesh.mesh import Mesh
from tipfem.step import block_preconditioner, fused_iteration
from tipfem.step.interface_ties import InterfaceTies
from tipfem.step.slip_rows import SlipRows
from tipfem.typing import Array

# Spacing of the finest background grid in particle spacings. Finer grids need as many iterations, and below 1.2 more:
# edges then span more grid cells than the stencil.
GRID_SPACING = 2.0
# The Schur complement is 0.54 to 0.99 of the Laplacian with the time integration's cm (stabilisation 0.25). A factor
# near the middle of that range saves a twentieth of the Krylov iterations.
SCHUR_SCALE = 1.3


class BodyCoupling(Protocol):
    """The interface of the preconditioner to bodies that float; see `tipfem.step.body_rows.BodyRows`."""

    arrays: tuple[Any, Any]

    def add_rotations(self, v: Any, out: Any) -> None:
        """Add to out = K v what rotations change in it beyond displacements."""

    def product(self, v: Any, out: Any) -> None:
        """Put the bodies' rows in place of their particles' in out = K v."""

    def begin(self, r: Any) -> None:
        """Give the bodies' particles in a residual the increments that the bodies' own matrices give."""

    def clear(self, r: Any) -> None:
        """Undo `begin`."""

    def correct_pressure(self, vectors: Any) -> None:
        """Correct the multigrid's solution for the mobility of the bodies."""

    def end(self, z: Any) -> None:
        """Set the bodies' increments in a correction, and displace their particles by them."""


class WallCoupling(Protocol):
    """The interface of the linear system to walls that slip; see `tipfem.walls.constraints.WallRows`."""

    arrays: tuple[Any, Any]

    def add_to(self, matrix: Csr) -> None:
        """Add the derivative of friction at the last residual to a Jacobian's rows, and project them."""

    def product(self, v: Any, out: Any) -> None:
        """Add the same to the product of the elements' Jacobian with ``v``, and project it."""

    def project_rows(self, out: Any) -> None:
        """Project the momentum rows of a vector."""

    def project(self, z: Any) -> None:
        """Project the displacements of a correction."""


class Topology(NamedTuple):
    """Device arrays: cells (M, d + 1), and in CSR the cells of each particle (see `sparsity.list_corners`)."""

    cells: Any
    offsets: Any
    corners: Any


def covering_box(position: Array, spacing: float, last: Array | None = None, period: Period | None = None) -> Array:
    """Lowest and highest coordinates (2, d) that the multigrid's grids cover [m].

    Args:
        position: (N, d) of the particles, in the frame of the grids [m].
        spacing: of the particles [m].
        last: (2, d) the box of the step before; it is kept until the particles leave it or half of it. NaN for none.
        period: of the positions, all of which the box covers; none by default.
    """
    # NumPy takes many times as long for all axes at once.
    lower, upper = (np.array([find(x) for x in position.T]) for find in (np.min, np.max))
    if period:
        lower, upper = np.where(period.width > 0, 0.0, lower), np.where(period.width > 0, period.width, upper)
    if last is not None and np.isfinite(last).all():
        old_lower, old_upper = last
        slack = 1e-6 * spacing  # round-off of a tank that moves
        inside = (lower > old_lower - slack).all() and (upper < old_upper + slack).all()
        if inside and np.prod(upper - lower) > 0.5 * np.prod(old_upper - old_lower):
            return last
        # Walls that have moved are likely to go on: leave room on the sides they have passed.
        lower = np.where(lower < old_lower - slack, lower - 4 * spacing, lower)
        upper = np.where(upper > old_upper + slack, upper + 4 * spacing, upper)
    return np.stack([lower, upper])


class Workspace:
    """Device arrays and grids that time steps share. Results do not depend on those of earlier steps.

    Args:
        particles: about how many there are, see `BackgroundMultigrid`. It must be the same through a run, or the
            run would not go on from a checkpoint to the bit.

    Attributes:
        buffers: the device arrays by name.
    """

    def __init__(self, particles: int | None = None) -> None:
        self.buffers = Buffers()
        self._particles = particles
        self._multigrid: BackgroundMultigrid | None = None
        self._box: Array = np.zeros((2, 0))

    def multigrid(self, box: Array, spacing: float, *, periodic: Sequence[int] = ()) -> BackgroundMultigrid:
        """The hierarchy over a box (2, d) [m], with ``periodic`` axes, for particles of a ``spacing`` [m].

        It is that of the last step if the box is the same. One workspace serves particles of one spacing.
        """
        if self._multigrid is None or not np.array_equal(self._box, box):
            lower, upper = box
            self._multigrid = BackgroundMultigrid(
                lower, upper, GRID_SPACING * spacing, self.buffers, self._particles, periodic=periodic
            )
            self._box = box
        return self._multigrid

    def topology(self, mesh: Mesh) -> Topology:
        """The mesh's cells, and the cells of each particle."""
        nodes, (elements, width) = len(mesh.position), mesh.cells.shape
        require_short_loops(elements)
        cells = self.buffers.upload("cells", mesh.cells)
        offsets, cursor = (self.buffers.get(name, nodes + 1, integer=True) for name in ("offsets", "cursor"))
        corners = self.buffers.get("corners", elements * width, integer=True)
        launch(sparsity.list_corners, cells, offsets, cursor, corners, elements, nodes, width)
        return Topology(cells, offsets, corners)


class LinearSystem:
    """The Jacobian K of a step in rows, and its block preconditioner with a multigrid cycle.

    Args:
        topology: of the mesh.
        mesh: M simplices on N particles.
        position: (N, d) device array [m].
        material: device arrays (M,) of the elements' density [kg/m^3], viscosity [Pa s], and part of the mass matrix
            that is lumped, see `tipfem.fem.mass`.
        extremes: lowest and highest of the densities.
        held: device array (N, 2), see `schur.scale_and_laplacian`: whether displacement and pressure are prescribed.
        scale: device array (N (d + 1),) that takes the rows' scales, see `schur.scale_and_laplacian`.
        scheme: time integration, with the step's length.
        multigrid: over a box around ``frame``.
        frame: (N, d) positions of the particles in the frame of the grid [m].
        spacing: of the particles [m].
        buffers: device arrays by name, reused from step to step.
        ties: between particles and their copies where the mesh is cut along interfaces; None where it is not.
        surface: the particles (K,) on the free surface, and how their displacements change the volume (K, d); None
            without.
        floor: what the floor of the stabilisation's tau adds to it [s^2], see `tipfem.step.flow`.
        slip: equations of liquids that slide along each other; None where none do.

    Attributes:
        stores_rows: whether the Jacobian is kept in rows.
        multigrid: as given, with the pressure's operators of this step.
        walls: those that slip; to be set when the system has been made.
        bodies: bodies that float, None without any; to be set when the system has been made.
        deflation: the piecewise-constant coarse space.
        rows: the Jacobian K on the device, blocks as in `tipfem.fem.jacobian`; set by `gather`.
        pressure_laplacian: the approximate Schur complement on the device.
    """

    stores_rows = True
    walls: WallCoupling
    bodies: BodyCoupling | None

    def __init__(
        self,
        topology: Topology,
        mesh: Mesh,
        position: Any,
        material: tuple[Any, Any, Any],
        extremes: tuple[float, float],
        held: Any,
        scale: Any,
        scheme: TimeScheme,
        multigrid: BackgroundMultigrid,
        frame: Array,
        spacing: float,
        buffers: Buffers,
        ties: InterfaceTies | None = None,
        surface: tuple[Array, Array] | None = None,
        floor: float = 0.0,
        slip: SlipRows | None = None,
    ) -> None:
        self._ties, self._slip, self.bodies = ties, slip, None
        self._no_bodies = buffers.get("no_bodies.lists", 1, integer=True), buffers.get("no_bodies.data", 1)
        self._topology, self._scale, self._scheme = topology, scale, scheme
        self._density, _, self._lumping = material
        self._nodes, self._elements, self._dimension = len(mesh.position), len(mesh.cells), mesh.dimension
        self._buffers = buffers
        n, d = self._nodes, self._dimension
        # Each corner names at most d neighbours.
        padded = buffers.get("padded_columns", mesh.cells.size * d + n, integer=True)
        row_offsets = buffers.get("row_offsets", n + 1, integer=True)
        self._slots = buffers.get("slots", mesh.cells.size * d, integer=True)
        arrays = (*topology, padded, row_offsets, self._slots)
        launch(sparsity.find_neighbours, *arrays, n, d, work=(n, sparsity.NEIGHBOURS))
        count = launch(sparsity.running_sums, row_offsets, n)
        columns = buffers.get("columns", count, integer=True)
        self.pressure_laplacian = Csr(row_offsets, columns, buffers.get("laplacian", count))
        launch(
            schur.scale_and_laplacian,
            *topology,
            position,
            mesh.period.array,
            *material[:2],
            held,
            padded,
            self._slots,
            *self.pressure_laplacian,
            scale,
            scheme.cm,
            scheme.cv,
            SCHUR_SCALE,
            floor,
            spacing,
            n,
            d,
            work=(n, schur.LAPLACIAN_ROW),
        )
        if slip and self.stores_rows:
            row_offsets, columns, count = slip.merged(*self.pressure_laplacian, n)
        self.rows = Csr(row_offsets, columns, buffers.get("blocks", count * (d + 1) ** 2 if self.stores_rows else 0))
        label = None
        if surface is not None and len(surface[0]):
            launch(
                schur.add_grounds,
                buffers.upload("surface", surface[0].astype(np.int32)),
                buffers.upload("surface.gradient", surface[1]),
                scale,
                row_offsets,
                self.pressure_laplacian.values,
                SCHUR_SCALE,
                len(surface[0]),
                d,
                work=(len(surface[0]), schur.GROUND),
            )
        if ties:
            ties.join_scales(scale)
            if slip:
                slip.add_to_diagonal()
                ties.spread(scale)
            self.pressure_laplacian, label = ties.joined(self.pressure_laplacian, scale)
        self.multigrid = multigrid
        if frame is not mesh.position:
            position = buffers.upload("frame", frame)
        multigrid.build(position, self.pressure_laplacian, n, ties.groups if ties else None)
        shape = (len(mesh.cells), n, d + 1)
        self.deflation = SubdomainDeflation(
            topology.cells,
            material[0],
            extremes,
            shape,
            self.pressure_laplacian,
            multigrid.vectors,
            buffers,
            label,
            position=frame,
        )

    def gather(self, record: Any) -> None:
        """Sum the elements' linearisation of the last residual, (M, w) on the device, into the rows of K."""
        s = self._scheme
        launch(
            jacobian.gather_rows,
            *self._topology,
            self._density,
            self._lumping,
            record,
            self._scale,
            self.rows.row_offsets,
            self._slots,
            self.rows.values,
            s.cm,
            s.cv,
            s.cf,
            self._nodes,
            self._dimension,
        )
        if self._slip:
            self._slip.add_to(self.rows)
        self.walls.add_to(self.rows)

    def product(self, v: Any, out: Any) -> None:
        """out = K v, the derivative of the scaled residual along ``v``; both (N (d + 1),) on the device."""
        launch(
            jacobian.multiply,
            *self.rows,
            v,
            out,
            self._nodes,
            self._dimension,
            work=(self._nodes, jacobian.ROW),
        )
        self._complete(v, out)
        if self.bodies:
            self.walls.project_rows(out)
            self.bodies.product(v, out)

    def _complete(self, v: Any, out: Any) -> None:
        """Add to the product of the elements what rotations of bodies change, and join the rows of tied particles."""
        if self.bodies:
            self.bodies.add_rotations(v, out)
        if self._ties:
            self._ties.collect(out)

    def precondition(self, r: Any, z: Any) -> None:
        """z = M r ~ K^-1 r by the block factors of K with diag(A) and one V-cycle for the Schur complement.

        See `tipfem.step.block_preconditioner`; r and z are (N (d + 1),) on the device.
        """
        n, d, grid = self._nodes, self._dimension, self.multigrid
        if self.bodies:
            self.bodies.begin(r)
        if self._ties:
            self._ties.spread(r)
        launch(block_preconditioner.schur_rhs, *self.rows, self._scale, r, grid.vectors, n, d)
        if self._ties:
            self._ties.clear(r)
        if self.bodies:
            self.bodies.clear(r)
        self._solve_pressure()
        launch(block_preconditioner.correct, *self.rows, grid.vectors, r, z, n, d)
        if self._ties:
            self._ties.collect(z)
        self._constrain(z)

    def _constrain(self, z: Any) -> None:
        """Let the displacements of a correction follow walls and bodies, and those of copies their particles."""
        self.walls.project(z)
        if self.bodies:
            self.bodies.end(z)
        if self._ties:
            self._ties.spread(z)

    def _solve_pressure(self) -> None:
        """One cycle for the Schur complement, from the right-hand side to the solution in the grid's vectors."""
        self.solve_pressure_without_bodies()
        if self.bodies:
            self.bodies.correct_pressure(self.multigrid.vectors)

    def solve_pressure_without_bodies(self) -> None:
        """One cycle for the pressure Laplacian, from the right-hand side to the solution in the grid's vectors."""
        self.multigrid.cycle()
        self.deflation.correct()

    @property
    def fused(self) -> bool:
        """Whether an iteration is one launch."""
        return self.multigrid.fused

    @property
    def iteration(self) -> Iteration | None:
        """An iteration of Krylov's method in one launch, where that is possible."""
        return self._iterate if self.fused else None

    def _iterate(self, k: int, krylov: Any, partial: Any, cancelled: float) -> None:
        n = self._nodes
        launch(
            fused_iteration.iterate,
            *self._operators(),
            krylov,
            partial,
            k,
            n,
            cancelled,
            self._dimension,
            self.bodies is not None,
            work=(n, fused_iteration.ITERATION),
        )

    def _operators(self) -> tuple[Any, ...]:
        """Device arrays of the Jacobian and of the preconditioner, in the order of `fused_iteration`."""
        grid = self.multigrid
        return (
            *self.rows,
            self._scale,
            *self.pressure_laplacian,
            grid.vectors,
            grid.coordinates,
            grid.cell_lists,
            grid.levels,
            grid.grid,
            self.deflation.subdomains,
            grid.ties,
            *self.walls.arrays,
            *(self.bodies.arrays if self.bodies else self._no_bodies),
        )

    def matrix(self) -> sparse.csr_matrix:
        """K, scaled, as a SciPy matrix in CSR; unknowns interleaved as in vectors, rows of fixed unknowns empty."""
        d, width = self._dimension, self._dimension + 1
        row_offsets, columns, values = self._host(self.rows, width**2)
        uu, up, pu, pp = np.split(values, len(columns) * np.array([d * d, d * width, d * (width + 1)]))
        blocks = np.empty((len(columns), width, width))
        blocks[:, :d, :d], blocks[:, :d, d] = uu.reshape(-1, d, d), up.reshape(-1, d)
        blocks[:, d, :d], blocks[:, d, d] = pu.reshape(-1, d), pp
        return sparse.bsr_matrix((blocks, columns, row_offsets)).tocsr()

    def laplacian(self) -> sparse.csr_matrix:
        """The pressure Laplacian of the preconditioner as a SciPy matrix in CSR."""
        row_offsets, columns, values = self._host(self.pressure_laplacian)
        return sparse.csr_matrix((values, columns, row_offsets))

    def _host(self, matrix: Csr, block: int = 1) -> tuple[Array, Array, Array]:
        """Row offsets, columns and values of a matrix with ``block`` values for each column."""
        row_offsets = download(matrix.row_offsets, self._nodes + 1)
        count = int(row_offsets[-1])
        return row_offsets, download(matrix.columns, count), download(matrix.values, block * count).astype(float)
