"""Mesh: linear simplices on the particles, with the connectivity that the solver asks for."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from tipfem.particles import Array


@dataclass(frozen=True)
class Mesh:
    """Simplices on N particles.

    Attributes:
        position: (N, d) [m].
        cells: (M, d + 1) particles of each simplex, positively oriented, int32.
    """

    position: Array
    cells: Array

    @property
    def dimension(self) -> int:
        """Number of space dimensions d."""
        return int(self.position.shape[1])

    @cached_property
    def measure(self) -> Array:
        """(M,) signed area [m^2] or volume [m^3] of each simplex."""
        return simplex_measure(self.position, self.cells)

    @cached_property
    def edges(self) -> Array:
        """(E, 2) particles at the ends of each edge, lower index first."""
        corners = self.cells.shape[1]
        first, second = np.triu_indices(corners, k=1)
        pairs = np.stack([self.cells[:, first].ravel(), self.cells[:, second].ravel()], axis=1)
        pairs.sort(axis=1)
        key = np.unique(pairs[:, 0].astype(np.int64) * len(self.position) + pairs[:, 1])
        return np.stack(np.divmod(key, len(self.position)), axis=1).astype(np.int32)

    @cached_property
    def incidence(self) -> tuple[Array, Array]:
        """Corners at each particle, in CSR: offsets (N + 1,) and corner numbers ``cell * (d + 1) + local``."""
        flat = self.cells.ravel()
        offsets = np.zeros(len(self.position) + 1, dtype=np.int32)
        np.cumsum(np.bincount(flat, minlength=len(self.position)), out=offsets[1:])
        return offsets, np.argsort(flat, kind="stable").astype(np.int32)

    @cached_property
    def adjacency(self) -> tuple[Array, Array]:
        """Particles that share a simplex with each particle, itself included, in CSR (offsets, columns)."""
        n = len(self.position)
        i, j = self.edges.T
        ends = np.concatenate([i, j, np.arange(n, dtype=np.int32)])
        others = np.concatenate([j, i, np.arange(n, dtype=np.int32)])
        graph = sparse.csr_matrix((np.ones(len(ends), dtype=np.int8), (ends, others)), shape=(n, n))
        graph.sort_indices()
        return graph.indptr.astype(np.int32), graph.indices.astype(np.int32)


def simplex_measure(position: Array, cells: Array) -> Array:
    """Signed areas or volumes (M,) of simplices ``cells`` (M, d + 1) at ``position`` (N, d)."""
    corner = position[cells]
    side = corner[:, 1:] - corner[:, :1]
    if position.shape[1] == 2:
        return 0.5 * (side[:, 0, 0] * side[:, 1, 1] - side[:, 0, 1] * side[:, 1, 0])
    return np.einsum("mi,mi->m", side[:, 0], np.cross(side[:, 1], side[:, 2])) / 6.0
