"""Outlines of bodies along which fluids slip: where particles may slide on them, and in which direction.

An outline consists of curves between its corners, see `tipfem.geometry.plane.curves`; a straight side is one of a
single edge. Particles in corners move with the body. All others slide along their curve, which moves with the body: on
a straight side along that, and on a curve at right angles to the boundary integral of their shape function times the
normal, from the particle before to the one after, so that the body keeps its area. After the step particles of curves
are put back on these.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from tipfem.case.body import Body
from tipfem.geometry.period import no_period
from tipfem.geometry.plane.curves import Curve, chain_tangents, curve_of, restored, runs_of
from tipfem.geometry.plane.domain import Domain
from tipfem.mesh.mesh import Mesh
from tipfem.typing import Array

# A particle closer than this to a corner of an outline is in it; one closer to the outline is on that [spacings].
AT_CORNER = 1e-5


class Outline:
    """The outline of a body at t = 0.

    Attributes:
        curves: between corners.
        curved: whether any of them has several edges.
        area: that it encloses [m^2].
        reference: (2,) reference point of the body at t = 0 [m].
    """

    def __init__(self, body: Body) -> None:
        domain = _domain(body)
        self.curves: list[Curve] = [curve_of(domain, 0, run) for run in runs_of(domain, 0)]
        self.curved, self.area = any(len(curve.edges) > 1 for curve in self.curves), body.area
        self.reference = body.reference

    def number(self, y: Array, spacing: float) -> tuple[Array, Array]:
        """The curve of points (K, 2) near the outline, -1 in corners (K,); and its unit tangents (K, 2), 0 there."""
        nearest = [curve.nearest(y) for curve in self.curves]
        number = np.argmin([distance for distance, _ in nearest], axis=0)
        tangent = np.zeros_like(y)
        for k, (curve, (_, edge)) in enumerate(zip(self.curves, nearest, strict=True)):
            here = np.flatnonzero(number == k)
            if not len(here):
                continue
            tangent[here] = curve.tangent(y[here], edge[here])
            number[here[curve.at_ends(y[here], AT_CORNER * spacing)]] = -1
        tangent[number < 0] = 0.0
        return number, tangent

    def project(self, y: Array, number: Array) -> Array:
        """Points (K, 2), those on curves of several edges moved there; ``number`` (K,) as of `number`."""
        y = y.copy()
        for k, curve in enumerate(self.curves):
            if len(curve.edges) > 1:
                y[number == k] = curve.project(y[number == k])
        return y

    def several(self, number: Array) -> Array:
        """Mask (K,) of the curves (K,), see `number`, of several edges."""
        several = np.array([len(curve.edges) > 1 for curve in self.curves] + [False])
        return np.asarray(several[number])


def _domain(body: Body) -> Domain:
    """The region that a body covers at t = 0, with the centres of its arcs."""
    corners, count = body.corners, len(body.corners)
    ends, number, centres = np.roll(corners, -1, axis=0), np.full(count, -1), {}
    for k, piece in enumerate(piece for piece in body.outline.pieces if piece.centre is not None):
        centre = np.asarray(piece.centre)
        radius = float(np.linalg.norm(np.asarray(piece.start) - centre))
        on = [np.abs(np.linalg.norm(x - centre, axis=1) - radius) < 1e-9 * radius for x in (corners, ends)]
        number[on[0] & on[1] & (number < 0)], centres[k] = k, centre
    return Domain([corners], [[body.name] * count], [number.tolist()], centres)


def body_faces(mesh: Mesh, label: Array) -> tuple[Array, Array]:
    """Faces (E, 2) along bodies, these on their left, and their cells (E,), by the body (N,) of particles, or -1."""
    cell, _, one, other = mesh.hull
    pairs = np.stack([other, one], axis=1)
    here = (label[pairs[:, 0]] >= 0) & (label[pairs[:, 0]] == label[pairs[:, 1]])
    return pairs[here], cell[here]


def with_new(label: Array, new: Array, mesh: Mesh) -> Array:
    """The numbers (N,) of the bodies that particles are on, -1 for none, with those of new ones between two others.

    They are found by what they are beside, not by where they are: a new particle of a curve is on a chord, which may be
    as far from the curve as an edge is long. Missed, it would leave a gap in its outline, and an area without meaning.
    """
    result, cells = label.copy(), mesh.all_cells
    mask = np.zeros(len(label), dtype=bool)
    mask[new] = True
    near = cells[mask[cells].any(axis=1)]
    edges = np.sort(np.concatenate([near[:, [0, 1]], near[:, [1, 2]], near[:, [2, 0]]]), axis=1)
    edges, times = np.unique(edges[mask[edges].any(axis=1)], axis=0, return_counts=True)
    hull = edges[times == 1]
    both = np.concatenate([hull, hull[:, ::-1]])
    while True:  # several may follow each other
        found = both[(result[both[:, 0]] < 0) & mask[both[:, 0]] & (result[both[:, 1]] >= 0)]
        if not len(found):
            return np.asarray(result)
        result[found[:, 0]] = result[found[:, 1]]


def chain_directions(position: Array, pairs: Array, index: Array, otherwise: Array) -> Array:
    """Directions (K, 2) at particles (K,) by `chain_tangents`, and ``otherwise`` (K, 2) where the chain ends."""
    ends, result = np.zeros((2, len(position)), dtype=bool), otherwise.copy()
    ends[(0, 1), pairs] = True
    both = (ends[0] & ends[1])[index]
    if both.any():
        result[both] = chain_tangents(position, pairs, index[both], no_period(2))
    return np.asarray(result)


def put_back(position: Array, pairs: Array, moves: Array, label: Array, outlines: Mapping[int, Outline]) -> Array:
    """Positions (N, 2) on curves of bodies [m], moved along their normals so that each body has its area.

    ``pairs`` are the faces, see `body_faces`, ``moves`` (N,) masks those on curves of several edges.
    """
    for b, outline in outlines.items():
        if outline.curved:
            mine = pairs[label[pairs[:, 0]] == b]
            x = position - position[mine[:, 0]].mean(axis=0)  # the area is a small difference far from the origin
            position = position + restored(x, mine, moves, outline.area, no_period(2)) - x
    return position
