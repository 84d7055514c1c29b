"""FacetTensionTerm: surface tension in the equations of a step in 3-D.

    momentum:  sum_f sigma_f dA_f / dx_a . u'_a    at the intermediate positions x + c_f u

and the derivative of it, with the gradients g_a of a facet's area A and its normal n,

    c_f sigma ((g_a . g_b) n n^T + g_a g_b^T - g_b g_a^T) / A

The first part is that of tilts. The others, of motions in the plane, cancel where facets are coplanar. As in an
axisymmetric flow (`tipfem.physics.surface_tension.term`), the part of dE / dx along a surface, which no pressures
balance, is left out: at particles at which two fluids meet that along dV / dx is taken, with the sum of the area
vectors around, and on walls along which they slide, in the plane of these: not along a contact line. What this leaves
out of the sum of forces on a surface that is not flat is given back along its normals n, as n (n . w).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tipfem.backend.launch import launch
from tipfem.linalg.parts import connected_parts
from tipfem.linalg.sparsity import Csr, run_starts
from tipfem.mesh.measures import area_vectors
from tipfem.physics.surface_tension import kernels
from tipfem.physics.surface_tension.facets import TensionFacets
from tipfem.physics.surface_tension.term import SurfaceTensionTerm
from tipfem.physics.term import Equations
from tipfem.typing import Array


class FacetTensionTerm(SurfaceTensionTerm):
    """The tension of facets of the step's mesh.

    ``pull`` (N, 3) are forces at contacts, see `young_forces_on_walls` [N]; ``sliding`` (K,) particles of walls slide
    along these, by projectors ``along`` (K, 9).
    """

    def __init__(self, facets: TensionFacets, pull: Array, sliding: Array, along: Array) -> None:
        super().__init__(facets, pull)
        self._sliding, self._along = sliding, along

    def begin(self, equations: Equations, first_node: int) -> None:
        """See `Term.begin`."""
        self._equations = e = equations
        facets, count = self._edges, len(e.particles)
        ends = facets.corners.T.ravel()
        one, other = (np.roll(facets.corners, -k, axis=1).T.ravel() for k in (1, 2))
        order = np.argsort(ends, kind="stable")
        end, one, other, number = ends[order], one[order], other[order], np.tile(np.arange(len(facets.sigma)), 3)[order]
        first = run_starts(end)
        rows, self._count = end[first], len(first)
        pairs = np.unique(np.concatenate([end, end]) * np.int64(count) + np.concatenate([one, other]))
        self._end, self._other = (part.astype(np.int32) for part in np.divmod(pairs, count))
        # Rows at which the same two fluids meet all around.
        here = facets.pair[number]
        alike = np.minimum.reduceat(here, first) == np.maximum.reduceat(here, first) if len(first) else here != here
        free = np.tile(np.eye(3).ravel(), (count, 1))
        free[e.walls] = 0.0
        free[self._sliding] = self._along
        self._rows, self._free = rows, np.where(alike[:, None], free[rows], 0.0)
        row = np.full(count, -1)
        row[rows] = np.arange(len(rows))
        self._surfaces, self._of = connected_parts(len(rows), row[end], row[one])
        members = np.argsort(self._of, kind="stable")
        starts = np.searchsorted(self._of[members], np.arange(self._surfaces + 1))
        assert self._pull is not None
        put = e.buffers.upload
        self._arrays = kernels.FacetArrays(
            put("tension.rows", rows.astype(np.int32)),
            put("tension.offsets", np.append(first, len(end)).astype(np.int32)),
            put("tension.one", one.astype(np.int32)),
            put("tension.other", other.astype(np.int32)),
            put("tension.sigma", facets.sigma[number]),
            put("tension.pull", self._pull[rows]),
            put("tension.free", self._free),
            put("tension.surfaces", starts.astype(np.int32)),
            put("tension.members", members.astype(np.int32)),
        )
        self._hessian, self._force = (
            e.buffers.get(f"tension.{name}", size, width)
            for name, size, width in (("hessian", len(end), 18), ("force", len(rows), 9))
        )

    def diagonal(self) -> None:
        """See `Term.diagonal`."""
        e = self._equations
        self._launch(kernels.add_facet_diagonal, e.motion, e.period, self._arrays, e.scale, e.scheme.cf)

    def residual(self, x: Any, out: Any) -> None:
        """See `Term.residual`."""
        e = self._equations
        arrays = self._arrays, x, self._hessian, self._force
        self._launch(kernels.facet_forces, e.motion, e.period, *arrays, e.scheme.cf)
        work = (self._surfaces, kernels.ROW * max(self._count // max(self._surfaces, 1), 1))
        launch(kernels.give_back, self._arrays, self._force, self._surfaces, work=work)
        self._launch(kernels.add_row_forces, self._arrays, self._force, e.scale, out)

    def gather(self, matrix: Csr) -> None:
        """See `Term.gather`."""
        e = self._equations
        self._launch(kernels.add_facet_blocks, self._arrays, self._hessian, e.scale, matrix, e.rows)

    def carried(self, x: Any) -> None:
        """See `Term.carried`: nothing changes in a step."""
        return

    def _gradient(self, displacement: Array) -> Array:
        """dE / dx (N, 3) at the intermediate positions of displacements (N, 3) [N]."""
        e, corners = self._equations, self._edges.corners
        assert self._pull is not None
        x = e.mesh.position + e.scheme.cf * displacement
        gradient: Array = self._edges.gradient(x)
        along, vectors = np.zeros_like(x), area_vectors(x, corners)
        for axis in range(3):
            along[:, axis] = np.bincount(corners.ravel(), np.repeat(vectors[:, axis], 3), len(x))
        rows, free = self._rows, self._free.reshape(-1, 3, 3)
        force, n = gradient[rows] + self._pull[rows], np.einsum("rij,rj->ri", free, along[rows])
        n /= np.linalg.norm(n, axis=1)[:, None] + 1e-300
        left = np.einsum("rij,rj->ri", free, force) - (force * n).sum(axis=1)[:, None] * n
        total, sums = np.zeros((self._surfaces, 3, 3)), np.zeros((self._surfaces, 3))
        np.add.at(total, self._of, n[:, :, None] * n[:, None])
        np.add.at(sums, self._of, left)
        mean = np.einsum("gii->g", total) / 3
        whole = (np.linalg.det(total) > kernels.ROUND * mean**3) & (mean > 0)
        w = np.zeros_like(sums)
        w[whole] = np.linalg.solve(total[whole], sums[whole][:, :, None])[:, :, 0]
        gradient[rows] += (n * w[self._of]).sum(axis=1)[:, None] * n - left
        return gradient
