"""The sign of the two terms of the continuity equation: only equal ones make the pressure's block dissipative.

Carvalho & Sanches, eq. 6, is printed with a minus before the Galerkin term and a plus before the stabilisation.
Print the figures by `pytest tests/test_pressure_sign.py -s`.
"""

from __future__ import annotations

import numpy as np
import numpy_twin as twin
import pytest

import tipfem as tp
from tipfem.mesh.delaunay import triangulate

DT = 1e-3
CELLS = 10
GRAVITY = (0.0, -9.81)


def blocks(densities, stabilisation, rho_inf=0.0):
    """Derivatives at rest of momentum by displacement and pressure, and of continuity by both, walls' rows left out;
    and the mesh's Laplacian of 1 / rho."""
    fluids = [tp.Fluid(str(k), density=rho, viscosity=1e-12) for k, rho in enumerate(densities)]
    tank = tp.tank((1.0, 1.0), 1 / CELLS, jitter=0.2).fill(fluids[0]).fill(fluids[-1], box=((0, 0), (1, 0.5)))
    particles = tank.sample(fluids)
    mesh = triangulate(particles.position, particles.wall, particles.spacing)
    density = np.array([f.density for f in fluids])[particles.fluid[mesh.cells]].mean(axis=1)
    n, zero = len(particles), np.zeros_like(particles.position)
    step = twin.Step(
        mesh.position,
        mesh.cells,
        particles.wall,
        zero,
        zero,
        np.tile(GRAVITY, (n, 1)),
        density,
        1e-12 + 0 * density,
        0 * density,
        twin.Alpha(rho_inf, DT),
        stabilisation,
        particles.spacing,
    )
    eps = 1e-7

    def column(du, dp):
        forward, backward = (twin.residual(step, s * eps * du, s * dp)[0] for s in (1, -1))
        return (forward - backward) / 2

    free = np.flatnonzero(~particles.wall)
    by_u = np.zeros((n, 3, len(free), 2))
    for number, i in enumerate(free):
        for k in range(2):
            du = zero.copy()
            du[i, k] = 1.0
            by_u[:, :, number, k] = column(du, np.zeros(n)) / eps
    by_p = np.stack([column(zero, np.eye(n)[i]) for i in range(n)], axis=2)
    momentum_u = by_u[free, :2].reshape(2 * len(free), -1)
    momentum_p = by_p[free, :2].reshape(2 * len(free), n)
    gradient, area = twin.reference_gradients(mesh.position, mesh.cells)
    laplacian = np.zeros((n, n))
    for cell, g, a, rho in zip(mesh.cells, gradient, area, density, strict=True):
        laplacian[np.ix_(cell, cell)] += a / rho * g @ g.T
    return momentum_u, momentum_p, by_u[:, 2].reshape(n, -1), by_p[:, 2], laplacian


def spectrum(momentum_u, momentum_p, continuity_u, continuity_p, laplacian):
    """Real parts of the Schur complement's eigenvalues relative to dt^2 times the Laplacian, the constant left out."""
    schur = continuity_p - continuity_u @ np.linalg.solve(momentum_u, momentum_p)
    # Pressures with mean zero: the constant is in the null space of both.
    n = len(laplacian)
    basis = np.linalg.qr(np.concatenate([np.ones((n, 1)), np.eye(n)[:, 1:]], axis=1))[0][:, 1:]
    values = np.linalg.eigvals(np.linalg.solve(DT**2 * basis.T @ laplacian @ basis, basis.T @ schur @ basis))
    return np.sort(values.real)


@pytest.mark.slow
@pytest.mark.parametrize("densities", [(1.204, 998.2), (998.2, 1261.0)])
def test_equal_signs_make_the_pressure_dissipative(densities):
    """All modes of the pressure are damped with equal signs; with those printed a quarter of them are excited."""
    one, two = (blocks(densities, c) for c in (0.25, 0.5))
    momentum, laplacian = one[:2], one[4]
    # tau = c dt^2 where inertia rules, so that both terms follow from two values of c.
    galerkin = [2 * a - b for a, b in zip(one[2:4], two[2:4], strict=True)]
    stabilisation = [b - a for a, b in zip(one[2:4], two[2:4], strict=True)]
    equal = spectrum(*momentum, *(g + s for g, s in zip(galerkin, stabilisation, strict=True)), laplacian)
    printed = spectrum(*momentum, *(s - g for g, s in zip(galerkin, stabilisation, strict=True)), laplacian)
    alone = spectrum(*momentum, *galerkin, laplacian)
    for name, values in (("equal signs", equal), ("as printed", printed), ("Galerkin term alone", alone)):
        print(f"\n{densities}, {name}: {values[0]:.3g} to {values[-1]:.3g}, {np.mean(values < 0):.0%} negative")
    assert equal[0] > 0.1
    assert printed[0] < -0.3
    assert np.mean(printed < 0) > 0.2
    assert abs(alone[0]) < 0.02  # checkerboards: without stabilisation nothing holds them
