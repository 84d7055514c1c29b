"""SurfaceTensionTerm: the tension of interfaces and free surfaces in the equations of a step.

With the energy E = sum_e sigma_e L_e of the edges e = (a, b), see `tipfem.physics.surface_tension.edges`, the weak form
is added to by its derivative along u' at the intermediate positions x + c_f u: with t from a to b,

    momentum:    sum_e sigma_e t . (u'_b - u'_a)
    derivative:  c_f sum_e sigma_e / L_e (u'_b - u'_a) . (I - t t^T) (u_b - u_a)

The derivative is exact, symmetric and never negative. Lengths are convex in the positions, so that the term takes
energy for c_f = 1, and is stable in steps of any length. The capillary time sqrt((rho_1 + rho_2) h^3 / (4 pi sigma)) is
one of accuracy only, see `tipfem.case.surface_tension`.

At contacts with walls Young's force is added, which is constant in a step. Where a contact recedes at another angle
than it advances, that of the mean of both cosines; and along the wall, with the unit vector t,

    momentum:    clamp(k (e + t . u), -g, g) t . u',    g = sigma (cos(receding) - cos(advancing)) / 2

Coulomb's friction: a spring holds the contact, which has been drawn by e and yields at g. Its potential is convex, so
that Newton's method finds whether a contact slides. Both are forces of the walls on the fluids: their work is a part of
the external work.

In an axisymmetric flow E = sum_e sigma_e 2 pi (r_a + r_b) / 2 L_e and what arcs add, whose force is that of the step's
start. dE / dx has a part along the meridian as well, which no pressures balance, and which would drive particles along
it without end. Of particles with two edges only the part along dV / dx is taken, the meridian's normal at the
intermediate positions, and along it what pressures have there that vary, see `TensionEdges.pressed_along`; the
derivative is that of the whole, to which Newton's method converges as well.

An interface that leaves the tank where its particles are free goes on beyond in the same direction, and pulls there as
it does inside: its last particle has no force.

Pressures on both sides of an interface balance it: the solve finds p_1 - p_2 = sigma / R, where R is that of a regular
polygon, and nothing moves. At a free surface no pressure is prescribed, and the same follows from no traction.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from tipfem.backend.launch import launch
from tipfem.linalg.sparsity import Csr, run_starts
from tipfem.mesh.mesh import corners_among
from tipfem.physics.surface_tension import kernels
from tipfem.physics.surface_tension.tension import Tension
from tipfem.physics.term import Equations, Term, TermWork
from tipfem.typing import Array


class SurfaceTensionTerm(Term):
    """The tension of edges of the step's mesh.

    Args:
        pull: (N, 2) forces at contacts, see `tipfem.physics.surface_tension.edges.young_forces` [N]; None for none.
        holding: (N, 2) the largest by which walls hold contacts, along the walls [N]; None where they slide freely.
        stretch: displacement at which a contact that is held begins to slide [m].
        goes_on: (N,) mask of the particles at which interfaces leave the tank, and go on beyond; None for none.
    """

    def __init__(
        self,
        edges: Tension,
        pull: Array | None = None,
        holding: Array | None = None,
        stretch: float = 0.0,
        goes_on: Array | None = None,
    ) -> None:
        self._edges: Any = edges
        self._arrays: Any = None
        self._pull, self._holding, self._stretch = pull, holding, stretch
        self._beyond = np.zeros(0, dtype=np.int64) if goes_on is None else np.flatnonzero(goes_on)

    def begin(self, equations: Equations, first_node: int) -> None:
        """See `Term.begin`."""
        e, edges = equations, self._edges
        self._equations = e
        ends, other = np.concatenate([edges.one, edges.other]), np.concatenate([edges.other, edges.one])
        order = np.lexsort((other, ends))
        if len(self._beyond):
            order = order[~np.isin(ends[order], self._beyond)]
        self._end, self._other = ends[order], other[order]
        first = run_starts(self._end)
        put, self._count = e.buffers.upload, len(first)
        lists = (
            put("tension.rows", self._end[first]),
            put("tension.offsets", np.append(first, len(order)).astype(np.int32)),
            put("tension.other", self._other),
        )
        pull = np.zeros((len(e.particles), 2)) if self._pull is None else self._pull
        axial = e.mesh.period.axial
        self._arcs = edges.arc_gradient(e.mesh.position) if axial else 0.0
        pull = pull + self._arcs if axial else pull
        young = put("tension.pull", pull[self._end[first]])
        self._held = np.zeros((len(first), kernels.HELD))
        if self._holding is not None and edges.strain is not None:
            rows = self._end[first]
            force = np.hypot(*self._holding[rows].T)
            along = self._holding[rows] / np.maximum(force, 1e-300)[:, None]
            drawn = (along * edges.strain[rows]).sum(axis=1)
            self._held = np.column_stack([along, drawn, force, force / self._stretch])
        holds = put("tension.held", self._held)
        self._yielding = e.buffers.get("tension.yielding", len(first))
        sigma = put("tension.sigma", np.tile(edges.sigma, 2)[order])
        projects = (np.diff(np.append(first, len(order))) == 2) & ~e.walls[self._end[first]] & axial
        self._projected = first[projects]
        projected = put("tension.projects", projects.astype(np.int32))
        along = np.zeros((len(first), 2))
        if axial:
            along[projects] = edges.pressed_along(e.mesh.position)[self._end[self._projected]]
        self._along = along[projects]
        along = put("tension.along", along)
        self._arrays = kernels.EdgeArrays(*lists, sigma, young, projected, along, holds)
        self._hessian = e.buffers.get("tension.hessian", len(order), kernels.hessian_width(axial=axial))

    def _launch(self, kernel: Any, *arguments: Any) -> None:
        if self._count:
            launch(kernel, *arguments, self._count, work=(self._count, kernels.ROW))

    def couplings(self, *, near: bool) -> tuple[Array, Array]:
        """See `Term.couplings`: where a particle has several nodes, its edges may be beside cells of others."""
        rows, columns = self._end.astype(np.int64), self._other.astype(np.int64)
        if near:
            own = np.unique(rows)
            return np.concatenate([rows, own]), np.concatenate([columns, own])
        if self._equations.nodes is self._equations.mesh:
            return rows[:0], columns[:0]
        count, cells = len(self._equations.owner), self._equations.nodes.cells
        here = np.zeros(count, dtype=bool)
        here[rows] = True
        beside = cells[corners_among(here, cells) > 1].astype(np.int64)
        width = range(cells.shape[1])
        pairs = [beside[:, k] * count + beside[:, m] for k in width for m in width if k != m]
        apart = ~np.isin(rows * count + columns, np.concatenate(pairs))
        return rows[apart], columns[apart]

    def diagonal(self) -> None:
        """See `Term.diagonal`."""
        e = self._equations
        self._launch(kernels.add_diagonal, e.motion, e.period, self._arrays, e.scale, e.scheme.cf)

    def residual(self, x: Any, out: Any) -> None:
        """See `Term.residual`."""
        e = self._equations
        arrays = e.motion, e.period, self._arrays, e.scale, x
        self._launch(kernels.add_forces, *arrays, self._hessian, self._yielding, out, e.scheme.cf)

    def gather(self, matrix: Csr) -> None:
        """See `Term.gather`."""
        e = self._equations
        arrays = self._arrays, self._hessian, self._yielding, e.scale
        self._launch(kernels.add_blocks, *arrays, matrix, e.period, e.rows)

    def carried(self, x: Any) -> Tension | None:
        """See `Term.carried`: the edges, with how far the contacts are drawn that walls hold."""
        if self._holding is None or self._edges.strain is None:
            return None
        rows, held = self._end[run_starts(self._end)], self._held
        moved = (self._equations.values(x)[rows, :2] * held[:, :2]).sum(axis=1)
        drawn = np.clip(held[:, 2] + moved, -self._stretch, self._stretch) * (held[:, 3] > 0)
        strain = np.zeros_like(self._edges.strain)
        strain[rows] = drawn[:, None] * held[:, :2]
        changed: Tension = dataclasses.replace(self._edges, strain=strain)
        return changed

    def _gradient(self, displacement: Array) -> Array:
        """dE / dx (N, 2) at the intermediate positions of displacements (N, 2) [N]."""
        e = self._equations
        x = e.mesh.position + e.scheme.cf * displacement
        gradient: Array = self._edges.gradient(x) + self._arcs
        if len(self._projected):
            rows = self._end[self._projected]
            one, other = x[self._other[self._projected]], x[self._other[self._projected + 1]]
            normal = _volume_slope(x[rows], one) - _volume_slope(x[rows], other)
            along = (gradient[rows] * normal).sum(axis=1) / (normal * normal).sum(axis=1)
            gradient[rows] = along[:, None] * normal + self._along
        return gradient

    def forces(self, x: Any) -> Array:
        """See `Term.forces`."""
        e = self._equations
        count, result = len(e.particles), np.zeros((len(e.owner), e.dimension))
        result[:count] = self._gradient(e.values(x)[:count, : e.dimension])
        result[self._beyond] = 0.0
        return result

    def work(self, x: Any, displacement: Array) -> TermWork:
        """See `Term.work`."""
        gradient, wall = self._gradient(displacement), self._equations.walls
        held, beyond = np.flatnonzero(wall & gradient.any(axis=1)), self._beyond
        return TermWork(
            stored=float(np.einsum("ik,ik", gradient, displacement)),
            walls=float(np.einsum("ik,ik", gradient[held], displacement[held])),
            wall_force=gradient[held].sum(axis=0),
            passing=float(np.einsum("ik,ik", gradient[beyond], displacement[beyond])),
            passing_force=gradient[beyond].sum(axis=0),
        )


def _volume_slope(here: Array, there: Array) -> Array:
    """Derivative by ``here`` (N, 2) of the volume between the axis and edges to ``there``, times 3 / pi."""
    (r, z), (s, w) = here.T, there.T
    return np.stack([(2 * r + s) * (z - w), r * r + r * s + s * s], axis=1)
