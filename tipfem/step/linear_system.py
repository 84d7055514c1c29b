"""LinearSystem: the linear problem of a Newton iteration, K dx = -r, with its preconditioner."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from tipfem.backend.arrays import Buffers, download
from tipfem.backend.launch import launch
from tipfem.backend.runtime import on_gpu, require_short_loops
from tipfem.case.case import Case
from tipfem.fem import jacobian, matrix_free, schur
from tipfem.fem.bundles import Topology
from tipfem.fem.condensation import Condensation, Follows
from tipfem.geometry.period import Period
from tipfem.linalg import sparsity, vector_kernels
from tipfem.linalg.fgmres import Iterations, KrylovResult, fgmres
from tipfem.linalg.multigrid.deflation import SubdomainDeflation
from tipfem.linalg.multigrid.multigrid import BackgroundMultigrid
from tipfem.linalg.queued_fgmres import QueuedSolve
from tipfem.linalg.sparsity import Csr
from tipfem.mesh.mesh import Mesh
from tipfem.physics.term import Equations, Term
from tipfem.step import block_preconditioner, fused_iteration, momentum_polynomial, pressure_system, staged_iteration
from tipfem.typing import Array

# Spacing of the finest background grid in particle spacings. Finer grids need as many iterations, and below 1.2 more:
# edges then span more grid cells than the stencil. In 3-D, where a stencil has 125 entries, a larger one serves a
# single fluid as well in less time; several take a quarter more iterations. Where a grading leaves fewer than `FEW`
# particles a grid cell, cells are larger, but no more than so many times: a few more iterations take less time than the
# grid does.
GRID_SPACING, ONE_IN_SPACE, FEW, LARGER = 2.0, 3.0, 2.5, 2.0
# The square of the part of a spacing by which viscosity moves momentum in a step, below which a system may be reduced
# to the pressures, and its preconditioner leaves viscosity out.
LITTLE_VISCOUS = 1e-2


def grid_spacing(case: Case) -> float:
    """Spacing of the finest background grid of a case [particle spacings]."""
    x = case.particles.position
    d = x.shape[1]
    least = ONE_IN_SPACE if d == 3 and len(case.fluids) == 1 else GRID_SPACING
    if case.grading is None:
        return least
    apart = cKDTree(x).query(x, 2)[0][:, 1] / case.particles.spacing
    return float(least * np.clip((FEW * np.mean(apart**d)) ** (1 / d) / least, 1.0, LARGER))


def covering_box(position: Array, spacing: float, last: Array | None = None, period: Period | None = None) -> Array:
    """Lowest and highest coordinates (2, d) that the multigrid's grids cover [m].

    Args:
        position: (N, d) of the particles, in the frame of the grids [m].
        last: (2, d) the box of the step before; it is kept until the particles leave it or half of it. NaN for none.
        period: of the positions, all of which the box covers; none by default.
    """
    # NumPy takes many times as long for all axes at once.
    lower, upper = np.array([x.min() for x in position.T]), np.array([x.max() for x in position.T])
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
        spacing: of the finest grid [particle spacings], see `grid_spacing`.

    Attributes:
        buffers: the device arrays by name.
    """

    def __init__(self, particles: int | None = None, spacing: float = GRID_SPACING) -> None:
        self.buffers = Buffers()
        self._particles, self._spacing = particles, spacing
        self._multigrid: BackgroundMultigrid | None = None
        self._box: Array = np.zeros((2, 0))

    def multigrid(self, box: Array, spacing: float, *, periodic: Sequence[int] = ()) -> BackgroundMultigrid:
        """The hierarchy over a box (2, d) [m], with ``periodic`` axes, for particles of a ``spacing`` [m].

        It is that of the last step if the box is the same. One workspace serves particles of one spacing.
        """
        if self._multigrid is None or not np.array_equal(self._box, box):
            lower, upper = box
            self._multigrid = BackgroundMultigrid(
                lower, upper, self._spacing * spacing, self.buffers, self._particles, periodic=periodic
            )
            self._box = box
        return self._multigrid

    def topology(self, mesh: Mesh) -> Topology:
        """The mesh's cells, and arrays for those of each particle, which `LinearSystem` lists."""
        nodes = len(mesh.position)
        require_short_loops(len(mesh.cells))
        cells = self.buffers.upload("cells", mesh.cells)
        offsets = self.buffers.get("offsets", nodes + 1, integer=True)
        return Topology(cells, offsets, self.buffers.get("corners", mesh.cells.size, integer=True))


