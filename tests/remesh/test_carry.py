"""What particles take along from cells, and the cells in which spray lands."""

import numpy as np
import pytest

import tipfem as tp
from tipfem.backend.launch import launch
from tipfem.linalg.sparsity import run_starts, sums_of_runs
from tipfem.mesh.mesh import Mesh
from tipfem.remesh.carry_kernels import carry, find_fallen
from tipfem.remesh.triangles.empty_space import beyond


def by_numpy(cells, share, measure, mass, per_mass, leaves):
    """The same as `carry`, corner by corner."""
    each = np.concatenate(
        [np.broadcast_to(measure[:, None, None], (*cells.shape, 1)), mass[:, None, None] * per_mass[cells]], 2
    )
    each = each * share[:, :, None]
    stay = ~leaves[cells]
    left = np.where(stay[:, :, None], 0.0, each).sum(axis=1) / np.maximum(stay.sum(axis=1), 1)[:, None]
    total = np.zeros((len(leaves), each.shape[2]))
    np.add.at(total, cells, np.where(stay[:, :, None], each + left[:, None], 0.0))
    return total, np.flatnonzero(~stay.any(axis=1))


@pytest.mark.parametrize("corners", [3, 4])
def test_corners_that_leave_give_their_parts_to_the_others(corners):
    rng = np.random.default_rng(corners)
    cells = np.array([rng.choice(60, corners, replace=False) for _ in range(200)], dtype=np.int32)
    share, measure, mass = rng.dirichlet(np.ones(corners), 200), rng.random(200), rng.random(200)
    per_mass, leaves = rng.normal(size=(60, 4)), rng.random(60) < 0.5
    total, lost = np.zeros((60, 5)), np.empty(200, dtype=np.int32)
    given = cells, share, measure, mass, per_mass, leaves.view(np.int8)
    count = launch(carry, *given, total, lost, 4, corners)
    wanted, gone = by_numpy(cells, share, measure, mass, per_mass, leaves)
    np.testing.assert_allclose(total, wanted, rtol=1e-12, atol=1e-14)
    assert lost[:count].tolist() == gone.tolist()
    assert count > 0
    assert not total[leaves].any()


def square(rows=8, *, periodic):
    """Triangles of a square of width 1, whose last column of particles is the first one where it is periodic."""
    x, y = np.meshgrid(np.linspace(0, 1, rows + 1), np.linspace(0, 1, rows + 1), indexing="ij")
    place, number = np.stack([x.ravel(), y.ravel()], axis=1), np.arange(x.size).reshape(x.shape)
    if periodic:
        number[-1] = number[0]
    a, b, c, d = (each.ravel() for each in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    return place, np.concatenate([np.stack(t, axis=1) for t in ((a, b, c), (a, c, d))]).astype(np.int32)


@pytest.mark.parametrize("periodic", [False, True])
def test_each_particle_is_found_in_the_cell_that_it_is_in(periodic):
    place, cells = square(periodic=periodic)
    period = tp.tank((1.0, 1.0), 0.1, periodic="x" if periodic else None).period
    rng = np.random.default_rng(7)
    drops = rng.random((300, 2)) * 1.4 - 0.2
    if periodic:
        drops = drops[(drops[:, 0] >= 0) & (drops[:, 0] < 1)]
    fluid = rng.integers(-1, 2, len(cells)).astype(np.int32)
    x = np.concatenate([place, drops])
    flying = len(place) + np.argsort(drops[:, 0], kind="stable").astype(np.int32)
    found = np.full(len(drops), -1, dtype=np.int32)
    launch(find_fallen, x, cells, fluid, period.array, 1, flying, found)
    corner = place[cells]
    if periodic:  # the last column's corners on the first are on the right of the others
        corner[..., 0] += corner[..., 0].max(axis=1, keepdims=True) - corner[..., 0] > 0.5
    for k, cell in zip(flying, found, strict=True):
        d = corner - x[k]
        area = [d[:, i, 0] * d[:, (i + 1) % 3, 1] - d[:, i, 1] * d[:, (i + 1) % 3, 0] for i in range(3)]
        inside = np.flatnonzero((np.array(area) >= 0).all(axis=0) & (fluid == 0))
        assert cell == (inside[0] if len(inside) else -1)
    assert (found >= 0).sum() > 20


def test_sums_of_runs_are_those_of_reduceat():
    rng = np.random.default_rng(2)
    key, values = rng.integers(0, 30, 200), rng.normal(size=(200, 4))
    order = np.argsort(key, kind="stable")
    first = run_starts(key[order])
    wanted = np.add.reduceat(values[order], first)
    np.testing.assert_allclose(sums_of_runs(values, order, first), wanted, rtol=1e-13, atol=1e-13)


def flow():
    """A column of water that begins to fall, in empty space."""
    water = tp.Fluid("water", 1000.0, 1e-3)
    tank = tp.tank((0.4, 0.4), 0.04).fill(water, box=((0, 0), (0.16, 0.24)))
    return tp.Simulation(tp.Case(tank, [water], gravity=(0, -9.81), free_surface=True))


def test_what_is_beside_empty_cells_is_known_from_step_to_step():
    simulation = flow()
    for _ in range(8):
        simulation.step()
        mesh = simulation.state.mesh
        empty = mesh.surface.empty
        assert mesh.surface.beside is not None
        whole = beyond(mesh, empty, 1)
        np.testing.assert_array_equal(whole.neighbours, Mesh(whole.position, whole.cells).neighbours)
        # Some cells that go leave the others what they are beside.
        keep = np.ones(len(mesh.cells), dtype=bool)
        keep[[1, 5, 17]] = False
        fewer = mesh.only(keep)
        whole = beyond(fewer, empty, 1)
        np.testing.assert_array_equal(whole.neighbours, Mesh(whole.position, whole.cells).neighbours)
        np.testing.assert_array_equal(fewer.neighbours, Mesh(fewer.position, fewer.cells).neighbours)


def test_what_was_beside_empty_cells_is_not_known_of_others():
    simulation = flow()
    simulation.step()
    mesh = simulation.state.mesh
    assert mesh.surface.longer(len(mesh.position) + 3).beside is None
    other = mesh.surface.empty[::-1].copy()
    whole = beyond(mesh, other, 1)
    np.testing.assert_array_equal(whole.neighbours, Mesh(whole.position, whole.cells).neighbours)
