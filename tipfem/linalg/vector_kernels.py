"""Kernels on the vectors of Krylov's method: norms, sums, and orthogonalisation in blocks that fit into the cache.

Sums are formed in a fixed number of parts, so that they do not depend on the number of threads. Taichi makes
``a[i] += b`` an atomic operation, many times slower than ``a[i] = a[i] + b``; where no other thread writes, the latter.

The Krylov space is one array, ``krylov``, of vectors of n entries one after the other, in the order v_0, z_0, v_1, z_1,
...: v_k is the orthonormal basis of Arnoldi's method, z_k = M v_k are the preconditioned directions.
"""

import taichi as ti

from tipfem.backend.array_types import Reals1, Template
from tipfem.backend.launch import FEW_PARTS, folds, kernel, part_of, shared_by_gpu

BLOCK = 512  # rows that are processed together: those of all basis vectors fit into a core's cache
# Entries that are processed together in local memory, and sums of a dot product: as many as registers hold.
LANES, SUMS = 64, 32

# Nanoseconds of one thread for an entry: of one vector, and in `orthogonalise`.
ENTRY, ENTRY_OF_MANY = 2.0, 4.0


@kernel
def normalise(
    b: Reals1,
    krylov: Reals1,
    partial: Reals1,
    out: Reals1,
    n: ti.i32,
    parts: ti.i32,
    stride: Template,
    serial: Template,
):
    """out[0] = |b|, v_0 = b / |b| (0 if b is 0); ``partial`` (parts,) is scratch."""
    ti.loop_config(serialize=serial)
    for t in range(parts * stride):
        first, last = part_of(t, parts, stride, n)
        total = 0.0
        for i in range(first, last):
            total += b[i] * b[i]
        if t % stride == 0:
            partial[t // stride] = total
    if ti.static(shared_by_gpu(stride, serial)):
        for first in range(folds(parts, 1)):
            total = partial[first]
            for m in range(1, (parts - first + FEW_PARTS - 1) // FEW_PARTS):
                total += partial[first + m * FEW_PARTS]
            partial[first] = total
    ti.loop_config(serialize=True)
    for _ in range(1):
        total = 0.0
        for c in range(ti.min(parts, FEW_PARTS)):
            total += partial[c]
        out[0] = ti.sqrt(total)
        partial[0] = ti.select(total > 0.0, 1.0 / ti.sqrt(total), 0.0)
    ti.loop_config(serialize=serial)
    for t in range(parts * stride):
        first, last = part_of(t, parts, stride, n)
        factor = partial[0]
        for i in range(first, last):
            krylov[i] = factor * b[i]


@ti.func
def partial_dots(krylov: Template, partial: Template, part, k, n, first, last):
    """Products of entries first to last of w = v_{k+1} with v_0 ... v_k and itself, in row ``part`` of ``partial``."""
    at = part * (k + 2)
    w = 2 * (k + 1) * n
    for j in range(k + 2):
        partial[at + j] = 0.0
    # Block by block, so that w is read from the cache for all v_j.
    for block in range((last - first + BLOCK - 1) // BLOCK):
        start = first + block * BLOCK
        end = ti.min(start + BLOCK, last)
        for j in range(k + 2):
            v = 2 * j * n
            # Many sums side by side, in local memory: so the loop is vectorised.
            sums = ti.Vector.zero(float, SUMS)
            for m in range((end - start + SUMS - 1) // SUMS):
                low = start + m * SUMS
                at_v, at_w = v + low, w + low
                for s in range(ti.min(SUMS, end - low)):
                    sums[s] = sums[s] + krylov[at_v + s] * krylov[at_w + s]
            partial[at + j] = partial[at + j] + sums.sum()


@ti.func
def sum_dot(partial: Template, j, k, parts):
    """The dot product of number ``j`` from the `partial_dots`, into entry j of ``partial``."""
    total = 0.0
    for c in range(parts):
        total += partial[c * (k + 2) + j]
    partial[j] = total


@ti.func
def sum_dots(partial: Template, k, parts, cancelled):
    """The results of `orthogonalise` from the `partial_dots`, into the first entries of ``partial``."""
    for j in range(k + 2):
        sum_dot(partial, j, k, parts)
    find_factor(partial, k, cancelled)


@ti.func
def find_factor(partial: Template, k, cancelled):
    """The last results of `orthogonalise`, after the dot products."""
    before = partial[k + 1]  # |w|^2
    after = before
    for m in range(k + 1):
        after -= partial[k - m] * partial[k - m]
    partial[k + 1] = ti.select(after < cancelled * before, 1.0, 1.0 / ti.sqrt(after))
    partial[k + 2] = before
    partial[k + 3] = after


@ti.func
def subtract_projections(krylov: Template, partial: Template, k, n, first, last):
    """Entries first to last of v_{k+1}: w less its components along v_0 ... v_k, times the factor of `sum_dots`."""
    factor = partial[k + 1]
    w = 2 * (k + 1) * n
    # In local memory: loops that write to arrays are not vectorised.
    for block in range((last - first + LANES - 1) // LANES):
        start = first + block * LANES
        width = ti.min(LANES, last - start)
        remainder = ti.Vector.zero(float, LANES)
        for i in range(width):
            remainder[i] = krylov[w + start + i]
        for j in range(k + 1):
            v = 2 * j * n + start
            d = partial[j]
            for i in range(width):
                remainder[i] = remainder[i] - d * krylov[v + i]
        for i in range(width):
            krylov[w + start + i] = factor * remainder[i]


@ti.func
def keep_results(partial: Template, results: Template, k):
    """The results of `orthogonalise`, (k + 4,), into ``results``, behind |b|."""
    for j in range(k + 4):
        results[1 + j] = partial[j]


@kernel
def orthogonalise(
    krylov: Reals1,
    partial: Reals1,
    results: Reals1,
    k: ti.i32,
    n: ti.i32,
    cancelled: float,
    parts: ti.i32,
    stride: Template,
    serial: Template,
):
    """One pass of classical Gram-Schmidt: w, stored as v_{k+1}, becomes v_{k+1}.

    partial, (parts (k + 2),) or larger: first d_j = v_j . w for j = 0 ... k, then the factor by which the remainder was
    normalised, |w|^2, and |w|^2 - |d|^2, the squared norm of the remainder. Where the last is less than the fraction
    ``cancelled`` of |w|^2, the remainder is not normalised, for a second pass. All are kept in ``results``, see
    `keep_results`.
    """
    ti.loop_config(serialize=serial)
    for t in range(parts * stride):
        first, last = part_of(t, parts, stride, n)
        if t % stride == 0:
            partial_dots(krylov, partial, t // stride, k, n, first, last)
    for j in range(k + 2):
        sum_dot(partial, j, k, parts)
    ti.loop_config(serialize=True)
    for _ in range(1):
        find_factor(partial, k, cancelled)
        keep_results(partial, results, k)
    ti.loop_config(serialize=serial)
    for t in range(parts * stride):
        first, last = part_of(t, parts, stride, n)
        subtract_projections(krylov, partial, k, n, first, last)


@ti.func
def strided_dot(krylov: Template, partial: Template, t, k, n, parts):
    """Thread ``t`` of (k + 2) parts: every ``parts``-th entry of a product of `partial_dots`, for GPUs."""
    j, first = t // parts, t % parts
    total = 0.0
    for m in range((n - first + parts - 1) // parts):
        i = first + m * parts
        total += krylov[2 * j * n + i] * krylov[2 * (k + 1) * n + i]
    partial[t] = total


@ti.func
def fold_dots(partial: Template, t, k, parts):
    """Thread ``t`` of (k + 2) `FEW_PARTS` adds every `FEW_PARTS`-th of the sums of `strided_dot`; kept behind these."""
    j, first = t // FEW_PARTS, t % FEW_PARTS
    total = 0.0
    for m in range((parts - first + FEW_PARTS - 1) // FEW_PARTS):
        total += partial[j * parts + first + m * FEW_PARTS]
    partial[(k + 2) * parts + t] = total


@ti.func
def sum_folded(partial: Template, j, k, parts):
    """The dot product of number ``j`` from the sums of `fold_dots`, into entry j of ``partial``."""
    total = 0.0
    for m in range(FEW_PARTS):
        total += partial[(k + 2) * parts + j * FEW_PARTS + m]
    partial[j] = total


@ti.func
def subtract_at(krylov: Template, partial: Template, i, k, n):
    """Entry ``i`` of `subtract_projections`."""
    w = 2 * (k + 1) * n
    remainder = krylov[w + i]
    for j in range(k + 1):
        remainder -= partial[j] * krylov[2 * j * n + i]
    krylov[w + i] = partial[k + 1] * remainder


@kernel
def orthogonalise_on_gpu(
    krylov: Reals1, partial: Reals1, results: Reals1, k: ti.i32, n: ti.i32, cancelled: float, parts: ti.i32
):
    """`orthogonalise`, with its threads side by side; ``partial`` has at least (parts + FEW_PARTS) (k + 2) entries."""
    for t in range((k + 2) * parts):
        strided_dot(krylov, partial, t, k, n, parts)
    for t in range((k + 2) * FEW_PARTS):
        fold_dots(partial, t, k, parts)
    for j in range(k + 2):
        sum_folded(partial, j, k, parts)
    ti.loop_config(serialize=True)
    for _ in range(1):
        find_factor(partial, k, cancelled)
        keep_results(partial, results, k)
    for i in range(n):
        subtract_at(krylov, partial, i, k, n)


# Entries of the state of Krylov's method in `record_column`: see there. The last ones are the vector w.
LOSS, ALLOWED, TOLERANCE, LEFT, MADE, NULL = range(6)
CANCELLED = 1e-4  # fraction of a vector's squared norm that orthogonalisation must leave
EPSILON = 2e-16


@ti.func
def least_left(state: Template):
    """Fraction of |w|^2 below which the remainder of a first pass is neither orthogonal nor accurate enough."""
    part = (state[LOSS] + EPSILON) / state[ALLOWED]
    return ti.max(CANCELLED, part * part)


@ti.func
def lost(state: Template, before, after):
    """The loss of orthogonality after a pass of Gram-Schmidt, which amplifies it by the cancellation."""
    grown = state[ALLOWED]
    if after > 0:
        grown = (state[LOSS] + EPSILON) * ti.sqrt(before / after)
    return ti.min(ti.max(state[LOSS], grown), state[ALLOWED])


@ti.func
def record_column(partial: Template, columns: Template, state: Template, k, second):
    """Row k of ``columns`` (K, K + 2): column k of the Hessenberg matrix H, its last entry squared, from `sum_dots`.

    A ``second`` pass adds to the first. ``state`` holds the estimated loss of orthogonality, the one allowed, the
    tolerance of the relative residual, (|b| / |residual|)^2, and how many columns there are. The last is the squared
    norm of w with w_0 = 1 and w H = 0: the least residual is orthogonal to A times all directions, so its components
    along v_0, v_1, ... are in proportion to w.
    """
    for j in range(k + 1):
        columns[k, j] = ti.select(second, columns[k, j], 0.0) + partial[j]
    before, after = partial[k + 2], partial[k + 3]
    columns[k, k + 1] = after
    state[LOSS] = lost(state, before, after)
    total = 0.0
    for j in range(k + 1):
        total += columns[k, j] * state[NULL + j]
    w = -total / ti.sqrt(ti.max(after, 0.0))
    state[NULL + k + 1] = w
    state[LEFT] = state[LEFT] + w * w
    state[MADE] = k + 1.0


@kernel
def combine(
    krylov: Reals1, weights: Reals1, x: Reals1, k: ti.i32, n: ti.i32, parts: ti.i32, stride: Template, serial: Template
):
    """x = sum of weights[j] z_j over the first ``k`` directions."""
    ti.loop_config(serialize=serial)
    for t in range(parts * stride):
        first, last = part_of(t, parts, stride, n)
        for block in range((last - first + LANES - 1) // LANES):
            start = first + block * LANES
            width = ti.min(LANES, last - start)
            total = ti.Vector.zero(float, LANES)
            for j in range(k):
                d, z = weights[j], (2 * j + 1) * n + start
                for i in range(width):
                    total[i] = total[i] + d * krylov[z + i]
            for i in range(width):
                x[start + i] = total[i]


@kernel
def combine_on_gpu(krylov: Reals1, weights: Reals1, x: Reals1, k: ti.i32, n: ti.i32):
    """`combine`, entry by entry."""
    for i in range(n):
        total = 0.0
        for j in range(k):
            total += weights[j] * krylov[(2 * j + 1) * n + i]
        x[i] = total


@kernel
def fill(x: Reals1, value: float, n: ti.i32, serial: Template):
    """x_i = value for the first n entries."""
    ti.loop_config(serialize=serial)
    for i in range(n):
        x[i] = value


@kernel
def copy_entries(x: Reals1, from_x: ti.i32, y: Reals1, n: ti.i32, serial: Template):
    """Copy ``n`` entries of x, from the entry ``from_x`` on, to the beginning of y."""
    ti.loop_config(serialize=serial)
    for i in range(n):
        y[i] = x[from_x + i]


@kernel
def store_direction(z: Reals1, w: Reals1, krylov: Reals1, k: ti.i32, n: ti.i32, serial: Template):
    """Copy z to z_k, and w to v_{k+1}, which follows it."""
    ti.loop_config(serialize=serial)
    for i in range(n):
        krylov[(2 * k + 1) * n + i] = z[i]
        krylov[(2 * k + 2) * n + i] = w[i]


@kernel
def largest(x: Reals1, partial: Reals1, out: Reals1, n: ti.i32, parts: ti.i32, stride: Template, serial: Template):
    """out (2,): largest |x_i| of the first n entries, and the number of NaN; ``partial`` (2 parts,) is scratch."""
    ti.loop_config(serialize=serial)
    for t in range(parts * stride):
        first, last = part_of(t, parts, stride, n)
        value = 0.0
        bad = 0.0
        for i in range(first, last):
            value = ti.max(value, ti.abs(x[i]))
            if ti.math.isnan(x[i]):
                bad += 1.0
        if t % stride == 0:
            partial[t // stride] = value
            partial[parts + t // stride] = bad
    if ti.static(shared_by_gpu(stride, serial)):
        for first in range(folds(parts, 1)):
            for m in range(1, (parts - first + FEW_PARTS - 1) // FEW_PARTS):
                c = first + m * FEW_PARTS
                partial[first] = ti.max(partial[first], partial[c])
                partial[parts + first] = partial[parts + first] + partial[parts + c]
    ti.loop_config(serialize=True)
    for _ in range(1):
        value, bad = 0.0, 0.0
        for c in range(ti.min(parts, FEW_PARTS)):
            value = ti.max(value, partial[c])
            bad += partial[parts + c]
        out[0], out[1] = value, bad
