"""Kernels of the block preconditioner: rows' scale, pressure Laplacian.

Vectors of unknowns are laid out as in `tipfem.assembly`.
"""

import taichi as ti

from tipfem.element import gradient, reference_gradients


@ti.kernel
def row_scale(
    cells: ti.types.ndarray(), offsets: ti.types.ndarray(), corners: ti.types.ndarray(),
    position: ti.types.ndarray(), density: ti.types.ndarray(), viscosity: ti.types.ndarray(),
    fixed: ti.types.ndarray(), pinned: ti.types.ndarray(), scale: ti.types.ndarray(),
    cm: float, cv: float, spacing: float, nodes: ti.i32, dim: ti.template(),
):  # fmt: skip
    """scale: 1 / diag(A) in the momentum rows, h / V_a in the continuity rows; 0 where u is fixed or p pinned.

    So every scaled row is a length [m]: what its residual would move its particle by.
    """
    for i in range(nodes):
        diagonal = ti.Vector.zero(float, dim)
        volume = 0.0
        for c in range(offsets[i], offsets[i + 1]):
            e = corners[c] // (dim + 1)
            big_g, area = reference_gradients(cells, e, position, dim)
            volume += area / (dim + 1)
            for a in ti.static(range(dim + 1)):
                if corners[c] % (dim + 1) == a:
                    g = gradient(big_g, a)
                    diagonal += density[e] * area / (dim + 1) * cm
                    diagonal += viscosity[e] * area * cv * (g.dot(g) + g * g)
        for k in ti.static(range(dim)):
            scale[i * (dim + 1) + k] = 0.0
            if fixed[i] == 0 and volume > 0.0:
                scale[i * (dim + 1) + k] = 1.0 / diagonal[k]
        scale[i * (dim + 1) + dim] = 0.0
        if pinned[i] == 0 and volume > 0.0:
            scale[i * (dim + 1) + dim] = spacing / volume


@ti.kernel
def pressure_laplacian(
    cells: ti.types.ndarray(), offsets: ti.types.ndarray(), corners: ti.types.ndarray(),
    position: ti.types.ndarray(), density: ti.types.ndarray(),
    scale: ti.types.ndarray(), row_offsets: ti.types.ndarray(), places: ti.types.ndarray(), values: ti.types.ndarray(),
    cm: float, nodes: ti.i32, dim: ti.template(),
):  # fmt: skip
    """P1 Laplacian sum_e A / (cm rho) g_a . g_b in CSR, the approximate pressure Schur complement.

    ``places`` as in `connectivity.list_neighbours`. Rows and columns of prescribed pressures, where ``scale`` is zero,
    are left empty.
    """
    for i in range(nodes):
        for s in range(row_offsets[i], row_offsets[i + 1]):
            values[s] = 0.0
        for c in range(offsets[i], offsets[i + 1]):
            e = corners[c] // (dim + 1)
            big_g, area = reference_gradients(cells, e, position, dim)
            own = ti.Vector.zero(float, dim)
            for a in ti.static(range(dim + 1)):
                if corners[c] % (dim + 1) == a:
                    own = gradient(big_g, a)
            for b in ti.static(range(dim + 1)):
                value = area / (cm * density[e]) * own.dot(gradient(big_g, b))
                if scale[i * (dim + 1) + dim] == 0.0 or scale[cells[e, b] * (dim + 1) + dim] == 0.0:
                    value = 0.0
                s = places[c * (dim + 1) + b]
                values[s] = values[s] + value
