"""The mid-edge cut: shares of the area, and where the interface runs."""

import numpy as np
import pytest
from render_results import tank
from tipfem.render.interface import fluid_regions, mesh_edges

TRIANGLE = np.array([[0.0, 0.0], [2.0, 0.3], [0.4, 1.7]])


def area(triangles):
    a, b = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    return (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2


def areas_by_fluid(regions, count):
    return np.bincount(regions.fluid, weights=area(regions.triangles), minlength=count)


@pytest.mark.parametrize("single", [0, 1, 2])
@pytest.mark.parametrize("turned", [False, True])
def test_single_particle_keeps_a_quarter(single, turned):
    fluid = np.zeros(3, int)
    fluid[single] = 1
    cells = np.array([[0, 2, 1] if turned else [0, 1, 2]])
    regions = fluid_regions(TRIANGLE, cells, fluid)
    whole = area(TRIANGLE[cells])[0]
    assert areas_by_fluid(regions, 2) == pytest.approx([0.75 * whole, 0.25 * whole])
    others = [k for k in range(3) if k != single]
    middles = (TRIANGLE[others] + TRIANGLE[single]) / 2
    assert regions.segments.shape == (1, 2, 2)
    assert np.sort(regions.segments[0], axis=0) == pytest.approx(np.sort(middles, axis=0))


def test_three_fluids_get_a_third_each():
    regions = fluid_regions(TRIANGLE, np.array([[0, 1, 2]]), np.array([2, 0, 1]))
    whole = area(TRIANGLE[None])[0]
    assert areas_by_fluid(regions, 3) == pytest.approx([whole / 3] * 3)
    assert (area(regions.triangles) > 0).all()
    assert regions.segments.shape == (3, 2, 2)
    assert regions.segments[:, 1] == pytest.approx(np.tile(TRIANGLE.mean(axis=0), (3, 1)))


def test_cut_mesh_keeps_the_area_of_the_tank():
    points, cells, fluid, _ = tank(0.0)
    fluid[(np.abs(points - 0.15) < 0.1).all(axis=1)] = 2
    regions = fluid_regions(points, cells, fluid)
    shares = np.array([(fluid[cells] == k).mean(axis=1) for k in range(3)])
    shares = np.where(np.isclose(shares, 2 / 3), 0.75, shares)
    two = np.isclose(shares, 0.75).any(axis=0)
    shares[:, two] = np.where(np.isclose(shares[:, two], 1 / 3), 0.25, shares[:, two])
    expected = shares @ np.abs(area(points[cells]))
    assert np.bincount(regions.fluid, np.abs(area(regions.triangles))) == pytest.approx(expected)
    assert expected.sum() == pytest.approx(0.25)


def test_cells_that_own_a_fluid_are_not_cut():
    points = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    cells = np.array([[0, 1, 2], [0, 2, 3]])
    regions = fluid_regions(points, cells, np.array([0, 0, 0, 1]), cell_fluid=np.array([0, 1]))
    assert len(regions.triangles) == 2
    assert regions.segments == pytest.approx(points[[[0, 2]]])


def test_edges_of_two_cells():
    edges, on_boundary = mesh_edges(np.array([[0, 1, 2], [0, 2, 3]]))
    assert edges.tolist() == [[0, 1], [0, 2], [0, 3], [1, 2], [2, 3]]
    assert on_boundary.tolist() == [True, False, True, True, True]


def test_no_cells():
    regions = fluid_regions(TRIANGLE, np.empty((0, 3), int), np.zeros(3, int))
    assert regions.triangles.shape == (0, 3, 2)
    assert regions.segments.shape == (0, 2, 2)
