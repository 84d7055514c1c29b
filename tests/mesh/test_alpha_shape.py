"""tipfem/alpha_shape.py: the rule's limits, and the shapes of simplices against brute force."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import Delaunay

import tipfem as tp
from tipfem.mesh.alpha_shape import Shapes, covered, hanging
from tipfem.mesh.mesh import Mesh

DIMENSIONS = pytest.mark.parametrize("dimension", [2, 3])


def simplices(dimension: int, count: int = 40, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Random points (N, d), and their Delaunay simplices that are not nearly flat."""
    x = np.random.default_rng(seed).uniform(0, 1, (count, dimension))
    cells = Delaunay(x).simplices
    side = x[cells[:, 1:]] - x[cells[:, :1]]
    return x, cells[np.abs(np.linalg.det(side)) > 1e-4]


@DIMENSIONS
def test_the_circumscribed_sphere_goes_through_all_corners(dimension):
    x, cells = simplices(dimension)
    radius = Shapes.of(x, cells, 0.1).radius * 0.1
    for cell, r in zip(cells, radius, strict=True):
        equations = 2 * (x[cell[1:]] - x[cell[0]])
        centre = np.linalg.solve(equations, (x[cell[1:]] ** 2).sum(axis=1) - (x[cell[0]] ** 2).sum())
        np.testing.assert_allclose(np.linalg.norm(x[cell] - centre, axis=1), r, rtol=1e-6)


@DIMENSIONS
def test_heights_and_feet_are_those_of_a_projection(dimension):
    x, cells = simplices(dimension, seed=1)
    shapes = Shapes.of(x, cells, 1.0)
    apex = np.random.default_rng(2).integers(0, dimension + 1, len(cells))
    foot = shapes.foot(apex)
    np.testing.assert_allclose(foot.sum(axis=1), 1.0, atol=1e-8)
    place = np.einsum("ka,kai->ki", foot, x[cells])
    for k, cell in enumerate(cells):
        face = np.delete(cell, apex[k])
        down = x[cell[apex[k]]] - place[k]
        np.testing.assert_allclose((x[face[1:]] - x[face[0]]) @ down, 0.0, atol=1e-8)
        assert np.linalg.norm(down) == pytest.approx(shapes.height[k, apex[k]], rel=1e-6)
        assert foot[k, apex[k]] == 0


@DIMENSIONS
def test_a_point_is_covered_when_it_is_in_a_simplex_around_its_particles(dimension):
    x, cells = simplices(dimension, seed=3)
    half = Mesh(x, cells[x[cells, 0].mean(axis=1) < 0.5].astype(np.int32))
    inside = covered(x[cells].mean(axis=1), cells, half)
    np.testing.assert_array_equal(inside, x[cells, 0].mean(axis=1) < 0.5)


def test_a_mesh_without_simplices_covers_nothing():
    x = np.zeros((3, 2))
    assert not covered(x[:1], np.array([[0, 1, 2]]), Mesh(x, np.zeros((0, 3), np.int32))).any()


def test_a_drop_hangs_when_its_pressure_is_negative_and_nothing_is_below_its_surface():
    x = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, 1.0], [3.0, 0.0], [4.0, 0.0], [3.5, 1.0]])
    mesh = Mesh(x, np.array([[0, 1, 2], [3, 4, 5]], np.int32))
    pressure = np.array([-2.0, 1.0, 0.0, 2.0, -1.0, 0.0])
    none = np.zeros(6, dtype=bool)
    assert hanging(mesh, pressure, none).tolist() == [True] * 3 + [False] * 3
    assert not hanging(mesh, pressure, np.array([0, 0, 1, 0, 0, 0], dtype=bool)).any()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"alpha": 0.5}, "alpha is 0.5 spacings; it must be a number from 0.75 to 10"),
        ({"join": float("nan")}, "join is nan"),
        ({"gap": "wide"}, "gap is 'wide'"),
        ({"dry": 0.6}, "dry is 0.6"),
        ({"alpha": 2.0}, "inner is 1.8, below alpha 2"),
    ],
)
def test_a_rule_that_cannot_be_is_refused(changes, words):
    with pytest.raises(ValueError, match="SurfaceRule") as refusal:
        tp.SurfaceRule(**changes)
    assert words in str(refusal.value)
