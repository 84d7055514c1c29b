"""Kernels that pass over cells, against NumPy and SciPy; what winners of a round get; where spray looks for cells."""

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from test_cavities import check, shaken

from tipfem.mesh.mesh import corners_among
from tipfem.remesh.cavity import arrays
from tipfem.remesh.cavity.arrays import FIXED, ON, SPLIT, SWAP
from tipfem.remesh.cavity.balance import _patches, _sums
from tipfem.remesh.cavity.cavities import QUALITY, Task, touching
from tipfem.remesh.cavity.flight import _beside


@pytest.mark.parametrize("dim", [2, 3])
def test_cells_that_touch_some_particles_are_found(dim):
    found = shaken(dim, 5)
    some = np.random.default_rng(0).random(len(found.x)) < 0.1
    used = found.label >= 0
    expected = corners_among(some, found.cells[used]) > 0
    assert expected.any()
    np.testing.assert_array_equal(touching(some, found.cells)[used], expected)
    assert not touching(some, found.cells)[~used].any()


@pytest.mark.parametrize("dim", [2, 3])
def test_patches_and_sums_are_those_of_scipy_and_numpy(dim):
    mesh = shaken(dim, 8).mesh()
    cells = mesh.cells[np.random.default_rng(1).permutation(len(mesh.cells))[: len(mesh.cells) // 60]]
    row = np.repeat(np.arange(len(cells)), dim + 1)
    pairs = sparse.coo_matrix((np.ones(cells.size), (row, cells.ravel())), shape=(len(cells), len(mesh.position)))
    count, label = connected_components(pairs @ pairs.T, directed=False)
    patch, number = _patches(cells, len(mesh.position))
    assert 1 < number == count
    np.testing.assert_array_equal(patch, label)  # both by their first cells
    values = np.random.default_rng(2).random((len(mesh.position), 6))
    np.testing.assert_allclose(_sums(values[:, :4], cells), values[cells][:, :, :4].sum(axis=1), rtol=1e-14)


@pytest.mark.parametrize("dim", [2, 3])
def test_arrays_grow_when_winners_need_more_rows_than_there_are(dim):
    found = shaken(dim, 5)
    cells, particles = len(found.cells), len(found.x)
    for _ in range(12):
        found.run(Task(SPLIT, 6, 0.7), *QUALITY[dim])
    assert len(found.cells) > cells
    assert len(found.x) > particles
    check(found)
    assert (found.marks[found.is_new] != 0).all()


def test_winners_get_the_lowest_unused_rows():
    found = shaken(3, 5)
    found.run(Task(SWAP, 9, 0.3))
    free, places = np.flatnonzero(found.label < 0), np.flatnonzero(found.marks == 0)
    given = []
    change = found._change

    def changed(rows):
        result = change(rows)
        won = rows.row[rows.row[:, arrays.WON] == 1]
        given.append((won, result))
        return result

    found._change = changed
    assert found.round(Task(SPLIT, 1, 1.0)) > 1
    won, (count, touched) = given[0]
    assert count == len(won)
    more = won[:, arrays.FILLED] - won[:, arrays.COUNT]
    np.testing.assert_array_equal(won[:, arrays.FREE_CELL], np.cumsum(more) - more)
    np.testing.assert_array_equal(won[:, arrays.NEW_PARTICLE], places[:count])
    assert (found.label[free[: more.sum()]] >= 0).all()
    assert (found.label[free[more.sum() :]] < 0).all()
    assert touched[free[: more.sum()]].all()
    assert found.is_new[places[:count]].all()


def test_spray_looks_at_all_that_is_near_and_at_little_else():
    rng = np.random.default_rng(3)
    x, places, reach = rng.random((4000, 3)), rng.random((5, 3)) * 1.2 - 0.1, 0.1
    near = (np.linalg.norm(x[:, None] - places, axis=2) <= reach).any(axis=1)
    found = _beside(x, places, reach)
    assert near.any()
    assert found[near].all()
    assert found.mean() < 0.2


@pytest.mark.parametrize("dim", [2, 3])
def test_volumes_change_only_with_particles_that_move(dim, monkeypatch):
    """Also where memory has anything: particles that have been stopped have no gradient."""
    found, empty = shaken(dim, 6, labels=2), np.empty

    def full(*arguments, **options):
        result = empty(*arguments, **options)
        result.fill(7)
        return result

    monkeypatch.setattr(np, "empty", full)
    moves = (found.marks & (ON | FIXED)) == ON
    areas, stopped = found._areas(found.label, moves, found.around(moves)), moves.copy()
    stopped[np.flatnonzero(moves)[::2]] = False
    vectors = found._area_vectors(areas, stopped)
    part, particle = np.divmod(areas.key, len(found.x))
    assert (vectors[~stopped[particle]] == 0.0).all()
    moved, before, step = np.flatnonzero(stopped[particle])[:5], found.x.copy(), 1e-5
    for row in moved:
        for k in range(dim):
            ends = []
            for sign in (1, -1):
                found.x = before.copy()
                found.x[particle[row], k] += sign * step
                ends.append(found.volumes(found.label, 2)[part[row]])
            assert (ends[0] - ends[1]) / (2 * step) == pytest.approx(vectors[row, k], abs=1e-7)
