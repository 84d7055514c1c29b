"""tipfem/delaunay_repair.py: meshes repaired after motion and relocation, against Qhull."""

from __future__ import annotations

import numpy as np
import pytest
from triangulations import KINDS, as_set, circle_test, cloud, delaunay, inner_edges, of

from tipfem.mesh.mesh import Mesh, simplex_measure
from tipfem.remesh.triangles.delaunay_repair import repaired


def shaken(x, cells, rng, size):
    """Positions a little further on, at which no triangle is inverted; the hull stays."""
    step = rng.normal(size=x.shape) * size
    on_hull = np.unique(np.concatenate([edge for edge in hull_edges(x, cells)]))
    step[on_hull] = 0.0
    while (simplex_measure(x + step, cells) <= 0).any():
        step *= 0.5
    return x + step


def hull_edges(x, cells):
    """Particles of the edges that have one triangle."""
    cell, i = np.nonzero(Mesh(x, cells).neighbours < 0)
    return [cells[cell, (i + 1) % 3], cells[cell, (i + 2) % 3]]


def some_moves(x, cells, rng, most):
    """Particles off the hull, each with an inner edge between two that stay, no particle used twice; and new places."""
    hull = set(np.concatenate(hull_edges(x, cells)).tolist())
    mesh = Mesh(x, cells)
    cell, i = np.nonzero(mesh.neighbours > np.arange(len(cells))[:, None])
    edges = np.stack([cells[cell, (i + 1) % 3], cells[cell, (i + 2) % 3]], axis=1)
    inner = [p for p in range(len(x)) if p not in hull]
    leaving = rng.permutation(inner)[: min(most, len(inner) // 4)]
    taken, moves = set(leaving.tolist()), []
    order = iter(rng.permutation(len(edges)))
    for p in leaving:
        for k in order:
            if not taken & set(edges[k].tolist()):
                taken |= set(edges[k].tolist())
                moves.append([p, *edges[k]])
                break
    moves = np.array(moves, dtype=np.int64).reshape(-1, 3)
    y = x.copy()
    part = rng.choice([0.5, 1 / 3], len(moves))[:, None]
    y[moves[:, 0]] = (1 - part) * x[moves[:, 1]] + part * x[moves[:, 2]]
    return moves, y


def is_delaunay(mesh, x):
    """All that must hold, ties between Qhull's mesh and ours let pass."""
    t = of(x, mesh.cells)
    np.testing.assert_array_equal(mesh.neighbours, t.neighbours)
    assert (mesh.measure > 0).all()
    assert circle_test(x, inner_edges(t)).max(initial=-1.0) < 1e-12
    expected = delaunay(x)
    assert mesh.measure.sum() == pytest.approx(simplex_measure(x, expected).sum(), rel=1e-12)
    if np.abs(circle_test(x, inner_edges(of(x, expected)))).min(initial=1.0) > 1e-11:
        assert as_set(mesh.cells) == as_set(expected)


@pytest.mark.parametrize("kind", KINDS)
def test_a_repair_makes_the_triangulation_of_qhull(kind):
    """After motion and relocation of a quarter of the particles; where it gives up it says so."""
    done = moved = 0
    for seed in range(100):
        rng, x = np.random.default_rng(seed), cloud(kind, seed)
        cells = delaunay(x)
        carried = shaken(x, cells, rng, 0.02 * np.ptp(x[:, 1]))
        moves, y = some_moves(carried, cells, rng, 6)
        mesh = repaired(Mesh(x, cells), carried, y, moves)
        if mesh is None:
            continue
        done, moved = done + 1, moved + len(moves)
        is_delaunay(mesh, y)
    assert done > 50
    assert moved > done


@pytest.mark.slow
def test_a_repair_of_many_steps_is_still_that_of_qhull():
    rng = np.random.default_rng(0)
    n = 40
    lattice = np.stack(np.meshgrid(np.arange(n + 1.0), np.arange(n + 1.0), indexing="ij"), axis=-1).reshape(-1, 2)
    inside = ((lattice > 0) & (lattice < n)).all(axis=1)
    lattice[inside] += rng.uniform(-0.2, 0.2, (inside.sum(), 2))
    mesh, given_up = Mesh(lattice, delaunay(lattice)), 0
    for _ in range(60):
        carried = shaken(mesh.position, mesh.cells, rng, 0.05)
        moves, y = some_moves(carried, mesh.cells, rng, 20)
        new = repaired(mesh, carried, y, moves)
        given_up += new is None
        mesh = new or Mesh(y, delaunay(y))
        is_delaunay(mesh, y)
    assert given_up <= 3


def test_what_cannot_be_repaired_is_left_alone():
    x = cloud("jittered lattice", 3)
    cells = delaunay(x)
    mesh, nothing = Mesh(x, cells), np.zeros((0, 3), dtype=np.int64)
    assert as_set(repaired(mesh, x, x, nothing).cells) == as_set(cells)
    inverted = x.copy()
    inverted[8] += 0.5
    assert repaired(mesh, inverted, inverted, nothing) is None
    elsewhere = x.copy()
    elsewhere[8] += 0.01  # by something that is no relocation
    assert repaired(mesh, x, elsewhere, nothing) is None
    far = np.array([[8, 0, 2]])  # corners that no edge joins
    elsewhere = x.copy()
    elsewhere[8] = 0.5 * (x[0] + x[2])
    assert repaired(mesh, x, elsewhere, far) is None
    np.testing.assert_array_equal(mesh.cells, cells)


def test_two_particles_can_be_set_into_one_edge():
    """Between two fluids, one a third of the way from either end."""
    rng = np.random.default_rng(4)
    lattice = np.stack(np.meshgrid(np.arange(9.0), np.arange(9.0), indexing="ij"), axis=-1).reshape(-1, 2)
    inside = ((lattice > 0) & (lattice < 8)).all(axis=1)
    lattice[inside] += rng.uniform(-0.2, 0.2, (inside.sum(), 2))
    mesh = Mesh(lattice, delaunay(lattice))
    a, b = mesh.edges[np.flatnonzero(inside[mesh.edges].all(axis=1))[20]]
    near = set(mesh.cells[(mesh.cells == a).any(axis=1) | (mesh.cells == b).any(axis=1)].ravel().tolist())
    p, q = [i for i in np.flatnonzero(inside) if i not in near][:2]
    y = lattice.copy()
    y[p], y[q] = (2 * lattice[a] + lattice[b]) / 3, (lattice[a] + 2 * lattice[b]) / 3
    new = repaired(mesh, lattice, y, np.array([[p, a, b], [q, b, a]]))
    assert new is not None
    is_delaunay(new, y)
