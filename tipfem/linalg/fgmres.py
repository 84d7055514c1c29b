"""Flexible GMRES on device vectors."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from tipfem.backend.arrays import Buffers, download
from tipfem.backend.launch import FEW_PARTS, launch, parts
from tipfem.backend.runtime import on_gpu
from tipfem.linalg import vector_kernels
from tipfem.linalg.vector_kernels import ALLOWED, CANCELLED, ENTRY, ENTRY_OF_MANY, EPSILON, LEFT, MADE, NULL, TOLERANCE
from tipfem.scratch import filled, owned
from tipfem.typing import Array

Operator = Callable[[Any, Any], None]
# (k, end, krylov, partial, state, columns): iterations k ... end - 1, or fewer if the residual is small enough before:
# z_k = M v_k, w = A z_k stored as v_{k+1}, and passes of `vector_kernels.orthogonalise`, with the columns of the
# Hessenberg matrix and ``state`` as in `vector_kernels.record_column`.
Iterations = Callable[[int, int, Any, Any, Array, Array], None]

# Number of pairs of vectors v_k, z_k that are allocated at a time.
ROOM = 16


@dataclass(frozen=True)
class KrylovResult:
    """Result of a solve: iterations, residual norm relative to the right-hand side, and whether it converged."""

    iterations: int
    relative_residual: float
    converged: bool


def fgmres(
    operator: Operator,
    preconditioner: Operator,
    rhs: Any,
    solution: Any,
    size: int,
    *,
    tolerance: float,
    max_iterations: int,
    buffers: Buffers,
    iterations: Iterations | None = None,
) -> KrylovResult:
    """Solve A x = b from x = 0 by flexible GMRES with right preconditioning.

    Y. Saad, Iterative Methods for Sparse Linear Systems (2003), algorithm 9.6. Arnoldi's method by classical
    Gram-Schmidt, with a second pass where the first cancels too much; the least-squares problem by Givens rotations.

    Args:
        operator: writes A v into its second argument.
        preconditioner: writes an approximate A^-1 v into its second argument; it may differ from call to call.
        rhs: device vector b, of which ``size`` entries are used.
        solution: device vector x, overwritten.
        tolerance: of the residual norm relative to that of ``rhs``.
        max_iterations: largest number of iterations, and so the size of the basis; there is no restart.
        iterations: makes several iterations with both operators in one launch, where that is possible.

    Raises:
        FloatingPointError: a norm is not finite.
    """
    krylov = KrylovSpace(size, tolerance, max_iterations, buffers)
    krylov.begin(rhs)
    beta = krylov.norm()
    if not math.isfinite(beta):
        raise FloatingPointError("the residual is not finite")
    if beta == 0.0:
        launch(vector_kernels.fill, solution, 0.0, size, work=(size, ENTRY))
        return KrylovResult(0, 0.0, True)
    least_squares = _LeastSquares(beta, max_iterations)
    enough = tolerance * beta
    while least_squares.count < max_iterations and least_squares.residual > enough:
        k = least_squares.count
        columns = krylov.extend_at_once(k, iterations) if iterations else krylov.extend(k, operator, preconditioner)
        if not least_squares.take(columns, enough):
            break
    krylov.combine(least_squares.weights(), solution)
    relative = least_squares.residual / beta
    return KrylovResult(least_squares.count, relative, relative <= tolerance)


class _LeastSquares:
    """min |beta e_0 - H y| with the Hessenberg matrix H, column by column, by Givens rotations; ``residual`` is it."""

    def __init__(self, beta: float, most: int) -> None:
        # Plain Python numbers: these are few, and NumPy would be slower.
        self._cosine: list[float] = []
        self._sine: list[float] = []
        self._g = [beta]
        self._triangle = filled(0.0, "", (most + 1, most))
        self.count, self.residual = 0, beta

    def take(self, columns: list[list[float]], enough: float) -> bool:
        """Take columns (k + 2,), (k + 3,), ..., until the residual is small ``enough``; False if one is zero."""
        cosine, sine, g = self._cosine, self._sine, self._g
        for column in columns:
            if not all(map(math.isfinite, column)):
                raise FloatingPointError("a Krylov vector is not finite")
            k = self.count
            for i in range(k):
                column[i], column[i + 1] = (
                    cosine[i] * column[i] + sine[i] * column[i + 1],
                    -sine[i] * column[i] + cosine[i] * column[i + 1],
                )
            length = math.hypot(column[k], column[k + 1])
            if length == 0.0:
                return False
            cosine.append(column[k] / length)
            sine.append(column[k + 1] / length)
            column[k], column[k + 1] = length, 0.0
            self._triangle[: k + 1, k] = column[: k + 1]
            g.append(-sine[k] * g[k])
            g[k] *= cosine[k]
            self.count, self.residual = k + 1, abs(g[k + 1])
            if self.residual <= enough:
                break
        return True

    def weights(self) -> Array:
        """y (k,)."""
        k = self.count
        return np.linalg.solve(self._triangle[:k, :k], self._g[:k]) if k else np.zeros(0)


class KrylovSpace:
    """The basis v_0, v_1, ... of the Krylov space and the directions z_k = M v_k, see `vector_kernels`.

    They are in ``vectors`` on the device. ``tolerance``, of the relative residual norm, bounds the loss of
    orthogonality; ``most`` is the largest number of iterations.
    """

    def __init__(self, size: int, tolerance: float, most: int, buffers: Buffers) -> None:
        self.size, self._most, self._buffers = size, most, buffers
        # Loss of orthogonality for which the residual is still accurate enough, and the estimated loss.
        self.loss_allowed, self._loss = max(1e-4 * tolerance, 1e-15), 0.0
        self._tolerance = tolerance
        self._room = 0
        self.make_room(1)

    def make_room(self, pairs: int) -> None:
        """Make room for so many pairs of vectors."""
        if pairs <= self._room:
            return
        self._room = -(-pairs // ROOM) * ROOM
        self.vectors = self._buffers.grow("krylov.vectors", 2 * self._room * self.size)
        self.results = self._buffers.get("krylov.results", self._room + 5)

    def begin(self, rhs: Any) -> None:
        """Set v_0 = b / |b|."""
        partial = self._buffers.get("krylov.partial", parts())
        launch(vector_kernels.normalise, rhs, self.vectors, partial, self.results, self.size, work=(self.size, ENTRY))

    def norm(self) -> float:
        """The norm |b|."""
        return float(download(self.results, 1)[0])

    def _orthogonalise(self, k: int, cancelled: float) -> tuple[list[float], float, float]:
        """One pass of `vector_kernels.orthogonalise`: components of v_{k+1}, and |w|^2 before and after."""
        kernel = vector_kernels.orthogonalise_on_gpu if on_gpu() else vector_kernels.orthogonalise
        partial = self._buffers.get("krylov.dots", (parts() + FEW_PARTS) * (k + 2))
        given, work = (self.vectors, partial, self.results, k, self.size, cancelled), (self.size, ENTRY_OF_MANY)
        launch(kernel, *given, work=work)
        _norm, *components, _factor, before, after = download(self.results, k + 5).tolist()
        return components, before, after

    def extend_at_once(self, k: int, iterations: Iterations) -> list[list[float]]:
        """Columns (k + 2,), (k + 3,), ... of H for k, k + 1, ..., until there is no room or the residual is small."""
        self.make_room(k + 2)
        if k == 0:
            self._state, self._columns = np.zeros(NULL + self._most + 1), owned((self._most, self._most + 1))
            self._state[[ALLOWED, TOLERANCE, LEFT, NULL]] = self.loss_allowed, self._tolerance, 1.0, 1.0
        partial = self._buffers.get("krylov.dots", parts() * (self._room + 1))
        end = min(self._room - 1, self._most)
        iterations(k, end, self.vectors, partial, self._state, self._columns)
        made = int(self._state[MADE])
        columns = [row[: i + 2] for i, row in enumerate(self._columns[k:made].tolist(), k)]
        for column in columns:
            column[-1] = math.sqrt(max(column[-1], 0.0))
        return columns

    def extend(self, k: int, operator: Operator, preconditioner: Operator) -> list[list[float]]:
        """A column (k + 2,) of H: z_k = M v_k, v_{k+1} from A z_k, by the operators one after the other."""
        self.make_room(k + 2)
        n, work, get = self.size, (self.size, ENTRY), self._buffers.get
        v, z, w = (get(f"krylov.{name}", n) for name in "vzw")
        launch(vector_kernels.copy_entries, self.vectors, 2 * k * n, v, n, work=work)
        preconditioner(v, z)
        operator(z, w)
        launch(vector_kernels.store_direction, z, w, self.vectors, k, n, work=work)
        column, before, after = self._orthogonalise(k, least := self._least())
        if after < least * before:
            more, before, after = self._orthogonalise(k, CANCELLED)
            column = [one + other for one, other in zip(column, more, strict=True)]
        # One pass of Gram-Schmidt amplifies the loss of orthogonality by the cancellation.
        grown = (self._loss + EPSILON) * math.sqrt(before / after) if after > 0 else self.loss_allowed
        self._loss = min(max(self._loss, grown), self.loss_allowed)
        return [[*column, math.sqrt(max(after, 0.0))]]

    def _least(self) -> float:
        """Below this fraction, the remainder after cancellation is neither orthogonal nor accurate enough."""
        return max(CANCELLED, ((self._loss + EPSILON) / self.loss_allowed) ** 2)

    def combine(self, weights: Any, solution: Any) -> None:
        """solution = sum of weights[j] z_j."""
        k, work = len(weights), (self.size, ENTRY)
        kernel = vector_kernels.combine_on_gpu if on_gpu() else vector_kernels.combine
        weights = self._buffers.beside("krylov.weights", np.append(weights, 0.0))
        launch(kernel, self.vectors, weights, solution, k, self.size, work=work)


def largest(x: Any, n: int, buffers: Buffers) -> float:
    """Largest |x_i| of the first ``n`` entries; NaN if one of them is."""
    out, partial = buffers.get("krylov.largest", 2), buffers.get("krylov.partial_largest", 2 * parts())
    launch(vector_kernels.largest, x, partial, out, n, work=(n, ENTRY))
    value, bad = download(out, 2).tolist()
    return float("nan") if bad > 0 else float(value)
