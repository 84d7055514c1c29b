"""Flexible GMRES on device vectors; no physics.

Taichi makes ``a[i] += b`` an atomic operation, many times slower than ``a[i] = a[i] + b``; where no other thread
writes, the kernels say the latter.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import taichi as ti

from tipfem.device import Buffers, chunks

Operator = Callable[[Any, Any], None]

# Vectors that the basis has room for at first; it grows by as many.
ROOM = 16
# Rows of a vector that are worked on at once: what of all basis vectors fits into a core's cache.
BLOCK = 512


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

    Raises:
        FloatingPointError: a norm is not finite.
    """
    parts = chunks()
    basis = _Basis(size, tolerance, buffers)
    v, z, w = (buffers.get(f"krylov.{name}", size) for name in "vzw")
    out = np.zeros(1)
    _start(right_side, v, basis.orthonormal, buffers.get("krylov.partial", parts, 1), out, size, parts)
    beta = float(out[0])
    if not np.isfinite(beta):
        raise FloatingPointError("the residual is not finite")
    if beta == 0.0:
        _fill(solution, 0.0, size)
        return KrylovResult(0, 0.0, True)
    hessenberg = np.zeros((max_iterations + 1, max_iterations))
    cosine, sine = np.zeros(max_iterations), np.zeros(max_iterations)
    g = np.zeros(max_iterations + 1)
    g[0] = beta
    k = 0
    while k < max_iterations and abs(g[k]) > tolerance * beta:
        preconditioner(v, z)
        operator(z, w)
        column = basis.extend(k, w, z, v)
        if not np.isfinite(column).all():
            raise FloatingPointError("a Krylov vector is not finite")
        for i in range(k):
            column[i], column[i + 1] = (
                cosine[i] * column[i] + sine[i] * column[i + 1],
                -sine[i] * column[i] + cosine[i] * column[i + 1],
            )
        length = float(np.hypot(column[k], column[k + 1]))
        if length == 0.0:
            break
        cosine[k], sine[k] = column[k] / length, column[k + 1] / length
        column[k], column[k + 1] = length, 0.0
        hessenberg[: k + 1, k] = column[: k + 1]
        g[k + 1] = -sine[k] * g[k]
        g[k] *= cosine[k]
        k += 1
    weights = np.linalg.solve(np.triu(hessenberg[:k, :k]), g[:k]) if k else np.zeros(0)
    _combine(basis.directions, np.append(weights, 0.0), solution, k, size, parts)
    relative = abs(float(g[k])) / beta
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

    def extend(self, k: int, w: Any, z: Any, v: Any) -> np.ndarray:
        """Take over z_k = z and make of w = A z_k the vector v_{k+1}, in ``v`` too.

        Returns:
            (k + 2,) column k of the Hessenberg matrix.
        """
        if k + 2 > self._room:
            self._make_room(k + 2)
        parts, column = chunks(), np.zeros(k + 2)
        partial = self._buffers.get("krylov.dots", parts * (k + 2))
        # Below it, what cancellation leaves is neither orthogonal enough nor of a length known well: once more.
        least = max(CANCELLED, ((self._loss + EPSILON) / self._loss_allowed) ** 2)
        for _ in range(2):
            out = np.zeros(k + 3)
            _orthogonalise(self.orthonormal, self.directions, w, z, v, partial, out, k, self.size, parts, least)
            column[: k + 1] += out[: k + 1]
            before, after = out[k + 1 :]
            if not after < least * before:
                break
            w, least = v, CANCELLED
        # One pass of Gram-Schmidt multiplies what is not orthogonal already by the cancellation.
        grown = (self._loss + EPSILON) * np.sqrt(before / after) if after > 0 else self._loss_allowed
        self._loss = min(max(self._loss, float(grown)), self._loss_allowed)
        column[k + 1] = np.sqrt(max(after, 0.0))
        return column


# Part of a vector's squared length that must be left when it has been made orthogonal to others.
CANCELLED = 1e-4
EPSILON = 2e-16


@ti.func
def block_of(c, parts, n):
    """First and last + 1 index of part ``c`` of ``parts`` of 0 ... n."""
    size = (n + parts - 1) // parts
    return ti.min(c * size, n), ti.min((c + 1) * size, n)


@ti.kernel
def _start(
    b: ti.types.ndarray(), v: ti.types.ndarray(), basis: ti.types.ndarray(), partial: ti.types.ndarray(),
    out: ti.types.ndarray(), n: ti.i32, parts: ti.i32,
):  # fmt: skip
    """out[0] = |b|, v = v_0 = b / |b| (0 if b is 0)."""
    for c in range(parts):
        first, last = block_of(c, parts, n)
        total = 0.0
        for i in range(first, last):
            total += b[i] * b[i]
        partial[c, 0] = total
    ti.loop_config(serialize=True)
    for _ in range(1):
        total = 0.0
        for c in range(parts):
            total += partial[c, 0]
        out[0] = ti.sqrt(total)
        partial[0, 0] = ti.select(total > 0.0, 1.0 / ti.sqrt(total), 0.0)
    for c in range(parts):
        first, last = block_of(c, parts, n)
        factor = partial[0, 0]
        for i in range(first, last):
            v[i] = factor * b[i]
            basis[i] = factor * b[i]


