"""MatrixFreeSystem: the linear problem of a Newton iteration without the Jacobian's rows."""

from __future__ import annotations

from typing import Any

from tipfem.backend.launch import launch
from tipfem.fem import matrix_free
from tipfem.linalg.fgmres import Iteration
from tipfem.step.linear_system import LinearSystem


class MatrixFreeSystem(LinearSystem):
    """A linear system whose products are computed from the elements' linearisation, with the same preconditioner.

    The Jacobian is that of the last residual. The preconditioner obtains products with the blocks D and G from products
    with K, so only the pressure Laplacian is stored in rows. See D. A. Knoll & D. E. Keyes, Jacobian-free Newton-Krylov
    methods, Journal of Computational Physics 193, 2004; the products here are exact, not differences of residuals.

    The arguments are those of `LinearSystem`.
    """

    stores_rows = False
    _record: Any = None

    def gather(self, record: Any) -> None:
        """Take the elements' linearisation of the last residual, (M, w) on the device, as the Jacobian."""
        self._record = record

    def product(self, v: Any, out: Any) -> None:
        """out = K v, the derivative of the scaled residual along ``v``; both (N (d + 1),) on the device."""
        self._multiply(v, out)
        self._complete(v, out)
        if self._slip:
            self._slip.product(v, out)
        self.walls.product(v, out)
        if self.bodies:
            self.bodies.product(v, out)

    def _multiply(self, v: Any, out: Any) -> None:
        """The part of `product` that the elements give."""
        s, d = self._scheme, self._dimension
        launch(
            matrix_free.jacobian_product,
            *self._topology,
            self._density,
            self._lumping,
            self._record,
            self._scale,
            v,
            self._buffers.get("local", self._elements * (d + 1), d + 1),
            out,
            s.cm,
            s.cv,
            s.cf,
            self._elements,
            self._nodes,
            d,
        )

    def precondition(self, r: Any, z: Any) -> None:
        """z ~ K^-1 r, as `LinearSystem.precondition`; r and z are (N (d + 1),) on the device."""
        n, d, work = self._nodes, self._dimension, (self._nodes, matrix_free.PARTICLE)
        size = n * (d + 1)
        half, product = (self._buffers.get(f"matrix_free.{name}", size) for name in ("half", "product"))
        if self.bodies:
            self.bodies.begin(r)
        launch(matrix_free.copy_displacements, r, half, n, d, work=work)
        if self._ties:
            self._ties.spread(half)
        self._multiply(half, product)
        vectors = self.multigrid.vectors
        launch(matrix_free.schur_rhs, r, product, self._scale, vectors, n, d, work=work)
        if self.bodies:
            self.bodies.clear(r)
        self._solve_pressure()
        launch(matrix_free.copy_pressures, vectors, half, n, d, work=work)
        self._multiply(half, product)
        if self._ties:
            self._ties.collect(product)
        launch(matrix_free.block_correction, r, product, vectors, z, n, d, work=work)
        self._constrain(z)

    @property
    def iteration(self) -> Iteration | None:
        """None: an iteration takes several launches."""
        return None

    def matrix(self) -> Any:
        """The matrix is not stored.

        Raises:
            NotImplementedError: always.
        """
        raise NotImplementedError("MatrixFreeSystem stores no rows; Numerics(jacobian='rows') does")
