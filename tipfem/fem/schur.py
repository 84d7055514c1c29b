"""Kernel of the block preconditioner: scaling of the rows, and pressure Laplacian.

Vectors of unknowns are laid out as in `tipfem.fem.residual`.
"""

from typing import NamedTuple

import taichi as ti

from tipfem.backend.array_types import Ints1, Ints2, Periods, Reals1, Reals2, Template
from tipfem.backend.launch import kernel
from tipfem.backend.periodic import difference, radius
from tipfem.backend.real_functions import cube_root
from tipfem.fem.bundles import Elements, Rates, Sizes, Topology
from tipfem.fem.element import gradient, mean_with
from tipfem.linalg.sparsity import Csr, corner_after

LAPLACIAN_ROW = 80.0  # nanoseconds of one thread for a particle in `scale_and_laplacian`
GROUND = 10.0  # and in `add_grounds`
# The Schur complement is 0.54 to 0.99 of the Laplacian with the time integration's cm (stabilisation 0.25). A factor
# near the middle of that range saves a twentieth of the Krylov iterations.
SCHUR_SCALE = 1.3
# Columns of ``held`` (N, 2), which is not zero where an unknown is prescribed.
DISPLACEMENT, PRESSURE = 0, 1


class Pattern(NamedTuple):
    """Neighbours with gaps and their places, see `sparsity.find_neighbours`."""

    padded: "Ints1"
    slots: "Ints1"


class Diagonals(NamedTuple):
    """Results at the diagonal, see `scale_and_laplacian`."""

    scale: "Reals1"  # (P (d + 1),)
    viscous: "Reals1"  # (P,)


class Factors(NamedTuple):
    """Numbers in `scale_and_laplacian`."""

    schur: "float"  # of the inertial part
    floor: "float"  # what the floor of the stabilisation's tau adds to it [s^2]
    spacing: "float"  # [m]


@ti.func
def gradients_from(cells: ti.template(), e, own, position: ti.template(), period: ti.template(), dim: ti.template()):
    """As `element.reference_gradients`, but shape function 0 is that of corner ``own``; the measure is positive."""
    side = ti.Matrix.zero(float, dim, dim)
    for a in ti.static(range(dim)):
        corner = cells[e, corner_after(own, ti.static(a + 1), dim)]
        for k in ti.static(range(dim)):
            side[k, a] = difference(position, period, corner, cells[e, own], k)
    return side.inverse(), ti.abs(side.determinant()) / (2.0 if ti.static(dim == 2) else 6.0)


