"""Meshes whose first axis is periodic."""

import numpy as np
import pytest

from tipfem.errors import TriangulationError
from tipfem.geometry.period import Period
from tipfem.mesh.delaunay import triangulate
from tipfem.mesh.mesh import simplex_measure
from tipfem.probes.points import locate

PERIOD = Period(np.array([1.0, 0.0]))
H = 0.08


def cloud(seed, *, lattice=False):
    """Particles between walls at y = 0 and y = 0.5, on a lattice or at random."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(12) / 12, np.linspace(0, 0.5, 7), indexing="ij")
    position = np.stack([x.ravel(), y.ravel()], axis=1)
    wall = np.isin(position[:, 1], [0.0, 0.5])
    if not lattice:
        position += rng.uniform(-0.025, 0.025, position.shape) * [1.0, 1.0] * np.where(wall, 0.0, 1.0)[:, None]
        position[wall, 0] += rng.uniform(-0.02, 0.02, wall.sum())
    return PERIOD.wrapped(position), wall


def as_set(cells):
    return {tuple(sorted(cell)) for cell in cells.tolist()}


@pytest.mark.parametrize("lattice", [True, False])
def test_the_triangles_fill_the_domain_once_and_meet_edge_to_edge(lattice):
    for seed in range(1 if lattice else 10):
        position, wall = cloud(seed, lattice=lattice)
        mesh = triangulate(position, wall, H, period=PERIOD)
        assert (mesh.measure > 0).all()
        np.testing.assert_allclose(mesh.measure.sum(), 0.5, rtol=1e-13)
        # Euler's formula on a ring: V - E + F = 0; only edges along the walls have one triangle.
        assert len(position) - len(mesh.edges) + len(mesh.cells) == 0
        cell, i = np.nonzero(mesh.neighbours < 0)
        assert len(cell) == wall.sum()
        assert wall[mesh.cells[cell, (i + 1) % 3]].all()


def test_the_mesh_does_not_depend_on_where_the_ends_are():
    for seed in range(5):
        position, wall = cloud(seed, lattice=seed == 0)
        mesh = triangulate(position, wall, H, period=PERIOD)
        for shift in (0.1, 0.5, 0.93):
            moved = PERIOD.wrapped(position + [shift, 0.0])
            other = triangulate(moved, wall, H, period=PERIOD)
            assert as_set(other.cells) == as_set(mesh.cells)
            np.testing.assert_allclose(other.measure.sum(), mesh.measure.sum(), rtol=1e-13)


def test_a_mesh_on_a_torus_is_closed_and_does_not_depend_on_where_the_ends_are():
    period = Period(np.array([1.0, 0.8]))
    x, y = np.meshgrid(np.arange(12) / 12, np.arange(10) * 0.08, indexing="ij")
    lattice = np.stack([x.ravel(), y.ravel()], axis=1)
    wall = np.zeros(len(lattice), dtype=bool)
    for seed, shaken in ((0, 0.0), (1, 0.03), (2, 0.03)):
        position = lattice + np.random.default_rng(seed).uniform(-shaken, shaken, lattice.shape)
        mesh = triangulate(period.wrapped(position), wall, H, period=period)
        assert (mesh.measure > 0).all()
        np.testing.assert_allclose(mesh.measure.sum(), 0.8, rtol=1e-13)
        assert len(position) - len(mesh.edges) + len(mesh.cells) == 0  # Euler's formula on a torus
        assert (mesh.neighbours >= 0).all()
        whole, node = mesh.unrolled
        assert np.ptp(whole.position[whole.cells], axis=1).max() < 3 * H
        np.testing.assert_array_equal(node[whole.cells], mesh.cells)
        other = triangulate(period.wrapped(position + [0.41, 0.77]), wall, H, period=period)
        assert as_set(other.cells) == as_set(mesh.cells)


def test_a_domain_that_is_not_filled_is_refused():
    position, _ = cloud(0)
    keep = (position[:, 0] < 0.2) | (position[:, 0] > 0.9)
    with pytest.raises(TriangulationError):
        triangulate(position[keep], np.zeros(keep.sum(), dtype=bool), H, period=Period(np.array([5.0, 0])))


def test_an_unrolled_mesh_has_the_same_cells_and_none_that_is_stretched():
    position, wall = cloud(3)
    mesh = triangulate(position, wall, H, period=PERIOD)
    whole, node = mesh.unrolled
    assert len(whole.cells) == len(mesh.cells)
    np.testing.assert_array_equal(node[whole.cells], mesh.cells)
    np.testing.assert_allclose(simplex_measure(whole.position, whole.cells), mesh.measure, rtol=1e-12)
    assert np.ptp(whole.position[whole.cells], axis=1).max() < 3 * H
    middle = whole.position[whole.cells].mean(axis=1)[:, 0]
    assert ((middle >= 0) & (middle < 1.0)).all()
    np.testing.assert_allclose(PERIOD.wrapped(whole.position + 1e-12), PERIOD.wrapped(position[node] + 1e-12))


def test_every_place_is_found_in_a_cell():
    position, wall = cloud(1)
    mesh = triangulate(position, wall, H, period=PERIOD)
    places = np.stack([np.linspace(0, 1, 41), np.linspace(0.01, 0.49, 41)], axis=1)
    cell, weights = locate(mesh, places)
    assert (cell >= 0).all()
    found = np.einsum("kc,kci->ki", weights, mesh.corners(cell))
    np.testing.assert_allclose(PERIOD.shortest(found - places), 0.0, atol=1e-13)