@ti.kernel
def _orthogonalise(
    basis: ti.types.ndarray(), directions: ti.types.ndarray(), w: ti.types.ndarray(), z: ti.types.ndarray(),
    v: ti.types.ndarray(), partial: ti.types.ndarray(), out: ti.types.ndarray(),
    k: ti.i32, n: ti.i32, parts: ti.i32, cancelled: float,
):  # fmt: skip
    """z_k = z; v = v_{k+1} = w less its components d_j along v_0 ... v_k, over the length of that.

    out: d (k + 1,), |w|^2, and |w|^2 - |d|^2, which is the length squared of what is left. Where that is less than
    the part ``cancelled`` of |w|^2, v is left as long as it is, for another pass.
    """
    for c in range(parts):
        first, last = block_of(c, parts, n)
        at = c * (k + 2)
        for j in range(k + 2):
            partial[at + j] = 0.0
        # Block by block, so that w is read from the cache for all v_j.
        for block in range((last - first + BLOCK - 1) // BLOCK):
            start = first + block * BLOCK
            end = ti.min(start + BLOCK, last)
            for j in range(k + 1):
                row = j * n
                total = 0.0
                for i in range(start, end):
                    total += basis[row + i] * w[i]
                partial[at + j] = partial[at + j] + total
            total = 0.0
            for i in range(start, end):
                total += w[i] * w[i]
            partial[at + k + 1] = partial[at + k + 1] + total
            for i in range(start, end):
                directions[k * n + i] = z[i]
    ti.loop_config(serialize=True)
    for _ in range(1):
        left = 0.0
        for m in range(k + 2):
            j = k + 1 - m  # the length first
            total = 0.0
            for c in range(parts):
                total += partial[c * (k + 2) + j]
            partial[j] = total
            out[j] = total
            left = total if m == 0 else left - total * total
        out[k + 2] = left
        partial[k + 1] = ti.select(left < cancelled * out[k + 1], 1.0, 1.0 / ti.sqrt(left))
    for c in range(parts):
        first, last = block_of(c, parts, n)
        factor = partial[k + 1]
        for block in range((last - first + BLOCK - 1) // BLOCK):
            start = first + block * BLOCK
            end = ti.min(start + BLOCK, last)
            for i in range(start, end):
                v[i] = w[i]
            for j in range(k + 1):
                row = j * n
                d = partial[j]
                for i in range(start, end):
                    v[i] = v[i] - d * basis[row + i]
            row = (k + 1) * n
            for i in range(start, end):
                x = factor * v[i]
                v[i] = x
                basis[row + i] = x


@ti.kernel
def _combine(
    directions: ti.types.ndarray(), weights: ti.types.ndarray(), x: ti.types.ndarray(),
    k: ti.i32, n: ti.i32, parts: ti.i32,
):  # fmt: skip
    """x = sum of weights[j] z_j over the ``k`` directions."""
    for c in range(parts):
        first, last = block_of(c, parts, n)
        for block in range((last - first + BLOCK - 1) // BLOCK):
            start = first + block * BLOCK
            end = ti.min(start + BLOCK, last)
            for i in range(start, end):
                x[i] = 0.0
            for j in range(k):
                d = weights[j]
                for i in range(start, end):
                    x[i] = x[i] + d * directions[j * n + i]


@ti.kernel
def _fill(x: ti.types.ndarray(), value: float, n: ti.i32):
    for i in range(n):
        x[i] = value


@ti.kernel
def add(x: ti.types.ndarray(), y: ti.types.ndarray(), factor: float, n: ti.i32):
    """y += factor x over the first ``n`` entries."""
    for i in range(n):
        y[i] += factor * x[i]


def largest(x: Any, n: int, buffers: Buffers) -> float:
    """Largest |x_i| of the first ``n`` entries; NaN if one of them is."""
    parts = chunks()
    out = np.zeros(2)
    _largest(x, buffers.get("krylov.partial_largest", parts, 2), out, n, parts)
    return float("nan") if out[1] > 0 else float(out[0])


@ti.kernel
def _largest(
    x: ti.types.ndarray(), partial: ti.types.ndarray(), out: ti.types.ndarray(), n: ti.i32, parts: ti.i32
):  # fmt: skip
    for c in range(parts):
        first, last = block_of(c, parts, n)
        value = 0.0
        bad = 0.0
        for i in range(first, last):
            value = ti.max(value, ti.abs(x[i]))
            if ti.math.isnan(x[i]):
                bad += 1.0
        partial[c, 0] = value
        partial[c, 1] = bad
    ti.loop_config(serialize=True)
    for c in range(parts):
        out[0] = ti.max(out[0], partial[c, 0])
        out[1] += partial[c, 1]