class LinearSystem:
    """The condensed Jacobian K of a step, and its block preconditioner with a multigrid cycle.

    K is stored in rows, or its products are computed from the elements' linearisation: then only what terms add to it
    is stored, and the preconditioner obtains products with the blocks D and G from products with K. See D. A. Knoll &
    D. E. Keyes, Jacobian-free Newton-Krylov methods, Journal of Computational Physics 193, 2004; the products here are
    exact, not differences of residuals.

    Args:
        equations: of the step; their rows' scale is set here.
        held: device array (P, 2), see `schur.scale_and_laplacian`: whether displacement and pressure are prescribed.
        multigrid: over a box around ``frame``.
        frame: (P, d) positions of the nodes in the frame of the grid [m].
        floor: what the floor of the stabilisation's tau adds to it [s^2], see `tipfem.step.problem`.
        stores_rows: whether the Jacobian is stored in rows.
        exact: whether it is solved to round-off, see `block_preconditioner.ROUGH_OF_SEVERAL`.

    Attributes:
        stores_rows, multigrid: as given, the latter with the pressure's operators of this step.
        condensation: of displacements that follow others.
        deflation: the piecewise-constant coarse space.
        reducible: whether K may be reduced to the pressures, see `tipfem.step.pressure_system`.
        rows: on the device, blocks as in `tipfem.fem.jacobian`, set by `gather`: the condensed Jacobian K, or, where it
            is not stored, what terms add to it.
        pressure_laplacian: the approximate Schur complement on the device.
    """

    def __init__(
        self,
        equations: Equations,
        terms: Sequence[Term],
        held: Any,
        multigrid: BackgroundMultigrid,
        frame: Array,
        floor: float = 0.0,
        *,
        stores_rows: bool = True,
        exact: bool = False,
    ) -> None:
        self._equations, self._terms, self.stores_rows, self.multigrid = equations, terms, stores_rows, multigrid
        self._buffers = buffers = equations.buffers
        get, mesh, d = buffers.get, equations.nodes, equations.dimension
        self._nodes, self._rows = len(equations.owner), equations.rows
        n = self._nodes
        self._viscous = get("viscous_schur", n)
        self._viscous_nodes = 0 if equations.viscous_number < LITTLE_VISCOUS else n
        self.polynomial = momentum_polynomial.polynomial(equations.viscous_number)
        self._weights = get("momentum.weights", self._rows * d)
        self.condensation = self._condensation()
        added = self._added_columns()
        # All that is copied to a GPU is given before its first kernel starts, see `tipfem.backend.staging`.
        sparsity.list_corners(*equations.topology, mesh.cells.shape, n, buffers)
        # Each corner names at most d neighbours.
        padded = get("padded_columns", mesh.cells.size * d + n, integer=True)
        row_offsets = get("row_offsets", n + 1, integer=True)
        self._slots = get("slots", mesh.cells.size * d, integer=True)
        arrays = (*equations.topology, padded, row_offsets, self._slots)
        launch(sparsity.find_neighbours, *arrays, n, d, work=(n, sparsity.NEIGHBOURS))
        count = sparsity.running_sums(row_offsets, n, buffers, most=sparsity.most_neighbours(n, d))
        columns = get("columns", count, integer=True)
        laplacian = Csr(row_offsets, columns, get("laplacian", count))
        launch(
            schur.scale_and_laplacian,
            equations.topology,
            equations.motion,
            equations.period,
            equations.elements,
            held,
            schur.Pattern(padded, self._slots),
            laplacian,
            schur.Diagonals(equations.scale, self._viscous),
            equations.scheme.factors,
            schur.Factors(schur.SCHUR_SCALE, floor, equations.particles.spacing),
            equations.sizes,
            work=(n, schur.LAPLACIAN_ROW),
        )
        for term in terms:
            term.diagonal()
        for term in terms:
            term.diagonal_done()
        for term in terms:
            laplacian = term.schur_complement(laplacian)
        self.pressure_laplacian = laplacian
        self._relate()  # some relations depend on the scale
        self.rows = self._pattern(row_offsets, columns, count, *added)
        position = equations.motion if frame is mesh.position else buffers.upload("frame", frame)
        multigrid.build(position, laplacian, n, next((t.groups for t in terms if t.groups is not None), None))
        labels = next((value for term in terms if (value := term.labels()) is not None), None)
        density = equations.properties.density
        one_fluid = density.min(initial=np.inf) == density.max(initial=0.0)
        alone = self._rows == n  # without unknowns that have no pressures, as motions
        self._rough_part = 0.0
        if alone and stores_rows and not self.polynomial.degree:
            several = 0.0 if exact else block_preconditioner.ROUGH_OF_SEVERAL
            self._rough_part = block_preconditioner.ROUGH if one_fluid else several
        if one_fluid and d == 3 and not self._rough_part:
            launch(block_preconditioner.add_rough_parts, multigrid.vectors, self._viscous, n)
        if self._rough_part or (one_fluid and d == 3):
            self._viscous_nodes = n
        self.deflation = SubdomainDeflation(
            mesh.cells,
            density,
            (density.min(initial=np.inf), density.max(initial=0.0)),
            (len(mesh.cells), n, d + 1),
            laplacian,
            multigrid.vectors,
            buffers,
            labels,
            position=frame,
        )
        for term in terms:
            term.prepare(self.solve_laplacian, multigrid.vectors)
        self._low_rank = next((term.low_rank for term in terms if term.low_rank is not None), None)
        self.reducible, self._reduced = self._is_reducible(), False
        self._no_low_rank = get("no_low_rank.lists", 1, integer=True), get("no_low_rank.values", 1)

    def _is_reducible(self) -> bool:
        """Whether the displacements can be eliminated by the diagonal of momentum by displacement.

        Not where mass is not lumped, viscosity moves momentum far in a step, or unknowns have no pressure of theirs.
        """
        e = self._equations
        if not (self.stores_rows and self.multigrid.fused and self._rows == self._nodes):
            return False
        return e.properties.lumping is None and e.viscous_number < LITTLE_VISCOUS

    def _relations(self) -> list[Follows]:
        """Present relations of the terms."""
        return [follows for term in self._terms if (follows := term.follows()) is not None]

    def _condensation(self) -> Condensation:
        owner = self._equations.owner
        if self._rows > self._nodes:
            owner = np.concatenate([owner, np.arange(self._nodes, self._rows)])
        self._related = self._relations()
        return Condensation(owner, Follows.together(self._related, self._equations.dimension), self._buffers)

    def _relate(self) -> None:
        """Take in the relations of the terms, where they have changed."""
        before, self._related = self._related, self._relations()
        if len(before) != len(self._related) or any(map(operator.is_not, before, self._related)):
            self.condensation.set(Follows.together(self._related, self._equations.dimension))

    def _added_columns(self) -> tuple[Any, Any, int]:
        """Further couplings in CSR on the device, beside those of the mesh if these are stored, and their number."""
        put, rows = self._buffers.upload, self._rows
        lists = [p for term in self._terms if (p := term.couplings(near=not self.stores_rows)) is not None]
        one, other = (np.concatenate([np.zeros(0, dtype=np.int64), *(pair[k] for pair in lists)]) for k in (0, 1))
        if self.stores_rows:
            starts, added = self.condensation.couplings(one, other, self._equations.nodes.cells)
        else:
            one, added = np.divmod(np.unique(one * rows + other), rows)
            starts = np.zeros(rows + 1, dtype=np.int32)
            np.cumsum(np.bincount(one, minlength=rows), out=starts[1:])
        return put("added.offsets", starts), put("added.columns", added), len(added)

    def _pattern(self, offsets: Any, columns: Any, count: int, *added: Any) -> Csr:
        """The rows of the matrix: those of the mesh, if they are stored, and further couplings."""
        get, n, rows = self._buffers.get, self._nodes, self._rows
        *couplings, number = added
        if not self.stores_rows:
            offsets, count = self._buffers.upload("no_offsets", np.zeros(n + 1, dtype=np.int32)), 0
        if number or not self.stores_rows or rows > n:
            base = offsets, columns, *couplings
            offsets = get("matrix.offsets", rows + 1, integer=True)
            work = (rows, sparsity.MERGED_ROW)
            launch(sparsity.count_merged, *base, offsets, n, rows, work=work)
            count = sparsity.running_sums(offsets, rows, self._buffers, most=count + number)
            columns = get("matrix.columns", count, integer=True)
            launch(sparsity.merge_columns, *base, offsets, columns, n, rows, work=work)
        return Csr(offsets, columns, get("blocks", count * (self._equations.dimension + 1) ** 2))

    def gather(self, *, reduced: bool = False) -> None:
        """Sum the elements' linearisation of the last residual, and what terms add to it, into the rows of K.

        Those of momentum by displacement are left as they are if the system is to be ``reduced`` to the pressures.
        """
        self._reduced = reduced
        e = self._equations
        if self.stores_rows:
            launch(
                jacobian.gather_rows,
                e.topology,
                e.period,
                e.elements,
                e.linear.record,
                e.scale,
                self.rows,
                self._slots,
                e.scheme.factors,
                e.sizes,
                self._rows,
                not reduced,
                work=(self._nodes, jacobian.GATHERED_ROW),
            )
        else:
            launch(jacobian.clear_rows, self.rows.row_offsets, self.rows.values, 0, self._rows, e.dimension)
        for term in self._terms:
            term.gather(self.rows)
        self._relate()
        if self.stores_rows:
            self.condensation.condense(self.rows, full=not reduced)
            for term in self._terms:
                term.gather_own(self.rows)
            if self._rough_part:  # of the first Jacobian of a step, for all of them
                given, work = (self.rows, e.scale, self._viscous), (self._nodes, block_preconditioner.SCHUR_ROW)
                kernel = block_preconditioner.add_rough_parts_of_schur
                launch(kernel, *given, self._rough_part, self._nodes, self._rows, e.dimension, work=work)
                self._rough_part = 0.0
        self._weigh()

    def _weigh(self) -> None:
        """Set the weights of the rows for the polynomial of momentum by displacement, if there is one."""
        rows, d = self._rows, self._equations.dimension
        if self.polynomial.degree and self.stores_rows:
            work = (rows, momentum_polynomial.ROW)
            launch(momentum_polynomial.weigh, self.rows, self._weights, rows, d, work=work)
        elif self.polynomial.degree:
            work = (rows * d, vector_kernels.ENTRY)
            launch(vector_kernels.fill, self._weights, momentum_polynomial.LIKELY, rows * d, work=work)

    def product(self, v: Any, out: Any) -> None:
        """out = K v, the derivative of the scaled residual along ``v``; both (R (d + 1),) on the device."""
        d, rows = self._equations.dimension, self._rows
        if self.stores_rows:
            launch(jacobian.multiply, self.rows, v, out, rows, d, work=(rows, jacobian.ROW))
            return
        full = self._buffers.get("matrix_free.full", self._equations.size)
        launch(matrix_free.copy, v, full, self._equations.size, work=(rows, matrix_free.PARTICLE))
        self.condensation.spread(full)
        self._multiply_elements(full, out)
        launch(jacobian.add_product, self.rows, full, out, rows, d, work=(rows, jacobian.ROW))
        self.condensation.collect(out)

    def _multiply_elements(self, v: Any, out: Any) -> None:
        """The part of a product that the elements give, before it is condensed."""
        e = self._equations
        fields = e.topology, e.elements, e.linear, e.scale, v, out
        launch(matrix_free.jacobian_product, *fields, e.scheme.factors, e.sizes)

    def precondition(self, r: Any, z: Any) -> None:
        """z = M r ~ K^-1 r by the block factors of K with diag(A) and one V-cycle for the Schur complement.

        See `tipfem.step.block_preconditioner`, and, where there is a polynomial, `tipfem.step.momentum_polynomial`;
        r and z are (R (d + 1),) on the device.
        """
        self._precondition_by_diagonal(r, z)
        if not self.polynomial.degree:
            return
        rows, d, size, lowest = self._rows, self._equations.dimension, self._equations.size, self.polynomial.lowest
        now, before, product = (self._buffers.get(f"momentum.{name}", size) for name in ("now", "before", "product"))
        work = (rows, momentum_polynomial.ROW)
        launch(momentum_polynomial.begin, self._weights, z, now, before, rows, lowest, d, work=work)
        for alpha, beta in momentum_polynomial.factors(self.polynomial):
            self.product(now, product)
            vectors = product, self._weights, z, now, before
            launch(momentum_polynomial.advance, *vectors, alpha, beta, rows, d, work=work)
            now, before = before, now
        launch(momentum_polynomial.conclude, now, z, rows, d, work=work)

    def _precondition_by_diagonal(self, r: Any, z: Any) -> None:
        """z = M r with diag(A); with a polynomial, (r_u + G z_p, z_p) with z_p = S^-1 r_p."""
        n, d, vectors = self._nodes, self._equations.dimension, self.multigrid.vectors
        scale, triangular = self._equations.scale, self.polynomial.degree > 0
        if triangular:
            launch(block_preconditioner.continuity_rhs, scale, r, vectors, n, d)
        if self.stores_rows:
            if not triangular:
                launch(block_preconditioner.schur_rhs, self.rows, scale, r, vectors, n, self._rows, d)
            self._solve_pressure()
            launch(block_preconditioner.correct, self.rows, vectors, r, z, n, self._rows, d)
            return
        work = (n, matrix_free.PARTICLE)
        half, product = (self._buffers.get(f"matrix_free.{name}", self._equations.size) for name in ("half", "product"))
        if not triangular:
            launch(matrix_free.copy_displacements, r, half, n, d, work=work)
            self.product(half, product)
            launch(matrix_free.schur_rhs, r, product, scale, vectors, n, d, work=work)
        self._solve_pressure()
        launch(matrix_free.copy_pressures, vectors, half, n, d, work=work)
        self.product(half, product)
        launch(matrix_free.block_correction, r, product, vectors, z, n, d, work=work)

    def _solve_pressure(self) -> None:
        """One cycle for the Schur complement, from the right-hand side to the solution in the grid's vectors."""
        self.solve_laplacian()
        if self._low_rank is not None:
            self._low_rank.correct(self.multigrid.vectors)
        if self._viscous_nodes:
            given = self.multigrid.vectors, self._viscous, self._viscous_nodes
            launch(block_preconditioner.add_viscous_parts, *given, self._nodes)

    def solve_laplacian(self) -> None:
        """One cycle for the pressure Laplacian, from the right-hand side to the solution in the grid's vectors."""
        self.multigrid.cycle()
        self.deflation.correct()

    def solve(self, r: Any, out: Any, tolerance: float, most: int) -> KrylovResult | QueuedSolve:
        """out = K^-1 r by preconditioned FGMRES, with the displacements of followers; a GPU may only have begun.

        Args:
            r: scaled residual (R (d + 1),) on the device.
            out: (R (d + 1),) on the device.
            tolerance: of the residual's norm, relative to that of ``r``, or that of the reduced system.
            most: iterations.
        """
        size = self._equations.size
        if on_gpu() and self.stores_rows and not self.polynomial.degree:
            return QueuedSolve(
                self._iterate_in_stages,
                lambda: self.condensation.spread(out),
                r,
                out,
                size,
                tolerance=tolerance,
                most=most,
                buffers=self._buffers,
                pace=self.multigrid.pace,
            )
        if self._reduced:
            n, work = self._nodes, (self._nodes, pressure_system.ROW)
            right, pressure = (self._buffers.get(f"reduced.{name}", n) for name in ("right", "pressure"))
            launch(pressure_system.reduce, self.rows, r, right, n, self._equations.dimension, work=work)
            result = self._krylov(right, pressure, n, tolerance, most)
            launch(pressure_system.expand, self.rows, pressure, r, out, n, self._equations.dimension, work=work)
        else:
            result = self._krylov(r, out, size, tolerance, most)
        self.condensation.spread(out)
        return result

    def _krylov(self, right: Any, solution: Any, size: int, tolerance: float, most: int) -> KrylovResult:
        return fgmres(
            self.product,
            self.precondition,
            right,
            solution,
            size,
            tolerance=tolerance,
            max_iterations=most,
            buffers=self._buffers,
            iterations=self.iterations,
        )

    @property
    def iterations(self) -> Iterations | None:
        """Iterations of Krylov's method in one launch, where that is possible."""
        return self._iterate if self.multigrid.fused and self.stores_rows else None

    def _iterate(self, k: int, end: int, krylov: Any, partial: Any, state: Array, columns: Array) -> None:
        launch(
            fused_iteration.iterate,
            self.rows,
            self._equations.scale,
            self.pressure_laplacian,
            self.multigrid.arrays,
            self._corrections(),
            fused_iteration.Arnoldi(krylov, partial, state, columns, k, end),
            self._sizes(),
            work=(self._nodes, fused_iteration.ITERATION),
        )

    def _iterate_in_stages(self, k: int, krylov: Any, partial: Any, state: Any) -> None:
        """Iteration k in few launches, see `tipfem.linalg.queued_fgmres`."""
        grid, rows = self.multigrid, self._rows
        systems, sizes = (self.pressure_laplacian, grid.arrays), (self._nodes, rows, self._equations.dimension)
        given = *systems, grid.tied, krylov, state, k, *sizes
        launch(staged_iteration.before_grids, self.rows, self._equations.scale, *given)
        grid.visit_grids(state)
        launch(
            staged_iteration.after_grids,
            self.rows,
            *systems,
            self._corrections(),
            self.deflation.scratch,
            grid.tied,
            staged_iteration.StagedArnoldi(krylov, partial, state, k),
            self._sizes(),
        )

    def _corrections(self) -> fused_iteration.Corrections:
        """Arrays of the corrections after a cycle."""
        low_rank = self._low_rank.arrays if self._low_rank else self._no_low_rank
        motion = self._buffers.get("reduced.motion", 2 * self._rows * self._equations.dimension)
        momentum = self._weights, *self.polynomial
        return fused_iteration.Corrections(self.deflation.subdomains, *low_rank, motion, self._viscous, *momentum)

    def _sizes(self) -> fused_iteration.SystemSizes:
        """Sizes of the system, and which it is."""
        sizes = self._viscous_nodes, self._nodes, self._rows, self._equations.dimension
        return fused_iteration.SystemSizes(*sizes, self._low_rank is not None, self._reduced)

    def matrix(self) -> sparse.csr_matrix:
        """K, scaled, as a SciPy matrix in CSR; unknowns interleaved as in vectors, rows of fixed unknowns empty.

        Raises:
            NotImplementedError: it is not stored.
        """
        if not self.stores_rows:
            raise NotImplementedError("the matrix-free solve stores no rows; Numerics(jacobian='rows') does")
        d, width = self._equations.dimension, self._equations.dimension + 1
        row_offsets, columns, values = self._host(self.rows, self._rows, width**2)
        uu, up, pu, pp = np.split(values, len(columns) * np.array([d * d, d * width, d * (width + 1)]))
        blocks = np.empty((len(columns), width, width))
        blocks[:, :d, :d], blocks[:, :d, d] = uu.reshape(-1, d, d), up.reshape(-1, d)
        blocks[:, d, :d], blocks[:, d, d] = pu.reshape(-1, d), pp
        return sparse.bsr_matrix((blocks, columns, row_offsets)).tocsr()

    def laplacian(self) -> sparse.csr_matrix:
        """The pressure Laplacian of the preconditioner as a SciPy matrix in CSR."""
        row_offsets, columns, values = self._host(self.pressure_laplacian, self._nodes)
        return sparse.csr_matrix((values, columns, row_offsets))

    def _host(self, matrix: Csr, rows: int, block: int = 1) -> tuple[Array, Array, Array]:
        """Row offsets, columns and values of a matrix with ``block`` values for each column."""
        row_offsets = download(matrix.row_offsets, rows + 1)
        count = int(row_offsets[-1])
        return row_offsets, download(matrix.columns, count), download(matrix.values, block * count).astype(float)
