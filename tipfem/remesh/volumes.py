"""Volumes of fluids whose interfaces run along edges: each connected body of a fluid keeps its own.

The constraint J = 1 holds at particles, for the elements around them together. At an interface these
belong to two fluids, and what one loses the other gains: nothing in the equations tells them apart,
no source can. So the loss is measured after every step, body by body, and undone by moving the interface.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tipfem.mesh.mesh import Mesh, simplex_measure
from tipfem.remesh import volume_kernels as kernels
from tipfem.typing import Array


class Known(NamedTuple):
    """Of triangles (M, 3) in K bodies, some of whose particles may move.

    Attributes:
        measure: (M,) their areas [m^2].
        volume: (K,) of the bodies [m^2].
        near: numbers of the triangles with a particle that may move.
    """

    measure: Array
    volume: Array
    near: Array


class Stock(NamedTuple):
    """What K bodies of fluids have, in M triangles on N particles.

    Attributes:
        body: (M,) number of the connected body of one fluid that each triangle belongs to, from 0.
        at: (F, N) a body of each of the fluids at each particle, -1 for none.
        mark: (N,) see `triangulation.marks`.
        measure: (M,) areas [m^2].
        volume: (K,) of the bodies [m^2].
        fluid: (K,) of the bodies.
        free: (K,) 1 for bodies with a particle on an interface and off the hull.
        near: numbers of the triangles with such a particle.
    """

    body: Array
    at: Array
    mark: Array
    measure: Array
    volume: Array
    fluid: Array
    free: Array
    near: Array


def take_stock(
    position: Array, cells: Array, across: Array, fluid: Array, fluids: int, mark: Array | None = None
) -> Stock:
    """What bodies there are and what they have.

    Args:
        position: (N, 2) [m].
        cells, across, fluid: see `edge_operations`; what is said of cells that are gone has no meaning.
        fluids: F.
        mark: (N,) if it is known.
    """
    elements, particles = len(cells), len(position)
    body, near, measure = np.empty(elements, dtype=np.int32), np.empty(elements, dtype=np.int32), np.empty(elements)
    volume, of, free = np.zeros(elements), np.zeros(elements, dtype=np.int32), np.zeros(elements, dtype=np.int32)
    at, count = np.full((fluids, particles), -1, dtype=np.int32), np.zeros(2, dtype=np.int32)
    marks = np.zeros(particles, dtype=np.int32) if mark is None else mark
    kernels.take_stock(
        *map(np.ascontiguousarray, (position, cells, across, fluid)),
        body,
        marks,
        measure,
        volume,
        of,
        free,
        near,
        at,
        count,
        elements,
        particles,
        int(mark is not None),
    )
    number, beside = count.tolist()
    return Stock(body, at, marks, measure, volume[:number], of[:number], free[:number], near[:beside])


def bodies(across: Array, fluid: Array) -> Array:
    """Number (M,) of the connected body of one fluid that each triangle belongs to, from 0.

    Args:
        across: (M, 3) neighbours, -1 for none.
        fluid: (M,) of each triangle.
    """
    return take_stock(np.zeros((1, 2)), np.zeros_like(across), across, fluid, int(fluid.max()) + 1).body


def bodies_of(mesh: Mesh) -> Array:
    """Number (M,) of the body of each triangle of a mesh that knows its fluids, see `bodies`; found once."""
    found = mesh.__dict__.get("bodies")
    if found is None:
        assert mesh.fluid is not None
        found = mesh.__dict__["bodies"] = bodies(mesh.neighbours, mesh.fluid)
    return np.asarray(found)


def bodies_at(mesh: Mesh, fluids: int) -> Array:
    """(F, N) a body of each of the fluids at each particle of a mesh that knows its fluids, -1 for none; found once."""
    found = mesh.__dict__.get("bodies_at")
    if found is None or len(found) != fluids:
        assert mesh.fluid is not None
        # Of a particle's bodies of one fluid any will do.
        found = take_stock(mesh.position, mesh.cells, mesh.neighbours, mesh.fluid, fluids).at
        mesh.__dict__["bodies_at"] = found
    return np.asarray(found)


def restore(
    position: Array,
    new: Mesh,
    mark: Array | None,
    old: Mesh,
    moved: Array,
    relocated: Array,
    total: Array | None,
    limit: float,
    fluids: int | None = None,
) -> Array:
    """Positions (N, 2) at which each body has the volume that it should have.

    Args:
        position: (N, 2) after remeshing [m].
        new: the triangles there, which know their fluids and neighbours; it learns its areas at the result, its bodies
            and its marks.
        mark: (N,) 1 for particles on an interface and off the hull; None to find them.
        old: the mesh of the step, at its start.
        moved: (M,) areas of the old triangles after the step's motion [m^2].
        relocated: (N,) mask of the particles that were set elsewhere.
        total: (F,) volume that each fluid is to have [m^2]; by default what it had after the motion.
        limit: of a particle's shift in a round [m].
        fluids: F; by default as many as there are in the triangles.
    """
    assert old.fluid is not None
    assert new.fluid is not None
    fluids = max(int(old.fluid.max()), int(new.fluid.max())) + 1 if fluids is None else fluids
    stock, before = take_stock(position, new.cells, new.neighbours, new.fluid, fluids, mark), bodies_of(old)
    new.__dict__.update(bodies=stock.body, bodies_at=stock.at, measure=stock.measure, marks=stock.mark)
    changes = np.zeros(int(before.max()) + 1) if total is None else np.bincount(before, weights=old.measure - moved)
    loss = inherit(bodies_at(old, fluids), stock.at, changes, relocated, len(stock.volume))
    total = np.bincount(old.fluid, weights=moved, minlength=fluids) if total is None else total
    wanted = share_out(stock.volume, loss, stock.fluid, total, stock.free > 0)
    known = Known(stock.measure, stock.volume, stock.near)
    return move_interfaces(position, new.cells, stock.body, stock.mark == 1, wanted, limit, known)


def inherit(old: Array, new: Array, loss: Array, moved: Array, number: int) -> Array:
    """What bodies of a new mesh have to make good of the losses of those of the old one.

    A body hands its loss on in equal parts with its particles: so bodies may merge and split.

    Args:
        old: (F, N) from `bodies_at`.
        new: the same after remeshing; of more particles, maybe.
        loss: (K,) of the old bodies [m^2].
        moved: (N,) mask of particles that were set elsewhere; they hand on nothing.
        number: of new bodies.

    Returns:
        (K',) loss of the new bodies [m^2]; that of a body which is gone is in none.
    """
    result, parts = np.zeros(number), np.zeros(len(loss), dtype=np.int32)
    kernels.hand_on(old, new, moved.view(np.int8), loss, parts, result, *old.shape)
    return result


def share_out(volume: Array, loss: Array, fluid: Array, total: Array, free: Array) -> Array:
    """Volumes (K,) that bodies are to have: each its own loss back, and what a fluid still lacks by size.

    Args:
        volume: (K,) that the bodies have [m^2].
        loss: (K,) of the bodies [m^2].
        fluid: (K,) of the bodies.
        total: (F,) that each fluid is to have [m^2].
        free: (K,) whether the body's surface can move; others keep what they have.
    """
    wanted = np.where(free, np.maximum(volume + loss, 0.5 * volume), volume)
    has = np.bincount(fluid, weights=wanted, minlength=len(total))
    part = np.bincount(fluid, weights=wanted * free, minlength=len(total))
    if not part.any():
        return wanted
    lack = np.where(part > 0, total - has, 0.0)
    # A fluid that is gone cannot get its volume back; the others must still fill the tank.
    lack -= (lack.sum() + wanted.sum() - volume.sum()) * part / part.sum()
    return np.asarray(wanted + lack[fluid] * wanted * free / np.maximum(part[fluid], 1e-300))


def move_interfaces(
    position: Array, cells: Array, body: Array, movable: Array, wanted: Array, limit: float, known: Known | None = None
) -> Array:
    """Where particles go so that bodies get the volumes wanted.

    Every movable particle shifts by sum_k lambda_k dV_k / dx, with the factors lambda that give the volumes; a few
    rounds, for volumes are quadratic in positions.

    Args:
        position: (N, 2) [m].
        cells: (M, 3) triangles.
        body: (M,) of each.
        movable: (N,) mask of the particles that may move: those of interfaces, off the walls.
        wanted: (K,) volumes [m^2].
        limit: of a particle's shift in one round [m].
        known: what is known of it already; its areas are changed to those at the new positions.

    Returns:
        (N, 2) new positions.
    """
    nodes = np.flatnonzero(movable).astype(np.int32)
    if not len(nodes):
        return position
    x = position.copy()
    if known is None:
        measure, near = simplex_measure(x, cells), np.empty(len(cells), dtype=np.int32)
        count = kernels.triangles_at(cells, np.ascontiguousarray(movable).view(np.int8), near, len(cells))
        known = Known(measure, np.bincount(body, weights=measure, minlength=len(wanted)), near[:count])
    measure, volume, near = known
    count, head = len(near), np.full(len(x), -2, dtype=np.int32)
    chain, gradient, way = np.empty((3 * count, 2), dtype=np.int32), np.empty((3 * count, 2)), np.empty((len(x), 4))
    for _ in range(4):
        missing = wanted - volume
        if np.abs(missing).max() <= 1e-14 * wanted.sum():
            break
        gram, gain = np.zeros((len(wanted), len(wanted))), np.zeros(len(wanted))
        kernels.gradients(x, cells, body, near, nodes, head, chain, gradient, gram, count, len(nodes))
        # The volumes' sum is that of the tank: one combination of the factors moves nothing.
        factor = np.linalg.lstsq(gram, missing, rcond=1e-10)[0]
        if not kernels.shift_interfaces(
            x, cells, body, near, nodes, head, chain, gradient, factor, way, measure, gain, limit, count, len(nodes)
        ):
            break
        volume = volume + gain
    return x
