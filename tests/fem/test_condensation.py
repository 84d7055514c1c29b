"""Condensation: the matrix, residuals and corrections of displacements that follow others, against NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse

from tipfem.backend import launch as launching
from tipfem.backend.arrays import Buffers, download
from tipfem.fem.condensation import Condensation, Follows
from tipfem.linalg.sparsity import Csr

# A fan of triangles around node 0; nodes 7 and 8 are copies of 1 and 2, node 9 is a body's, in no cell.
CELLS = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5], [7, 8, 6]], dtype=np.int32)
OWNER = np.array([0, 1, 2, 3, 4, 5, 6, 1, 2, 9])
NODES, DIM = 10, 2


def relations(seed=0):
    """Node 1 slides on a wall, as does 7, its copy; nodes 3, 4 and 5 follow the body 9, 5 node 0, too.

    Node 3 slides on the body: it follows itself, too.
    """
    rng = np.random.default_rng(seed)
    node, parent = np.array([1, 3, 3, 4, 5, 5]), np.array([1, 9, 3, 9, 9, 0])
    row, column = rng.standard_normal((2, 6, 2, 2))
    for k, angle in zip((0, 2), rng.uniform(0, np.pi, 2), strict=True):
        row[k] = column[k] = np.outer(*2 * [np.array([np.cos(angle), np.sin(angle)])])
    return Follows(node, parent, row, column)


def operators(follows):
    """R and L (20, 20) of the displacements of all nodes."""
    found = []
    for of in (follows.column, follows.row):
        base = np.eye(NODES * DIM)
        for i in np.unique(follows.node):
            base[DIM * i : DIM * i + DIM] = 0.0
        for i, j, block in zip(follows.node, follows.parent, of, strict=True):
            base[DIM * i : DIM * i + DIM, DIM * j : DIM * j + DIM] += block
        copies = np.eye(NODES * DIM)
        for i in np.flatnonzero(OWNER != np.arange(NODES)):
            copies[DIM * i : DIM * i + DIM] = 0.0
            copies[DIM * i : DIM * i + DIM, DIM * OWNER[i] : DIM * OWNER[i] + DIM] = np.eye(DIM)
        found.append(copies @ base)
    return found


def with_pressures(operator):
    """(30, 30) acting on vectors of unknowns, pressures left alone."""
    full = np.eye(NODES * (DIM + 1))
    index = np.arange(NODES * (DIM + 1)).reshape(NODES, -1)[:, :DIM].ravel()
    full[np.ix_(index, index)] = operator
    return full


def flat(blocks):
    """The blocks (K, 3, 3) in the order of `tipfem.fem.jacobian`."""
    parts = blocks[:, :DIM, :DIM], blocks[:, :DIM, DIM], blocks[:, DIM, :DIM], blocks[:, DIM, DIM]
    return np.concatenate([part.ravel() for part in parts])


def couplings_by_numpy(follows):
    """The pairs of `Condensation.couplings`, with (3, 6) in addition."""
    parents = {int(k): {int(k)} for k in range(NODES)}
    for node, parent in zip(follows.node.tolist(), follows.parent.tolist(), strict=True):
        parents[node].add(parent)
    for node, owner in enumerate(OWNER.tolist()):
        parents[node] |= ({owner} | parents[owner]) - ({owner} if len(parents[owner]) > 1 else set())
    alone = {k for k in parents if parents[k] == {k}}
    found = {(3, 6)}
    for i, j in ((int(i), int(j)) for cell in CELLS for i in cell for j in cell):
        if i not in alone or j not in alone:
            found |= {(a, b) for a in parents[i] for b in parents[j]} - {(i, j)}
    return sorted(found)


@pytest.mark.parametrize("single", [True, False])
def test_matrix_residual_and_correction_are_those_of_numpy(monkeypatch, single):
    monkeypatch.setattr(launching, "is_serial", lambda count, cost: single)
    rng, buffers, follows = np.random.default_rng(3), Buffers(), relations()
    condensation = Condensation(OWNER, relations(9), buffers)
    condensation.set(follows)
    assert condensation.count == 6
    starts, other = condensation.couplings(np.array([3]), np.array([6]), CELLS)
    one = np.repeat(np.arange(NODES), np.diff(starts))
    assert (
        sorted(zip(one.tolist(), other.tolist(), strict=True))
        == couplings_by_numpy(follows)
        == sorted(set(zip(one.tolist(), other.tolist(), strict=True)))
    )
    assert (3, 6) in set(zip(one.tolist(), other.tolist(), strict=True))
    pairs = {(int(a), int(b)) for cell in CELLS for a in cell for b in cell} | set(
        zip(one.tolist(), other.tolist(), strict=True)
    )
    pairs |= {(i, i) for i in range(NODES)}
    rows, columns = np.array(sorted(pairs)).T
    blocks = rng.standard_normal((len(rows), 3, 3))
    own = np.array([any(a in cell and b in cell for cell in CELLS) for a, b in zip(rows, columns, strict=True)])
    blocks[~own] = 0.0  # which the elements do not couple
    offsets = np.concatenate([[0], np.cumsum(np.bincount(rows, minlength=NODES))])
    dense = sparse.bsr_matrix((blocks, columns, offsets), shape=(30, 30)).toarray()
    matrix = Csr(*(buffers.upload(f"test.{k}", a) for k, a in enumerate((offsets, columns, flat(blocks)))))
    right, left = (with_pressures(operator) for operator in operators(follows))
    # Followers are no unknowns: their columns of R, rows of L^T, are those of nothing.
    condensation.condense(matrix)
    found = download(matrix.values, 9 * len(rows))
    wanted = left.T @ dense @ right
    got = np.zeros_like(blocks)
    uu, up, pu, pp = np.split(found, len(rows) * np.array([4, 6, 8]))
    got[:, :2, :2], got[:, :2, 2], got[:, 2, :2], got[:, 2, 2] = (
        uu.reshape(-1, 2, 2),
        up.reshape(-1, 2),
        pu.reshape(-1, 2),
        pp,
    )
    np.testing.assert_allclose(sparse.bsr_matrix((got, columns, offsets), shape=(30, 30)).toarray(), wanted, atol=1e-13)
    r = rng.standard_normal(30)
    device = buffers.upload("test.r", r)
    condensation.collect(device)
    np.testing.assert_allclose(download(device, 30), left.T @ r, atol=1e-13)
    device = buffers.upload("test.q", r)
    condensation.spread(device)
    np.testing.assert_allclose(download(device, 30), right @ r, atol=1e-13)


def test_without_followers_nothing_changes():
    nothing = np.zeros((0, 2, 2))
    nowhere = np.zeros(0, dtype=np.int64)
    condensation = Condensation(np.arange(4), Follows(nowhere, nowhere, nothing, nothing), Buffers())
    assert condensation.count == 0
    starts, other = condensation.couplings(np.array([2, 0, 2]), np.array([3, 1, 3]), np.array([[0, 1, 2]]))
    assert starts.tolist() == [0, 1, 1, 2, 2]
    assert other.tolist() == [1, 3]
