"""Flexible GMRES that a GPU does alone: its iterations, least-squares problem and solution wait there, one after other.

The host queues as many iterations as the last solve lets expect; those after the last that is needed do nothing. It
reads how the solve went when it has to wait for something else, and queues more where they were too few. What a solve
gives does not depend on how many are queued at a time. Arnoldi's method is as in `tipfem.linalg.fgmres`.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import taichi as ti

from tipfem.backend.array_types import Reals1, Template
from tipfem.backend.arrays import Buffers, download, expect
from tipfem.backend.launch import FEW_PARTS, kernel, launch, parts
from tipfem.linalg.fgmres import KrylovResult, KrylovSpace
from tipfem.linalg.vector_kernels import (
    ALLOWED,
    CANCELLED,
    LEFT,
    LOSS,
    MADE,
    TOLERANCE,
    find_factor,
    fold_dots,
    least_left,
    lost,
    strided_dot,
    subtract_at,
    sum_folded,
)

# Entries of the state of a solve, behind those of `vector_kernels`, of which `LEFT` is the relative residual and `MADE`
# the number of columns taken: the number of the one that needs a second pass, or 0; whether iterations go on; |b|; how
# many columns there may be. Then there are, in `MOST` + 2 entries each, the cosines and sines of Givens rotations,
# the rotated right-hand side, the weights of the solution, and columns of the Hessenberg matrix, the last one first.
AGAIN, GOES_ON, NORM, LIMIT, HEAD = range(5, 10)
MOST = 80  # columns
SPARE = 0.5  # iterations queued beside those expected: so 2 to 4 % of the solves need more, and others one less
COSINE, SINE, SIDE, WEIGHT, COLUMN = (HEAD + (MOST + 2) * k for k in range(5))
TRIANGLE = COLUMN + MOST + 2

# (k, krylov, partial, state): iteration k with one pass of Gram-Schmidt's method, unless the state says no.
QueuedIteration = Callable[[int, Any, Any, Any], None]


@ti.func
def goes_on(state: Template):
    """Whether an iteration is to be made: 1 or 0."""
    return ti.cast(state[GOES_ON], ti.i32)


@ti.func
def is_made(state: Template, k):
    """Whether v_{k+1} is needed, or a second pass for it, after `take_column`: 1 or 0."""
    needed = (state[GOES_ON] > 0.0 and state[MADE] == k + 1.0) or state[AGAIN] == k + 1.0
    return ti.cast(needed, ti.i32)


@ti.func
def take_column(partial: Template, state: Template, k, second):
    """Take column k of the Hessenberg matrix, from dot products in ``partial``, unless it needs a ``second`` pass."""
    least = ti.select(second, CANCELLED, least_left(state))
    find_factor(partial, k, least)
    before, after = partial[k + 2], partial[k + 3]
    for j in range(k + 1):
        state[COLUMN + j] = ti.select(second, state[COLUMN + j], 0.0) + partial[j]
    if after < least * before and second == 0:
        state[AGAIN], state[GOES_ON] = k + 1.0, 0.0
    else:
        state[LOSS], state[AGAIN], state[MADE] = lost(state, before, after), 0.0, k + 1.0
        for i in range(k):
            one, other = state[COLUMN + i], state[COLUMN + i + 1]
            state[COLUMN + i] = state[COSINE + i] * one + state[SINE + i] * other
            state[COLUMN + i + 1] = state[COSINE + i] * other - state[SINE + i] * one
        square = ti.select(after < 0.0, 0.0, after)  # what is no number stays so
        length = ti.sqrt(state[COLUMN + k] ** 2 + square)
        if length == 0.0:
            state[MADE] = k + 0.0
        else:
            state[COSINE + k], state[SINE + k] = state[COLUMN + k] / length, ti.sqrt(square) / length
            state[COLUMN + k] = length
            for i in range(k + 1):
                state[TRIANGLE + k * MOST + i] = state[COLUMN + i]
            state[SIDE + k + 1] = -state[SINE + k] * state[SIDE + k]
            state[SIDE + k] = state[COSINE + k] * state[SIDE + k]
            state[LEFT] = ti.abs(state[SIDE + k + 1]) / state[NORM]
        # False for values that are not finite, too.
        wanted = state[LEFT] > state[TOLERANCE] and length > 0.0 and k + 1.0 < state[LIMIT]
        state[GOES_ON] = ti.cast(wanted, float)


@kernel
def start_queue(results: Reals1, state: Reals1, tolerance: float, allowed: float, most: ti.i32):
    """The ``state`` before the first iteration, after `vector_kernels.normalise`."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        norm = results[0]
        state[LOSS], state[ALLOWED], state[TOLERANCE], state[LIMIT] = 0.0, allowed, tolerance, most
        state[LEFT], state[MADE], state[AGAIN], state[NORM], state[SIDE] = 1.0, 0.0, 0.0, norm, norm
        state[GOES_ON] = ti.cast(norm > 0.0 and norm < ti.math.inf and tolerance < 1.0 and most > 0, float)


