"""Kernels of the block preconditioner: rows' scale, off-diagonal blocks, pressure Laplacian.

Vectors of unknowns and element records are laid out as in `tipfem.assembly`.
"""

import taichi as ti

from tipfem.assembly import gathered, get_matrix, unknown
from tipfem.element import gradient, reference_gradients


@ti.kernel
def schur_right_side(
    cells: ti.types.ndarray(), offsets: ti.types.ndarray(), corners: ti.types.ndarray(),
    record: ti.types.ndarray(), scale: ti.types.ndarray(), r: ti.types.ndarray(),
    local: ti.types.ndarray(), out: ti.types.ndarray(),
    cm: float, elements: ti.i32, nodes: ti.i32, dim: ti.template(),
):  # fmt: skip
    """out (N,) = r_p - D z_u with z_u = diag(A)^-1 r_u, from the scaled residual ``r``.

    Scaled by 1 / diag(A), the momentum rows of r are z_u already.
    """
    for e in range(elements):
        g_now = get_matrix(record, e, 0, dim)
        c_next = get_matrix(record, e, ti.static(dim * dim), dim)
        tail = ti.static(4 * dim * dim + 2 * dim)
        mean_u = ti.Vector.zero(float, dim)
        growth = 0.0
        for a in ti.static(range(dim + 1)):
            u = unknown(r, cells[e, a], dim)
            mean_u += u / (dim + 1)
            growth += gradient(c_next, a).dot(u)
        for a in ti.static(range(dim + 1)):
            stabilisation = record[e, tail + 2] * cm * gradient(g_now, a).dot(mean_u)
            local[e * (dim + 1) + a, dim] = record[e, tail + 1] / (dim + 1) * growth + stabilisation
    for i in range(nodes):
        p = i * (dim + 1) + dim
        out[i] = 0.0
        if scale[p] > 0.0:  # not where pressure is prescribed
            out[i] = r[p] / scale[p] - gathered(local, corners, offsets[i], offsets[i + 1], dim, dim + 1)


@ti.kernel
def pressure_correction(
    cells: ti.types.ndarray(), offsets: ti.types.ndarray(), corners: ti.types.ndarray(),
    record: ti.types.ndarray(), scale: ti.types.ndarray(), r: ti.types.ndarray(),
    pressure: ti.types.ndarray(), local: ti.types.ndarray(), out: ti.types.ndarray(),
    elements: ti.i32, nodes: ti.i32, dim: ti.template(),
):  # fmt: skip
    """out = (z_u + diag(A)^-1 G z_p, z_p), with z_u = r_u the scaled momentum rows and z_p (N,)."""
    for e in range(elements):
        g_now = get_matrix(record, e, 0, dim)
        mean = 0.0
        for b in ti.static(range(dim + 1)):
            j = cells[e, b]
            mean += ti.select(scale[j * (dim + 1) + dim] > 0.0, pressure[j], 0.0) / (dim + 1)
        mean *= record[e, ti.static(4 * dim * dim + 2 * dim)]
        for a in ti.static(range(dim + 1)):
            g = gradient(g_now, a)
            for k in ti.static(range(dim)):
                local[e * (dim + 1) + a, k] = mean * g[k]
    for i in range(nodes):
        for k in ti.static(range(dim)):
            row = i * (dim + 1) + k
            out[row] = r[row] + scale[row] * gathered(local, corners, offsets[i], offsets[i + 1], k, dim + 1)
        p = i * (dim + 1) + dim
        out[p] = ti.select(scale[p] > 0.0, pressure[i], 0.0)


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
    scale: ti.types.ndarray(),
    row_offsets: ti.types.ndarray(), columns: ti.types.ndarray(), values: ti.types.ndarray(),
    cm: float, nodes: ti.i32, dim: ti.template(),
):  # fmt: skip
    """P1 Laplacian sum_e A / (cm rho) g_a . g_b in CSR, the approximate pressure Schur complement.

    Rows and columns of prescribed pressures, where ``scale`` is zero, are left empty.
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
                s = row_offsets[i]
                while columns[s] != cells[e, b]:
                    s += 1
                values[s] += value