@kernel
def scale_and_laplacian(
    mesh: Topology,
    position: Reals2,
    period: Periods,
    element: Elements,
    held: Ints2,
    pattern: Pattern,
    matrix: Csr,
    scales: Diagonals,
    rates: Rates,
    factors: Factors,
    sizes: Sizes,
    serial: Template,
):
    """The scaling of the rows, and the approximate pressure Schur complement: its inertial and its viscous part.

    scale: 1 / diag(A) in the momentum rows, h / V_a in the continuity rows; 0 where u or p is held. So every
    scaled residual is a length [m]: the displacement that would remove it.

    values: P1 Laplacian sum_e A / rho (1 / (s cm) + t) g_a . g_b with s = ``schur``; t is what a ``floor`` [s^2] adds
    to the tau of the stabilisation, less where viscosity limits it; rows and columns of held pressures are
    left empty. ``columns`` are those of ``padded`` without the gaps, see `sparsity.find_neighbours`.

    viscous (N,): cv / sum_e A / ((d + 1) mu), by which the Schur complement of viscosity alone is inverted; 0 at fluids
    without any. The inverse of both parts is near the sum of their inverses (J. Cahouet & J.-P. Chabard, International
    Journal for Numerical Methods in Fluids 8, 1988).
    """
    cm, cv = ti.static((rates.cm, rates.cv))
    nodes, dim, floor = ti.static((sizes.nodes, sizes.dim, factors.floor))
    ti.loop_config(serialize=serial)
    for i in range(nodes):
        first = matrix.row_offsets[i]
        start = dim * mesh.offsets[i] + i - first
        for s in range(first, matrix.row_offsets[i + 1]):
            matrix.columns[s] = pattern.padded[start + s]
            matrix.values[s] = 0.0
        diagonal = ti.Vector.zero(float, dim)
        volume, total, fluidity, least = 0.0, 0.0, 0.0, 1.0
        for c in range(mesh.offsets[i], mesh.offsets[i + 1]):
            e = mesh.corners[c] // (dim + 1)
            big_g, area = gradients_from(mesh.cells, e, mesh.corners[c] - e * (dim + 1), position, period, dim)
            least = ti.min(least, element.viscosity[e])
            g = gradient(big_g, 0)
            ring, share, mass = area, area / (dim + 1), element.density[e] * area / (dim + 1)
            if ti.static(len(period.shape) == 3):
                radii = ti.Vector.zero(float, dim + 1)
                for a in ti.static(range(dim + 1)):
                    radii[a] = radius(
                        position, period, mesh.cells[e, corner_after(mesh.corners[c] - e * (dim + 1), a, dim)]
                    )
                ring, share = area * radii.sum() / 3.0, area * mean_with(radii, 0)
                mass = element.density[e] * share
                hoop = 2.0 / 9.0 * (2.0 * ti.math.pi) ** 2 * 3.0 / radii.sum()
                diagonal[0] += element.viscosity[e] * area * cv * hoop
            volume += share
            fluidity += share / ti.max(element.viscosity[e], 1e-300)
            diagonal += mass * cm
            diagonal += element.viscosity[e] * ring * cv * (g.dot(g) + g * g)
            added = 0.0
            if floor > 0.0:
                # The viscous time is that of `stabilisation_time`, with cv / cm for dt.
                length2 = 4.0 / ti.math.pi * area
                if ti.static(dim == 3):
                    length2 = cube_root(6.0 / ti.math.pi * area) ** 2
                added = floor / (1.0 + floor * 12.0 * element.viscosity[e] / (element.density[e] * length2) * cm / cv)
            stiffness = ring / (factors.schur * cm * element.density[e]) + ring * added / element.density[e]
            for other in ti.static(range(1, dim + 1)):
                value = stiffness * g.dot(gradient(big_g, other))
                total -= value
                s = first + pattern.slots[c * dim + other - 1]
                matrix.values[s] = matrix.values[s] + value
        matrix.values[first] = total
        scales.viscous[i] = ti.select(least > 0.0 and fluidity > 0.0, cv / ti.max(fluidity, 1e-300), 0.0)
        is_pinned = held[i, PRESSURE] != 0
        for s in range(first, matrix.row_offsets[i + 1]):
            if is_pinned or held[matrix.columns[s], PRESSURE] != 0:
                matrix.values[s] = 0.0
        for k in ti.static(range(dim)):
            scales.scale[i * (dim + 1) + k] = 0.0
            if held[i, DISPLACEMENT] == 0 and volume > 0.0:
                scales.scale[i * (dim + 1) + k] = 1.0 / diagonal[k]
        scales.scale[i * (dim + 1) + dim] = 0.0
        if not is_pinned and volume > 0.0:
            scales.scale[i * (dim + 1) + dim] = factors.spacing / volume


@kernel
def add_grounds(
    particles: Ints1,
    gradient: Reals2,
    scale: Reals1,
    row_offsets: Ints1,
    values: Reals1,
    schur: float,
    count: ti.i32,
    dim: Template,
    serial: Template,
):
    """Add to the diagonal of the Laplacian what the free surface does to the pressure of its particles.

    There the particles' displacements change the volume of the fluid, by V' = ``gradient`` (K, d) of the particles
    (K,), and pressure one displacement: V' diag(A)^-1 V' / s, a spring between the pressure and that outside.
    """
    ti.loop_config(serialize=serial)
    for n in range(count):
        i = particles[n]
        stiffness = 0.0
        for k in ti.static(range(dim)):
            stiffness += gradient[n, k] ** 2 * scale[i * (dim + 1) + k]
        if scale[i * (dim + 1) + dim] > 0.0:
            values[row_offsets[i]] = values[row_offsets[i]] + stiffness / schur
