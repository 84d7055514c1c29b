"""Flexible GMRES on device vectors; no physics."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from tipfem.backend.arrays import Buffers
from tipfem.backend.launch import launch
from tipfem.linalg import vector_kernels

Operator = Callable[[Any, Any], None]
# (k, basis, directions, w, partial, out, cancelled, again): z_k = M v_k, w = A z_k, and what
# `vector_kernels.orthogonalise` makes of w, itself becoming v_{k+1}; only the latter if ``again``. v_k and z_k are what
# stands in basis and directions at k times the size.
Iteration = Callable[[int, Any, Any, Any, Any, Any, float, bool], None]

# Nanoseconds that a thread takes for an entry of a vector: of one vector, and of one to be made orthogonal to a few.
ENTRY, ENTRY_OF_MANY = 2.0, 10.0

# Vectors that the basis has room for at first; it grows by as many.
ROOM = 16


@dataclass(frozen=True)
class KrylovResult:
    """How a solve went: iterations done, residual norm over that of the right side, and whether it converged."""

    iterations: int
    relative_residual: float
    converged: bool


def fgmres(
    operator: Operator,
    preconditioner: Operator,
    right_side: Any,
    solution: Any,
    size: int,
    *,
    tolerance: float,
    max_iterations: int,
    buffers: Buffers,
    iteration: Iteration | None = None,
) -> KrylovResult:
    """Solve A x = b from x = 0 by flexible GMRES with right preconditioning.

    Y. Saad, Iterative Methods for Sparse Linear Systems (2003), algorithm 9.6; classical
    Gram-Schmidt, done twice when the first pass cancels too much.

    Args:
        operator: writes A v into its second argument.
        preconditioner: writes an approximate A^-1 v into its second argument.
        right_side: device vector with ``size`` live entries.
        solution: device vector, overwritten.
        size: number of unknowns.
        tolerance: of the residual norm relative to that of ``right_side``.
        max_iterations: when to give up; also the length of the basis, there is no restart.
        buffers: where the basis lives between solves.
        iteration: does both, and the first pass of the orthogonalisation, at once.

    Raises:
        FloatingPointError: a norm is not finite.
    """
    work = (size, ENTRY)
    basis = _Basis(size, tolerance, buffers)
    out = np.zeros(1)
    partial = buffers.partials("krylov.partial", 1)
    launch(vector_kernels.start, right_side, basis.orthonormal, partial, out, size, work=work)
    beta = float(out[0])
    if not math.isfinite(beta):
        raise FloatingPointError("the residual is not finite")
    if beta == 0.0:
        launch(vector_kernels.fill, solution, 0.0, size, work=work)
        return KrylovResult(0, 0.0, True)
    hessenberg = np.zeros((max_iterations + 1, max_iterations))
    # Numbers of Python's own: they are few, and NumPy takes longer to look at each.
    cosine: list[float] = []
    sine: list[float] = []
    g = [beta]
    k = 0
    iteration = iteration or basis.by_parts(operator, preconditioner)
    while k < max_iterations and abs(g[k]) > tolerance * beta:
        column = basis.extend(k, iteration)
        if not all(map(math.isfinite, column)):
            raise FloatingPointError("a Krylov vector is not finite")
        for i in range(k):
            column[i], column[i + 1] = (
                cosine[i] * column[i] + sine[i] * column[i + 1],
                -sine[i] * column[i] + cosine[i] * column[i + 1],
            )
        length = math.hypot(column[k], column[k + 1])
        if length == 0.0:
            break
        cosine.append(column[k] / length)
        sine.append(column[k + 1] / length)
        column[k], column[k + 1] = length, 0.0
        hessenberg[: k + 1, k] = column[: k + 1]
        g.append(-sine[k] * g[k])
        g[k] *= cosine[k]
        k += 1
    weights = np.linalg.solve(np.triu(hessenberg[:k, :k]), g[:k]) if k else np.zeros(0)
    launch(vector_kernels.combine, basis.directions, np.append(weights, 0.0), solution, k, size, work=work)
    relative = abs(g[k]) / beta
    return KrylovResult(k, relative, relative <= tolerance)


class _Basis:
    """The vectors v_0, v_1, ... of the Krylov space, and z_k = M v_k: one behind the other in two device arrays."""

    def __init__(self, size: int, tolerance: float, buffers: Buffers) -> None:
        self.size, self._buffers = size, buffers
        # How far the vectors may be from orthogonal, the residual still being known well; and how far they are.
        self._loss_allowed, self._loss = max(1e-4 * tolerance, 1e-15), 0.0
        self._make_room(1)

    def _make_room(self, vectors: int) -> None:
        room = -(-vectors // ROOM) * ROOM
        self.orthonormal = self._buffers.grow("krylov.basis", room * self.size)
        self.directions = self._buffers.grow("krylov.directions", room * self.size)
        self._room = room

    def by_parts(self, operator: Operator, preconditioner: Operator) -> Iteration:
        """An iteration that does one after the other."""
        size, work = self.size, (self.size, ENTRY)
        v, z = (self._buffers.get(f"krylov.{name}", size) for name in "vz")

        def iteration(
            k: int, basis: Any, directions: Any, w: Any, partial: Any, out: Any, cancelled: float, again: bool
        ) -> None:
            if not again:
                launch(vector_kernels.move, basis, k * size, v, 0, size, work=work)
                preconditioner(v, z)
                operator(z, w)
                launch(vector_kernels.move, z, 0, directions, k * size, size, work=work)
            many = (size, ENTRY_OF_MANY)
            launch(vector_kernels.orthogonalise, basis, w, partial, out, k, size, cancelled, work=many)

        return iteration

    def extend(self, k: int, iteration: Iteration) -> list[float]:
        """Make z_k = M v_k, and of A z_k the vector v_{k+1}.

        Returns:
            (k + 2,) column k of the Hessenberg matrix.
        """
        if k + 2 > self._room:
            self._make_room(k + 2)
        column = [0.0] * (k + 2)
        w, partial = self._buffers.get("krylov.w", self.size), self._buffers.partials("krylov.dots", k + 2, flat=True)
        # Below it, what cancellation leaves is neither orthogonal enough nor of a length known well: once more.
        least = max(CANCELLED, ((self._loss + EPSILON) / self._loss_allowed) ** 2)
        for again in (False, True):
            out = np.zeros(k + 3)
            iteration(k, self.orthonormal, self.directions, w, partial, out, least, again)
            *components, before, after = out.tolist()
            for j, component in enumerate(components):
                column[j] += component
            if not after < least * before:
                break
            least = CANCELLED
        # One pass of Gram-Schmidt multiplies what is not orthogonal already by the cancellation.
        grown = (self._loss + EPSILON) * math.sqrt(before / after) if after > 0 else self._loss_allowed
        self._loss = min(max(self._loss, grown), self._loss_allowed)
        column[k + 1] = math.sqrt(max(after, 0.0))
        return column


# Part of a vector's squared length that must be left when it has been made orthogonal to others.
CANCELLED = 1e-4
EPSILON = 2e-16


def largest(x: Any, n: int, buffers: Buffers) -> float:
    """Largest |x_i| of the first ``n`` entries; NaN if one of them is."""
    out = np.zeros(2)
    partial = buffers.partials("krylov.partial_largest", 2)
    launch(vector_kernels.largest, x, partial, out, n, work=(n, ENTRY))
    return float("nan") if out[1] > 0 else float(out[0])
