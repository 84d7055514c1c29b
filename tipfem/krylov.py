"""Flexible GMRES on device vectors; no physics."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import taichi as ti

from tipfem.device import Buffers, chunks

Operator = Callable[[Any, Any], None]


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
    basis = [buffers.get("krylov.v0", size)]
    directions: list[Any] = []
    partial = buffers.get("krylov.partial", parts, 1)
    out = np.zeros(1)
    _norm_and_scale(right_side, basis[0], partial, out, size, parts)
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
        z = buffers.get(f"krylov.z{k}", size)
        w = buffers.get(f"krylov.v{k + 1}", size)
        preconditioner(basis[k], z)
        operator(z, w)
        directions.append(z)
        basis.append(w)
        column = _orthogonalise(basis, size, parts, buffers)
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
    _fill(solution, 0.0, size)
    for start in range(0, k, GROUP):
        _accumulate(directions[start : start + GROUP], weights[start : start + GROUP], solution, size)
    relative = abs(float(g[k])) / beta
    return KrylovResult(k, relative, relative <= tolerance)


# How many vectors a fused kernel takes at once; missing ones are stood in for by the first.
GROUP = 8


def _group(vectors: list[Any]) -> list[Any]:
    return vectors + [vectors[0]] * (GROUP - len(vectors))


def _orthogonalise(basis: list[Any], size: int, parts: int, buffers: Buffers) -> np.ndarray:
    """Make the last vector of the basis orthogonal to the others and of length 1.

    Returns:
        The column of the Hessenberg matrix, the length of what was left last.
    """
    w, others = basis[-1], basis[:-1]
    column = np.zeros(len(others) + 1)
    partial = buffers.get("krylov.partial_dots", parts, GROUP + 1)
    for _ in range(2):
        before = after = 0.0
        for start in range(0, len(others), GROUP):
            group = others[start : start + GROUP]
            out = np.zeros(GROUP + 2)
            _project(*_group(group), w, partial, out, size, parts, len(group))
            column[start : start + len(group)] += out[: len(group)]
            before = max(before, out[GROUP])
            after = out[GROUP + 1]
        # What cancellation to less than a third leaves is not orthogonal enough: project again.
        if after > 0.1 * before:
            break
    column[-1] = np.sqrt(after)
    if column[-1] > 0:
        _scale(w, 1.0 / column[-1], size)
    return column


@ti.func
def block_of(c, parts, n):
    """First and last + 1 index of part ``c`` of ``parts`` of 0 ... n."""
    size = (n + parts - 1) // parts
    return c * size, ti.min((c + 1) * size, n)


@ti.kernel
def _norm_and_scale(
    x: ti.types.ndarray(), y: ti.types.ndarray(), partial: ti.types.ndarray(), out: ti.types.ndarray(),
    n: ti.i32, parts: ti.i32,
):  # fmt: skip
    """out[0] = |x|, y = x / |x| (0 if x is 0)."""
    for c in range(parts):
        first, last = block_of(c, parts, n)
        total = 0.0
        for i in range(first, last):
            total += x[i] * x[i]
        partial[c, 0] = total
    ti.loop_config(serialize=True)
    for _ in range(1):
        total = 0.0
        for c in range(parts):
            total += partial[c, 0]
        out[0] = ti.sqrt(total)
        partial[0, 0] = ti.sqrt(total)
    for i in range(n):
        y[i] = ti.select(partial[0, 0] > 0.0, x[i] / partial[0, 0], 0.0)


@ti.kernel
def _project(
    v0: ti.types.ndarray(), v1: ti.types.ndarray(), v2: ti.types.ndarray(), v3: ti.types.ndarray(),
    v4: ti.types.ndarray(), v5: ti.types.ndarray(), v6: ti.types.ndarray(), v7: ti.types.ndarray(),
    w: ti.types.ndarray(), partial: ti.types.ndarray(), out: ti.types.ndarray(),
    n: ti.i32, parts: ti.i32, used: ti.i32,
):  # fmt: skip
    """w -= sum_j (v_j . w) v_j; out: the dots, then |w|^2 before and after."""
    for c in range(parts):
        first, last = block_of(c, parts, n)
        dots = ti.Vector.zero(float, 9)
        for i in range(first, last):
            x = w[i]
            dots += ti.Vector([v0[i], v1[i], v2[i], v3[i], v4[i], v5[i], v6[i], v7[i], x]) * x
        for j in ti.static(range(9)):
            partial[c, j] = dots[j]
    ti.loop_config(serialize=True)
    for j in range(9):
        total = 0.0
        for c in range(parts):
            total += partial[c, j]
        if j < 8 and j >= used:
            total = 0.0
        out[j] = total
        partial[0, j] = total
    for c in range(parts):
        first, last = block_of(c, parts, n)
        d = ti.Vector([partial[0, j] for j in ti.static(range(8))])
        rest = 0.0
        for i in range(first, last):
            x = w[i]
            x -= d[0] * v0[i] + d[1] * v1[i] + d[2] * v2[i] + d[3] * v3[i]
            x -= d[4] * v4[i] + d[5] * v5[i] + d[6] * v6[i] + d[7] * v7[i]
            w[i] = x
            rest += x * x
        if c > 0:
            partial[c, 0] = rest
        else:
            partial[0, 8] = rest
    ti.loop_config(serialize=True)
    for _ in range(1):
        total = partial[0, 8]
        for c in range(1, parts):
            total += partial[c, 0]
        out[9] = total


@ti.kernel
def _combine(
    v0: ti.types.ndarray(), v1: ti.types.ndarray(), v2: ti.types.ndarray(), v3: ti.types.ndarray(),
    v4: ti.types.ndarray(), v5: ti.types.ndarray(), v6: ti.types.ndarray(), v7: ti.types.ndarray(),
    d: ti.types.ndarray(), y: ti.types.ndarray(), n: ti.i32,
):  # fmt: skip
    """y += sum_j d_j v_j."""
    for i in range(n):
        y[i] += (
            d[0] * v0[i] + d[1] * v1[i] + d[2] * v2[i] + d[3] * v3[i]
            + d[4] * v4[i] + d[5] * v5[i] + d[6] * v6[i] + d[7] * v7[i]
        )  # fmt: skip


def _accumulate(vectors: list[Any], weights: np.ndarray, y: Any, n: int) -> None:
    padded = np.zeros(GROUP)
    padded[: len(weights)] = weights
    _combine(*_group(vectors), padded, y, n)


@ti.kernel
def _scale(x: ti.types.ndarray(), factor: float, n: ti.i32):
    for i in range(n):
        x[i] *= factor


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
