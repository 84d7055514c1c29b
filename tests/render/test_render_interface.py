"""The mid-edge cut and the edges between cells of two fluids: areas, and where the interface runs."""

import numpy as np
import pytest
from render_results import sharp_tank, tank
from scipy.spatial import Delaunay
from tipfem.render.interface import areas, cell_edges, edge_means, fluid_regions, outer_sides, particle_fluids

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


def test_cells_keep_their_fluid_whatever_their_particles_carry():
    points, cells, fluid, cell_fluid, _ = sharp_tank(0.0)
    assert (fluid[cells] == 0).all(axis=1)[cell_fluid == 1].any()  # the bubble, which its particles do not show
    regions = fluid_regions(points, cells, fluid, cell_fluid)
    expected = np.bincount(cell_fluid, np.abs(area(points[cells])))
    assert np.bincount(regions.fluid, np.abs(area(regions.triangles))) == pytest.approx(expected)
    assert (regions.fluid[:, None] == cell_fluid[:, None]).all()


def test_interface_is_the_edges_between_cells_of_two_fluids():
    points, cells, fluid, cell_fluid, wall = sharp_tank(0.0)
    owners = {}
    for cell, owner in zip(cells.tolist(), cell_fluid.tolist(), strict=True):
        for a, b in ((0, 1), (1, 2), (2, 0)):
            owners.setdefault(frozenset((cell[a], cell[b])), set()).add(owner)
    expected = {edge for edge, found in owners.items() if len(found) == 2}
    segments = fluid_regions(points, cells, fluid, cell_fluid).segments
    number = {tuple(point): k for k, point in enumerate(points.tolist())}
    ends = [[number[tuple(point)] for point in segment] for segment in segments.tolist()]
    assert {frozenset(pair) for pair in ends} == expected
    assert len(ends) == len(expected)
    # It ends at walls only.
    odd = np.bincount(np.ravel(ends), minlength=len(points)) % 2 == 1
    assert odd.sum() == 2
    assert wall[odd].all()


def test_particles_take_the_fluid_of_their_cells():
    points, cells, fluid, cell_fluid, _ = sharp_tank(0.0)
    sides = [np.isin(np.arange(len(points)), cells[cell_fluid == k]) for k in range(2)]
    said = 1 - fluid  # wrong everywhere: only where the cells do not decide does it count
    found, between = particle_fluids(cells, said, cell_fluid)
    assert (between == (sides[0] & sides[1])).all()
    assert between.sum() > 24
    assert (found[~between] == sides[1][~between]).all()
    assert (found[between] == said[between]).all()
    found, between = particle_fluids(cells[:1], said, cell_fluid[:1])
    assert not between.any()
    outside = np.setdiff1d(np.arange(len(points)), cells[0])
    assert (found[outside] == said[outside]).all()


def test_means_on_edges_are_over_the_cells_that_share_them():
    cells = np.array([[0, 1, 2], [0, 2, 3]])
    assert cell_edges(cells).pairs.tolist() == [[0, 1], [0, 2], [0, 3], [1, 2], [2, 3]]
    of_cells = np.array([[1.0, 10.0], [3.0, 50.0]])
    assert edge_means(cell_edges(cells), of_cells).tolist() == [[1, 10], [2, 30], [3, 50], [1, 10], [3, 50]]


def test_edges_of_two_cells():
    edges = cell_edges(np.array([[0, 1, 2], [0, 2, 3]]))
    assert edges.pairs.tolist() == [[0, 1], [0, 2], [0, 3], [1, 2], [2, 3]]
    assert edges.shared_by.tolist() == [1, 2, 1, 1, 1]
    assert [sorted(edges.sides[k : k + n].tolist()) for k, n in zip(edges.first, edges.shared_by, strict=True)] == [
        [0],
        [1, 4],
        [5],
        [2],
        [3],
    ]


def test_edges_of_particles_with_large_numbers_are_the_same():
    """Numbers too large to be packed with their sides are sorted in another way."""
    _, cells, _, _ = tank(0.0)
    far = 3_000_000_000
    edges, moved = cell_edges(cells), cell_edges(cells.astype(np.int64) + far)
    assert (moved.pairs - far == edges.pairs).all()
    assert (moved.shared_by == edges.shared_by).all()
    assert (moved.sides == edges.sides).all()


def test_sides_of_single_cells_are_the_edges_that_are_not_shared():
    """Of a mesh with holes, whose cells turn either way; each has its cell on the left."""
    random = np.random.default_rng(3)
    position = random.random((300, 2))
    cells = Delaunay(position).simplices
    cells = np.where(random.random((len(cells), 1)) < 0.5, cells[:, ::-1], cells)[random.random(len(cells)) < 0.7]
    starts, ends = outer_sides(position, cells)
    edges = cell_edges(cells)
    single = edges.pairs[edges.shared_by == 1]
    found = np.sort(np.stack([starts, ends], axis=1), axis=1)
    assert sorted(map(tuple, found.tolist())) == sorted(map(tuple, single.tolist()))
    (x0, y0), (x1, y1) = position[starts].T, position[ends].T
    assert 0.5 * np.sum(x0 * y1 - x1 * y0) == pytest.approx(areas(position, cells).sum())


def test_no_cells():
    none = np.empty((0, 3), int)
    for cell_fluid in (None, np.empty(0, int)):
        regions = fluid_regions(TRIANGLE, none, np.zeros(3, int), cell_fluid)
        assert regions.triangles.shape == (0, 3, 2)
        assert regions.segments.shape == (0, 2, 2)
    assert [len(part) for part in outer_sides(np.zeros((3, 2)), none)] == [0, 0]
    assert edge_means(cell_edges(none), np.empty((0, 3))).shape == (0, 3)


def test_sides_where_two_outlines_touch_whose_numbers_have_the_same_sum():
    position = np.array([[9.0, 9.0], [1.0, -1.0], [1.0, 1.0], [-1.0, -1.0], [-1.0, 1.0], [0.0, 0.0]])
    cells = np.array([[5, 1, 2], [5, 4, 3]])
    sides = set(zip(*map(np.ndarray.tolist, outer_sides(position, cells)), strict=True))
    assert sides == {(5, 1), (1, 2), (2, 5), (5, 4), (4, 3), (3, 5)}