@kernel
def orthogonalise_queued(
    krylov: Reals1, partial: Reals1, state: Reals1, k: ti.i32, n: ti.i32, second: ti.i32, parts: ti.i32
):
    """A first or ``second`` pass for v_{k+1}, see `vector_kernels.orthogonalise_on_gpu`."""
    for t in range((k + 2) * parts):
        strided_dot(krylov, partial, t, k, n, parts)
    for t in range((k + 2) * FEW_PARTS):
        fold_dots(partial, t, k, parts)
    for j in range(k + 2):
        sum_folded(partial, j, k, parts)
    ti.loop_config(serialize=True)
    for _ in range(1):
        take_column(partial, state, k, second)
    for i in range(n * is_made(state, k)):
        subtract_at(krylov, partial, i, k, n)


@kernel
def combine_queued(krylov: Reals1, state: Reals1, x: Reals1, n: ti.i32):
    """x = sum of the directions with the weights of the least residual; 0 if that is not finite."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        k = ti.cast(state[MADE], ti.i32)
        for m in range(k):
            i = k - 1 - m
            total = state[SIDE + i]
            for j in range(i + 1, k):
                total -= state[TRIANGLE + j * MOST + i] * state[WEIGHT + j]
            state[WEIGHT + i] = total / state[TRIANGLE + i * MOST + i]
    for i in range(n):
        total = 0.0
        if state[LEFT] >= 0.0:
            for j in range(ti.cast(state[MADE], ti.i32)):
                total += state[WEIGHT + j] * krylov[(2 * j + 1) * n + i]
        x[i] = total


@dataclass
class Pace:
    """By which factor an iteration reduces the residual, as was found last: a guess of how many will be needed."""

    reduction: float = 0.3


class QueuedSolve:
    """A solve K x = b from x = 0 that a GPU does, see `tipfem.linalg.fgmres.fgmres` for arguments and errors.

    Args:
        then: queues what is to be done with the solution.
        pace: of the last solve, and then of this one.

    Attributes:
        result: None until `finished`.
    """

    def __init__(
        self,
        iteration: QueuedIteration,
        then: Callable[[], None],
        rhs: Any,
        solution: Any,
        size: int,
        *,
        tolerance: float,
        most: int,
        buffers: Buffers,
        pace: Pace,
    ) -> None:
        self._iteration, self._then, self._solution, self.tolerance = iteration, then, solution, tolerance
        self._most, self._buffers, self._pace = min(most, MOST), buffers, pace
        self._krylov = KrylovSpace(size, tolerance, self._most, buffers)
        self._state = buffers.get("krylov.state", TRIANGLE + MOST**2)
        self.result: KrylovResult | None = None
        self._krylov.begin(rhs)
        given = tolerance, self._krylov.loss_allowed, self._most
        launch(start_queue, self._krylov.results, self._state, *given)
        self._queue(0, 1.0)

    @property
    def iterations(self) -> int:
        """Number of iterations, of a solve that is `finished`."""
        assert self.result is not None
        return self.result.iterations

    def _queue(self, made: int, left: float) -> None:
        """Queue the iterations that seem to be missing, and the solution; ``left`` is the relative residual."""
        factors = self.tolerance / left, self._pace.reduction
        wanted = math.log(factors[0]) / math.log(factors[1]) if all(0 < f < 1 for f in factors) else 1.0
        end = min(made + math.ceil(min(wanted, self._most) + SPARE), self._most)
        self._krylov.make_room(end + 1)
        partial = self._buffers.get("krylov.dots", (parts() + FEW_PARTS) * (end + 1))
        for k in range(made, end):
            self._iteration(k, self._krylov.vectors, partial, self._state)
        launch(combine_queued, self._krylov.vectors, self._state, self._solution, self._krylov.size)
        self._then()
        expect(self._state, HEAD)

    def finished(self) -> bool:
        """Whether all is done, by what is read; if not, what is missing is queued.

        Raises:
            FloatingPointError: a norm is not finite.
        """
        if self.result is not None:
            return True
        state = download(self._state, HEAD).tolist()
        made, left, again = int(state[MADE]), state[LEFT], int(state[AGAIN])
        if not math.isfinite(state[NORM]):
            raise FloatingPointError("the residual is not finite")
        if not math.isfinite(left):
            raise FloatingPointError("a Krylov vector is not finite")
        if made and 0 < left < 1:
            self._pace.reduction = left ** (1 / made)
        if again:
            partial = self._buffers.get("krylov.dots", (parts() + FEW_PARTS) * (again + 1))
            given = self._krylov.vectors, partial, self._state, again - 1, self._krylov.size
            launch(orthogonalise_queued, *given, 1)
        if again or state[GOES_ON]:
            self._queue(max(made, again), left)
            return False
        left = 0.0 if state[NORM] == 0.0 else left
        self.result = KrylovResult(made, left, left <= self.tolerance)
        return True

    def done(self) -> KrylovResult:
        """The result, for which it waits."""
        while not self.finished():
            pass
        assert self.result is not None
        return self.result
