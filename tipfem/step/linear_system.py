"""LinearSystem: the linear problem of a Newton iteration, K dx = -r, with its preconditioner."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy import sparse

from tipfem.backend.arrays import Buffers, download
from tipfem.backend.launch import launch
from tipfem.fem import jacobian, schur
from tipfem.fem.time_integration import GeneralizedAlpha
from tipfem.linalg import sparsity
from tipfem.linalg.fgmres import Iteration
from tipfem.linalg.multigrid.deflation import Bubbles
from tipfem.linalg.multigrid.multigrid import COARSEST_SWEEPS, BackgroundMultigrid
from tipfem.mesh.mesh import Mesh
from tipfem.step import fused_iteration
from tipfem.typing import Array

# Spacing of the finest background grid in particle spacings. Finer ones need as many iterations, from 1.2 on more:
# edges then reach over more cells than the stencil does.
GRID_SPACING = 2.0
# The Schur complement is 0.54 to 0.99 of the Laplacian with the time integration's cm (stabilisation 0.25): near the
# middle of that, a twentieth of the Krylov iterations is saved.
SCHUR_SCALE = 1.3
ROW = 30.0  # nanoseconds that a thread takes to multiply a particle's rows
ITERATION = 400.0  # for all that an iteration of Krylov's method does for a particle
SEARCH = 80.0  # to find a particle's neighbours, and for its row of the Laplacian


class Topology(NamedTuple):
    """Device arrays: cells (M, d + 1), and in CSR the cells that each particle is in (see `tipfem.linalg.sparsity`)."""

    cells: Any
    offsets: Any
    corners: Any


class Workspace:
    """What outlives a time step: device arrays, and the multigrid's hierarchy."""

    def __init__(self) -> None:
        self.buffers = Buffers()
        self._multigrid: BackgroundMultigrid | None = None
        self._box: Any = None

    def multigrid(self, position: Array, spacing: float) -> BackgroundMultigrid:
        """The hierarchy over a box around ``position`` (N, d), made anew when they leave it or half of it."""
        # NumPy takes many times as long for all axes at once.
        lower, upper = (np.array([find(x) for x in position.T]) for find in (np.min, np.max))
        if self._multigrid is not None:
            old_lower, old_upper = self._box
            slack = 1e-6 * spacing  # round-off of a tank that moves
            inside = (lower > old_lower - slack).all() and (upper < old_upper + slack).all()
            if inside and np.prod(upper - lower) > 0.5 * np.prod(old_upper - old_lower):
                return self._multigrid
            # Walls that have moved go on: leave them some room on the sides they have passed.
            lower = np.where(lower < old_lower - slack, lower - 4 * spacing, lower)
            upper = np.where(upper > old_upper + slack, upper + 4 * spacing, upper)
        self._multigrid = BackgroundMultigrid(lower, upper, GRID_SPACING * spacing, self.buffers)
        self._box = (lower, upper)
        return self._multigrid

    def topology(self, mesh: Mesh) -> Topology:
        """The mesh's cells, and the cells of each particle."""
        nodes, (elements, width) = len(mesh.position), mesh.cells.shape
        cells = self.buffers.upload("cells", mesh.cells)
        offsets, cursor = (self.buffers.get(name, nodes + 1, integer=True) for name in ("offsets", "cursor"))
        corners = self.buffers.get("corners", elements * width, integer=True)
        launch(sparsity.list_uses, cells, offsets, cursor, corners, elements, nodes, width)
        return Topology(cells, offsets, corners)


