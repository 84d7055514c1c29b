"""Kernel that looks ahead: what a step at the present speeds would make of the elements."""

import taichi as ti

from tipfem.backend.launch import kernel, part_of
from tipfem.fem.element import gradient, reference_gradients, row, volume_change


@kernel
def smallest_jacobian(
    cells: ti.types.ndarray(),
    position: ti.types.ndarray(),
    velocity: ti.types.ndarray(),
    partial: ti.types.ndarray(),
    result: ti.types.ndarray(),
    dt: float,
    elements: ti.i32,
    dim: ti.template(),
    parts: ti.i32,
    stride: ti.template(),
):
    """result[0]: the smallest J = det(I + dt grad v) of an element, or what was there if that is smaller."""
    for t in range(parts * stride):
        smallest = 1e30
        first, last = part_of(t, parts, stride, elements)
        for e in range(first, last):
            big_g, _area = reference_gradients(cells, e, position, dim)
            h = ti.Matrix.zero(float, dim, dim)
            for a in ti.static(range(dim + 1)):
                h += (dt * row(velocity, cells[e, a], dim)).outer_product(gradient(big_g, a))
            smallest = ti.min(smallest, 1.0 + volume_change(h))
        if t % stride == 0:
            partial[t // stride] = smallest
    ti.loop_config(serialize=True)
    for c in range(parts):
        result[0] = ti.min(result[0], partial[c])
