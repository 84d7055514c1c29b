"""The mass matrix: against integrals of the shape functions, and sums in NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from mesh_twins import nodal_mass

import tipfem as tp
from tipfem.backend.arrays import partials
from tipfem.backend.launch import launch
from tipfem.fem import mass
from tipfem.mesh.delaunay import triangulate


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_consistent_part_integrates_products_of_linear_functions(dimension):
    """int f^2 over a simplex for linear f, by points of a rule that is exact for it."""
    value = np.random.default_rng(1).uniform(-1, 1, dimension + 1)
    part = mass.consistent_part(dimension)
    found = part * (value**2).mean() + (1 - part) * value.mean() ** 2
    # A. Hammer & A. Stroud, 1956: of second order in d dimensions.
    a = 1 / np.sqrt(dimension + 2)
    points = a * np.eye(dimension + 1) + (1 - a) / (dimension + 1)
    assert found == pytest.approx(((points @ value) ** 2).mean(), rel=1e-13)


@pytest.mark.parametrize("size", [(1.0, 0.8), (0.6, 0.6, 0.6)], ids=["2-D", "3-D"])
def test_products_by_the_matrix(size):
    """a^T M b from the lumped masses less the deviation: that of the assembled matrix."""
    tp.init()
    d, spacing = len(size), 0.1 if len(size) == 2 else 0.2
    water = tp.Fluid("water", density=1000.0, viscosity=1e-3)
    particles = tp.tank(size, spacing, jitter=0.2, seed=3).fill(water).sample([water])
    mesh = triangulate(particles.position, particles.wall, spacing)
    rng = np.random.default_rng(2)
    density = rng.uniform(1, 1000, len(mesh.cells))
    a, b = rng.standard_normal((2, len(particles), d))
    factor = density * mesh.measure / ((d + 1) * (d + 2))
    matrix = np.zeros((len(particles),) * 2)
    for row in range(d + 1):
        for column in range(d + 1):
            np.add.at(matrix, (mesh.cells[:, row], mesh.cells[:, column]), factor * (1 + (row == column)))
    expected = np.einsum("ik,ij,jk", a, matrix, b)
    lumping = mass.lumped_part("consistent", mesh.cells, np.ones((len(density), 1)), len(particles))
    for work in (1.0, 1e6):
        result = np.zeros(1)
        launch(
            mass.deviation,
            np.ascontiguousarray(mesh.cells),
            mesh.position,
            mesh.period.array,
            mass.Masses(density, mesh.measure, lumping),
            a,
            b,
            partials(1),
            result,
            d,
            work=(len(density), work),
        )
        found = nodal_mass(mesh, density) @ (a * b).sum(axis=1) - result[0]
        assert found == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("dimension", [2, 3])
def test_kinds_of_mass_matrix(dimension):
    """Cells that touch an interface in a particle are at it; those of mixed fluids too."""
    cells = np.arange(dimension + 1) + np.arange(7)[:, None]  # a chain, in which cells k and k + 1 share all but two
    fraction = np.repeat([[1.0, 0.0], [0.0, 1.0]], [6, 1], axis=0)
    count = cells.max() + 1
    part = 1 / (dimension + 2)
    assert (mass.lumped_part("lumped", cells, fraction, count) == 1).all()
    assert (mass.lumped_part("consistent", cells, fraction, count) == part).all()
    found = mass.lumped_part("interfaces", cells, fraction, count)
    shared = set(cells[6]) & set(cells[:6].ravel())
    np.testing.assert_array_equal(found < 1, [bool(shared & set(c)) for c in cells])
    assert (found[found < 1] == part).all()
    mixed = np.full((7, 2), 0.5)
    assert (mass.lumped_part("interfaces", cells, mixed, count) == part).all()


def test_lumped_products_are_those_of_all_particles():
    rng = np.random.default_rng(1)
    for count, d in ((1, 2), (40, 3), (9000, 2)):
        lumped, a, b = rng.random(count), *rng.normal(size=(2, count, d))
        assert mass.product(lumped, a, b) == pytest.approx((lumped[:, None] * a * b).sum(), rel=1e-11)