class LinearSystem:
    """The Jacobian in rows, and block factors of it with a multigrid cycle as its preconditioner.

    Args:
        topology: of the mesh.
        mesh: M simplices on N particles.
        position: (N, d) device array [m].
        material: device arrays of the elements' density [kg/m^3] and viscosity [Pa s], (M,) both.
        extremes: lowest and highest of the densities.
        held: device arrays of where displacements are fixed and where pressures are pinned, (N,) both.
        scale: device array (N (d + 1),) that takes the rows' scales, see `schur.scale_and_laplacian`.
        scheme: generalized-alpha with the step's length.
        multigrid: over a box around ``frame``.
        frame: (N, d) where the particles are in the frame of the grid [m].
        spacing: of the particles [m].
        buffers: what is used again from step to step.

    Attributes:
        stores_rows: whether the Jacobian is kept in rows.
    """

    stores_rows = True

    def __init__(
        self,
        topology: Topology,
        mesh: Mesh,
        position: Any,
        material: tuple[Any, Any],
        extremes: tuple[float, float],
        held: tuple[Any, Any],
        scale: Any,
        scheme: GeneralizedAlpha,
        multigrid: BackgroundMultigrid,
        frame: Array,
        spacing: float,
        buffers: Buffers,
    ) -> None:
        self._topology, self._density, self._scale, self._scheme = topology, material[0], scale, scheme
        self._nodes, self._elements, self._dimension = len(mesh.position), len(mesh.cells), mesh.dimension
        self._buffers = buffers
        n, d = self._nodes, self._dimension
        # Each corner names at most d neighbours.
        wide = buffers.get("wide", mesh.cells.size * d + n, integer=True)
        self._row_offsets = buffers.get("row_offsets", n + 1, integer=True)
        self._places = buffers.get("places", mesh.cells.size * d, integer=True)
        search = (n, SEARCH)
        launch(sparsity.find_neighbours, *topology, wide, self._row_offsets, self._places, n, d, work=search)
        cursor = buffers.get("cursor", n + 1, integer=True)
        count = launch(sparsity.accumulate, self._row_offsets, cursor, n)
        self._columns = buffers.get("columns", count, integer=True)
        entries = count if self.stores_rows else 0
        widths = {"uu": d * d, "up": d, "pu": d, "pp": 1}
        self._blocks = tuple(buffers.get(f"rows.{name}", entries * width) for name, width in widths.items())
        self._schur_b, self._schur_x = buffers.get("schur_b", n), buffers.get("schur_x", n)
        self._laplacian = values = buffers.get("laplacian", count)
        launch(
            schur.scale_and_laplacian,
            *topology,
            position,
            *material,
            *held,
            wide,
            self._places,
            self._row_offsets,
            self._columns,
            values,
            scale,
            scheme.cm,
            scheme.cv,
            SCHUR_SCALE,
            spacing,
            n,
            d,
            work=search,
        )
        self.multigrid = multigrid
        if frame is not mesh.position:
            position = buffers.upload("frame", frame)
        multigrid.build(position, self._row_offsets, self._columns, values, n)
        self._bubbles = Bubbles(
            topology.cells,
            material[0],
            extremes,
            (len(mesh.cells), n, d + 1),
            (self._row_offsets, self._columns, values),
            buffers,
        )

    def gather(self, record: Any) -> None:
        """Take over the elements' linearisation of the last residual."""
        s = self._scheme
        launch(
            jacobian.gather_rows,
            *self._topology,
            self._density,
            record,
            self._scale,
            self._row_offsets,
            self._places,
            *self._blocks,
            s.cm,
            s.cv,
            s.cf,
            self._nodes,
            self._dimension,
        )

    def product(self, v: Any, out: Any) -> None:
        """out = K v, the derivative of the scaled residual along ``v``."""
        launch(
            jacobian.multiply,
            self._row_offsets,
            self._columns,
            *self._blocks,
            v,
            out,
            self._nodes,
            self._dimension,
            work=(self._nodes, ROW),
        )

    def precondition(self, r: Any, z: Any) -> None:
        """z ~ K^-1 r by the block factors of K with diag(A) and one V-cycle for the Schur complement.

        z_u = A^-1 r_u;  z_p = S^-1 (r_p - D z_u);  z_u += A^-1 G z_p. Scaled by 1 / diag(A), the momentum rows of r
        are A^-1 r_u already.
        """
        if self.multigrid.together:
            self._iterate(0, r, z, z, self._schur_b, self._schur_b, 0.0, False, whole=False)
            return
        _uu, up, pu, _pp = self._blocks
        launch(
            jacobian.schur_right_side,
            self._row_offsets,
            self._columns,
            pu,
            self._scale,
            r,
            self._schur_b,
            self._nodes,
            self._dimension,
        )
        self.multigrid.apply(self._schur_b, self._schur_x)
        self._bubbles.lift(self._schur_b, self._schur_x)
        launch(
            jacobian.pressure_correction,
            self._row_offsets,
            self._columns,
            up,
            r,
            self._schur_x,
            z,
            self._nodes,
            self._dimension,
        )

    @property
    def iteration(self) -> Iteration | None:
        """An iteration of Krylov's method in one launch, where that is possible."""
        return self._iterate if self.multigrid.together else None

    def _iterate(
        self,
        k: int,
        basis: Any,
        directions: Any,
        w: Any,
        partial: Any,
        out: Any,
        cancelled: float,
        again: bool,
        whole: bool = True,
    ) -> None:
        grid, bubbles = self.multigrid, self._bubbles
        launch(
            fused_iteration.iterate,
            self._row_offsets,
            self._columns,
            *self._blocks,
            self._scale,
            self._schur_b,
            self._schur_x,
            *grid.mesh_arrays,
            self._laplacian,
            *grid.grids,
            *bubbles.arrays,
            basis,
            directions,
            w,
            partial,
            out,
            k,
            self._nodes,
            grid.levels,
            COARSEST_SWEEPS,
            bubbles.count,
            cancelled,
            again,
            whole,
            self._dimension,
            work=(self._nodes, ITERATION),
        )

    def matrix(self) -> Any:
        """K, scaled, as a SciPy matrix in CSR; unknowns interleaved as in vectors, rows of what is held empty."""
        d, (rows, columns, count) = self._dimension, self._rows()
        widths = (d * d, d, d, 1)
        uu, up, pu, pp = (download(b, count * w).astype(float) for b, w in zip(self._blocks, widths, strict=True))
        blocks = np.empty((count, d + 1, d + 1))
        blocks[:, :d, :d], blocks[:, :d, d] = uu.reshape(-1, d, d), up.reshape(-1, d)
        blocks[:, d, :d], blocks[:, d, d] = pu.reshape(-1, d), pp
        return sparse.bsr_matrix((blocks, columns, rows)).tocsr()

    def laplacian(self) -> Any:
        """The pressure Laplacian of the preconditioner as a SciPy matrix in CSR."""
        rows, columns, count = self._rows()
        values = download(self._laplacian, count).astype(float)
        return sparse.csr_matrix((values, columns, rows))

    def _rows(self) -> tuple[Array, Array, int]:
        rows = download(self._row_offsets, self._nodes + 1)
        return rows, download(self._columns, int(rows[-1])), int(rows[-1])
