"""Kernels on the vectors of Krylov's method: dots, sums, and orthogonalisation in blocks that fit into the cache.

Sums are formed in a fixed number of parts, so that they do not depend on the number of threads. Taichi makes
``a[i] += b`` an atomic operation, many times slower than ``a[i] = a[i] + b``; where no other thread writes, the latter.
"""

import taichi as ti

from tipfem.backend.launch import kernel, part_of

# Rows of a vector that are worked on at once: what of all basis vectors fits into a core's cache.
BLOCK = 512
LANES = 256  # and at once, in memory of a thread's own


@kernel
def start(
    b: ti.types.ndarray(),
    basis: ti.types.ndarray(),
    partial: ti.types.ndarray(),
    out: ti.types.ndarray(),
    n: ti.i32,
    parts: ti.i32,
    stride: ti.template(),
    serial: ti.template(),
):
    """out[0] = |b|, v_0 = b / |b| (0 if b is 0)."""
    ti.loop_config(serialize=serial)
    for t in range(parts * stride):
        first, last = part_of(t, parts, stride, n)
        total = 0.0
        for i in range(first, last):
            total += b[i] * b[i]
        if t % stride == 0:
            partial[t // stride, 0] = total
    ti.loop_config(serialize=True)
    for _ in range(1):
        total = 0.0
        for c in range(parts):
            total += partial[c, 0]
        out[0] = ti.sqrt(total)
        partial[0, 0] = ti.select(total > 0.0, 1.0 / ti.sqrt(total), 0.0)
    ti.loop_config(serialize=serial)
    for t in range(parts * stride):
        first, last = part_of(t, parts, stride, n)
        factor = partial[0, 0]
        for i in range(first, last):
            basis[i] = factor * b[i]


@ti.func
def dots(basis: ti.template(), w: ti.template(), partial: ti.template(), part, k, n, first, last):
    """Part number ``part`` of the dot products of w with v_0 ... v_k and with itself, into partial (parts, k + 2)."""
    at = part * (k + 2)
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


@ti.func
def sum_dots(partial: ti.template(), out: ti.template(), k, parts, cancelled):
    """What `orthogonalise` returns, from the parts; in place of the first part, what its last loop needs."""
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


@ti.func
def subtract(basis: ti.template(), w: ti.template(), partial: ti.template(), k, n, first, last):
    """The entries from first on of v_{k+1}: w, which becomes the same, less its components, times a factor."""
    factor = partial[k + 1]
    # In memory of our own: what writes to arrays is not turned into vector instructions.
    for block in range((last - first + LANES - 1) // LANES):
        start = first + block * LANES
        width = ti.min(LANES, last - start)
        rest = ti.Vector.zero(float, LANES)
        for i in range(width):
            rest[i] = w[start + i]
        for j in range(k + 1):
            row = j * n + start
            d = partial[j]
            for i in range(width):
                rest[i] = rest[i] - d * basis[row + i]
        row = (k + 1) * n + start
        for i in range(width):
            x = factor * rest[i]
            w[start + i] = x
            basis[row + i] = x


@kernel
def orthogonalise(
    basis: ti.types.ndarray(),
    w: ti.types.ndarray(),
    partial: ti.types.ndarray(),
    out: ti.types.ndarray(),
    k: ti.i32,
    n: ti.i32,
    cancelled: float,
    parts: ti.i32,
    stride: ti.template(),
    serial: ti.template(),
):
    """v_{k+1} = w less its components d_j along v_0 ... v_k, over the length of that; w becomes the same.

    out: d (k + 1,), |w|^2, and |w|^2 - |d|^2, which is the length squared of what is left. Where that is less than
    the part ``cancelled`` of |w|^2, it is left as long as it is, for another pass.
    """
    ti.loop_config(serialize=serial)
    for t in range(parts * stride):
        first, last = part_of(t, parts, stride, n)
        if t % stride == 0:
            dots(basis, w, partial, t // stride, k, n, first, last)
    ti.loop_config(serialize=True)
    for _ in range(1):
        sum_dots(partial, out, k, parts, cancelled)
    ti.loop_config(serialize=serial)
    for t in range(parts * stride):
        first, last = part_of(t, parts, stride, n)
        subtract(basis, w, partial, k, n, first, last)


@kernel
def combine(
    directions: ti.types.ndarray(),
    weights: ti.types.ndarray(),
    x: ti.types.ndarray(),
    k: ti.i32,
    n: ti.i32,
    parts: ti.i32,
    stride: ti.template(),
    serial: ti.template(),
):
    """x = sum of weights[j] z_j over the ``k`` directions."""
    ti.loop_config(serialize=serial)
    for t in range(parts * stride):
        first, last = part_of(t, parts, stride, n)
        for block in range((last - first + BLOCK - 1) // BLOCK):
            start = first + block * BLOCK
            end = ti.min(start + BLOCK, last)
            for i in range(start, end):
                x[i] = 0.0
            for j in range(k):
                d = weights[j]
                for i in range(start, end):
                    x[i] = x[i] + d * directions[j * n + i]


@kernel
def fill(
    x: ti.types.ndarray(),
    value: float,
    n: ti.i32,
    serial: ti.template(),
):
    """x_i = value for the first n entries."""
    ti.loop_config(serialize=serial)
    for i in range(n):
        x[i] = value


@kernel
def move(
    x: ti.types.ndarray(),
    from_x: ti.i32,
    y: ti.types.ndarray(),
    from_y: ti.i32,
    n: ti.i32,
    serial: ti.template(),
):
    """Copy ``n`` entries of x into y, from an entry of each on."""
    ti.loop_config(serialize=serial)
    for i in range(n):
        y[from_y + i] = x[from_x + i]


@kernel
def add(
    x: ti.types.ndarray(),
    y: ti.types.ndarray(),
    factor: float,
    n: ti.i32,
    serial: ti.template(),
):
    """y += factor x over the first ``n`` entries."""
    ti.loop_config(serialize=serial)
    for i in range(n):
        y[i] = y[i] + factor * x[i]


@kernel
def largest(
    x: ti.types.ndarray(),
    partial: ti.types.ndarray(),
    out: ti.types.ndarray(),
    n: ti.i32,
    parts: ti.i32,
    stride: ti.template(),
    serial: ti.template(),
):
    """out: largest |x_i| of the first n entries, and how many of them are no numbers; ``out`` starts at zero."""
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
            partial[t // stride, 0] = value
            partial[t // stride, 1] = bad
    ti.loop_config(serialize=True)
    for c in range(parts):
        out[0] = ti.max(out[0], partial[c, 0])
        out[1] += partial[c, 1]
