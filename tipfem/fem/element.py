"""Element mathematics of one linear simplex, as Taichi functions, in 2-D and 3-D.

Notation: G_a reference gradients of the shape functions, F the deformation from the last step's
positions to the intermediate ones, g_a = F^-T G_a, J = det F, H = sum_a u_a (x) G_a.
"""

import taichi as ti

from tipfem.backend.periodic import difference, radius
from tipfem.backend.real_functions import cube_root


@ti.func
def area_of(x: ti.template(), cells: ti.template(), period: ti.template(), t):
    """Signed measure of triangle ``t``, bitwise that of `mesh.simplex_measure`: area, or volume of its ring."""
    a, b, c = cells[t, 0], cells[t, 1], cells[t, 2]
    bx, by = difference(x, period, b, a, 0), difference(x, period, b, a, 1)
    cx, cy = difference(x, period, c, a, 0), difference(x, period, c, a, 1)
    area = 0.5 * (bx * cy - cx * by)
    if ti.static(len(period.shape) == 3):
        area *= (radius(x, period, a) + radius(x, period, b) + radius(x, period, c)) / 3.0
    return area


@ti.func
def measure_of(x: ti.template(), cells: ti.template(), t, dim: ti.template()):
    """Measure of cell t."""
    side = ti.Matrix.zero(ti.f64, dim, dim)
    for k in ti.static(range(dim)):
        for a in ti.static(range(dim)):
            side[k, a] = x[cells[t, k + 1], a] - x[cells[t, 0], a]
    return side.determinant() / ti.static(2.0 if dim == 2 else 6.0)


@ti.func
def mean_with(values, a: ti.template()):
    """Mean over a triangle of a linear function, given at its corners, times shape function ``a``."""
    return (values[a] + values.sum()) / 12.0


@ti.func
def parts_of(whole, x: ti.template(), cells: ti.template(), period: ti.template(), t):
    """The part of ``whole`` that belongs to each corner of triangle ``t``: by the mean of its shape function."""
    part = whole / 3.0
    result = ti.Vector([part, part, part])
    if ti.static(len(period.shape) == 3):
        for a in ti.static(range(3)):
            result[a] = radius(x, period, cells[t, a])
        total = result.sum()
        for a in ti.static(range(3)):
            result[a] = 0.25 * whole * (result[a] / total + 1.0)
    return result


@ti.func
def row(array: ti.template(), i, dim: ti.template()):
    """Vector (dim,) from the first ``dim`` entries of row ``i`` of an array."""
    return ti.Vector([array[i, k] for k in ti.static(range(dim))])


@ti.func
def reference_gradients(cells: ti.template(), e, position: ti.template(), period: ti.template(), dim: ti.template()):
    """Gradients G_1 ... G_d as the rows of a matrix, and the measure A; G_0 is minus their sum."""
    side = ti.Matrix.zero(float, dim, dim)
    for a in ti.static(range(dim)):
        for k in ti.static(range(dim)):
            side[k, a] = difference(position, period, cells[e, a + 1], cells[e, 0], k)
    measure = side.determinant() / (2.0 if ti.static(dim == 2) else 6.0)
    return side.inverse(), measure


@ti.func
def gradient(rows, a: ti.template()):
    """Gradient of shape function ``a`` (0 ... d) from the matrix of gradients 1 ... d."""
    dim = ti.static(rows.n)
    result = ti.Vector.zero(float, dim)
    if ti.static(a == 0):
        for k in ti.static(range(dim)):
            for b in ti.static(range(dim)):
                result[k] -= rows[b, k]
    else:
        for k in ti.static(range(dim)):
            result[k] = rows[ti.static(a - 1), k]
    return result


@ti.func
def volume_change(h):
    """det(I + H) - 1, without the cancellation of computing the determinant first."""
    result = h.trace()
    if ti.static(h.n == 2):
        result += h.determinant()
    else:
        t = h.trace()
        result += 0.5 * (t * t - (h @ h).trace()) + h.determinant()
    return result


@ti.func
def volume_ratio(cells: ti.template(), e, position: ti.template(), period: ti.template(), motion, dim: ti.template()):
    """J = det(I + H) of an element whose corners move by the rows of ``motion`` (dim + 1, dim)."""
    big_g, _area = reference_gradients(cells, e, position, period, dim)
    h = ti.Matrix.zero(float, dim, dim)
    for a in ti.static(range(dim + 1)):
        corner = ti.Vector([motion[a, k] for k in ti.static(range(dim))])
        h += corner.outer_product(gradient(big_g, a))
    return 1.0 + volume_change(h)


@ti.func
def cofactor(f):
    """J F^-T, for any F, invertible or not."""
    result = ti.Matrix.zero(float, f.n, f.n)
    if ti.static(f.n == 2):
        result = ti.Matrix([[f[1, 1], -f[1, 0]], [-f[0, 1], f[0, 0]]])
    else:
        for i in ti.static(range(3)):
            for j in ti.static(range(3)):
                result[i, j] = (
                    f[(i + 1) % 3, (j + 1) % 3] * f[(i + 2) % 3, (j + 2) % 3]
                    - f[(i + 1) % 3, (j + 2) % 3] * f[(i + 2) % 3, (j + 1) % 3]
                )
    return result


@ti.func
def cauchy_stress(velocity_gradient, pressure, viscosity):
    """sigma = mu (l + l^T) - p I, the push-forward of S = D:Edot - p J C^-1 (Carvalho & Sanches, eqs. 3-4)."""
    sigma = viscosity * (velocity_gradient + velocity_gradient.transpose())
    for k in ti.static(range(velocity_gradient.n)):
        sigma[k, k] -= pressure
    return sigma


@ti.func
def stabilisation_time(measure, density, viscosity, dt, factor, dim: ti.template()):
    """tau [s^2] of the PSPG term for the constraint J = 1.

    tau = dt / sqrt((1 / (c dt))^2 + (12 nu / h^2)^2) with c = ``factor``: c dt^2 where inertia dominates, dt times the
    viscous time of Tezduyar (1992) where viscosity dominates. h is the diameter of the circle (ball) of
    the element's measure. The constraint is J - 1, about dt div v; hence the factor dt.
    """
    length2 = 4.0 / ti.math.pi * measure
    if ti.static(dim == 3):
        length2 = cube_root(6.0 / ti.math.pi * measure) ** 2
    inertial = 1.0 / (factor * dt)
    viscous = 12.0 * viscosity / (density * length2)
    return dt / ti.sqrt(inertial * inertial + viscous * viscous)
