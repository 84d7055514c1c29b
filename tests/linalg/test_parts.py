"""Connected parts of graphs and of cells."""

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from tipfem.linalg.parts import connected_parts, parts_of_cells


@pytest.mark.parametrize(("nodes", "edges"), [(1, 0), (10, 5), (100, 60), (1000, 700), (1000, 4000)])
def test_parts_are_those_of_scipy_and_in_the_order_of_their_lowest_nodes(nodes, edges):
    one, other = np.random.default_rng(nodes + edges).integers(0, nodes, (2, edges))
    graph = coo_array((np.ones(edges), (one, other)), shape=(nodes, nodes))
    count, part = connected_components(graph, directed=False)
    found, label = connected_parts(nodes, one, other)
    assert found == count
    np.testing.assert_array_equal(label, part)
    assert (np.diff(np.unique(label, return_index=True)[1]) > 0).all()


def test_a_long_chain_is_one_part_in_either_direction():
    ends = np.arange(99_999), np.arange(1, 100_000)
    for one, other in (ends, ends[::-1], [end[::-1] for end in ends]):
        count, label = connected_parts(100_000, one, other)
        assert count == 1
        assert not label.any()


def test_cells_that_share_a_particle_are_of_one_part():
    cells = np.array([[7, 2, 3], [10, 11, 12], [3, 4, 5], [20, 21, 22], [12, 5, 30]])
    count, label = parts_of_cells(cells)
    assert count == 2
    assert label.tolist() == [0, 0, 0, 1, 0]
