"""Delaunay triangulation of the particles, by SciPy (Qhull)."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import Delaunay, QhullError

from tipfem.errors import TriangulationError
from tipfem.geometry.period import Period, no_period
from tipfem.mesh.constrained import cells_inside
from tipfem.mesh.mesh import Mesh, simplex_measure
from tipfem.typing import Array

# A simplex of wall particles with less than this measure [h^d] has no area except by round-off: it is on a straight
# wall.
SLIVER = 1e-6
# Qhull's usual options, and Q0: without merging nearly flat facets, which takes half of the time.
QUICK = "Qbb Qc Qz Q12 Q0"
# Closer than this to a circle through three others, relative to the circle's size, a particle is on it.
TIE = 1e-9
# Strain along a line that breaks ties; what it may do to an edge is one, too.
STRETCH = 1e-7
EVEN = 1e-6
# Distance of points around all particles, relative to these; and relative error of the volume of the cells in between.
AWAY, WHOLE = 10.0, 1e-9


def delaunay(
    position: Array, spacing: float, wall: Array | None = None, volume: float | None = None
) -> tuple[Array, Array, Array]:
    """Delaunay simplices of all particles, flat ones included.

    Where the particles are, and how turned or mirrored, does not matter: ties between cocircular ones are broken by a
    small strain along a line that their numbers draw. In 2-D, diagonals then alternate, see `alternated`.

    Args:
        position: (N, d) [m].
        spacing: h [m], the unit of the measures returned.
        wall: (N,) mask of the wall particles. If given, this takes half of the time in 2-D, unless others, or five of
            these, are cocircular.
        volume: of their hull, in 3-D [m^3]. If given, and all faces of the hull are flat walls, this takes 15 % of
            the time, and no simplex is flat: Qhull then has points far around the particles, and no facets of many.

    Returns:
        Simplices (M, d + 1), positively oriented, int32; their measures (M,) [h^d]; and their neighbours (M, d + 1):
        the number of the simplex opposite each corner, -1 for none.

    Raises:
        TriangulationError: Qhull failed.
    """
    # Qhull loses points silently when the cloud is far from the origin.
    centred = (position - 0.5 * (position.min(axis=0) + position.max(axis=0))) / spacing
    if wall is not None and position.shape[1] == 2:
        try:
            found = _oriented(centred, centred, QUICK)
            if _is_unique(centred, *found, wall):
                return _even(centred, *found)
        except QhullError:
            pass
    if volume is not None:
        found = _strained(centred, AWAY * np.abs(centred).max() * np.concatenate([np.eye(3), -np.eye(3)]))
        if abs(float(found[1].sum()) * spacing**3 / volume - 1) < WHOLE:
            return found
    found = _strained(centred)
    return _even(centred, *found) if position.shape[1] == 2 else found


def _even(position: Array, cells: Array, measure: Array, neighbours: Array) -> tuple[Array, Array, Array]:
    """The triangles with the diagonals of `alternated`, as by `delaunay`."""
    if (even := alternated(position[cells], measure, cells, neighbours)) is not cells:
        return even, np.abs(simplex_measure(position, even)), Mesh(position, even).neighbours
    return cells, measure, neighbours


def _strained(position: Array, around: Array | None = None) -> tuple[Array, Array, Array]:
    """Simplices of ``position`` (N, d), Delaunay after a small strain, without those with points ``around``."""
    weight = np.random.default_rng(0).uniform(-1.0, 1.0, len(position))
    line = (weight - weight.mean()) @ position
    strained = position + np.outer(position @ line, line * (STRETCH / (line @ line)))
    if around is not None:
        strained = np.concatenate([strained, around])
    try:
        return _oriented(position, strained, None)
    except QhullError as error:
        raise TriangulationError(f"Qhull cannot triangulate the particles: {error}") from error


def _oriented(position: Array, strained: Array, options: str | None) -> tuple[Array, Array, Array]:
    """Qhull's simplices of ``strained``, measures and neighbours, as by `delaunay`, without points added to N."""
    found = Delaunay(strained, qhull_options=options)
    cells, neighbours = found.simplices.astype(np.int32), found.neighbors.copy()
    if len(strained) > len(position):
        inner = np.append((cells < len(position)).all(axis=1), False)
        number = np.where(inner, np.cumsum(inner) - 1, -1).astype(np.int32)
        cells, neighbours = cells[inner[:-1]], number[neighbours[inner[:-1]]]
    measure = simplex_measure(position, cells)
    flip = measure < 0
    cells[flip, :2], neighbours[flip, :2] = cells[flip, 1::-1], neighbours[flip, 1::-1]
    return cells, np.abs(measure), neighbours


def _is_unique(position: Array, cells: Array, measure: Array, neighbours: Array, wall: Array) -> bool:
    """Whether triangles are the only Delaunay ones of ``position`` (N, 2), but for four cocircular wall particles.

    Then none is flat, their number follows from that of the particles by Euler's formula, and the particle opposite
    each edge is outside the circumcircle.
    """
    edges = int((neighbours < 0).sum())
    if (measure < SLIVER).any() or len(cells) != 2 * len(position) - 2 - edges:
        return False
    slot, over, inside = _circles(position[cells], neighbours)
    close = inside > -TIE
    fluid = ~wall[cells[slot[close] // 3]].all(axis=1) | ~wall[cells.ravel()[over[close]]]
    alone = np.bincount(np.concatenate([slot[close], over[close]]) // 3, minlength=1).max() < 2
    return not fluid.any() and bool(alone and (inside[close] < TIE).all())


def _circles(corner: Array, neighbours: Array) -> tuple[Array, Array, Array]:
    """Inner edges (E,) by the corners opposite on both sides, and how far one is inside the other's circle.

    Corners are 3 * triangle + local of ``corner`` (M, 3, 2); ``neighbours`` (M, 3). The distance is over the size.
    """
    first = np.arange(len(corner))[:, None]
    slot = np.flatnonzero((neighbours >= 0) & (neighbours < first))
    cell, other = slot // 3, neighbours.ravel()[slot]
    over = 3 * other + np.argmax(neighbours[other] == cell[:, None], axis=1)
    # In complex numbers: both coordinates at once.
    point = np.ascontiguousarray(corner).view(np.complex128).reshape(-1, 3)
    local, there = slot % 3, over % 3
    apex = point[other, there] - point[other, (there + 1) % 3] + point[cell, (local + 2) % 3]
    a, b, c = offset = point[cell].T - apex
    square = offset.real**2 + offset.imag**2
    inside = square[0] * (b.conj() * c).imag + square[1] * (c.conj() * a).imag + square[2] * (a.conj() * b).imag
    return slot, over, inside / square.max(axis=0) ** 2


def alternated(corner: Array, measure: Array, cells: Array, neighbours: Array) -> Array:
    """Triangles (M, 3) with flips of the diagonals of cocircular quadrilaterals.

    The sides of these join even particles with odd ones, of which the lowest is even; diagonals join even ones. So they
    alternate on a lattice. Where they cannot, as beside three that are on a line, and where five are cocircular, they
    stay. ``corner`` (M, 3, 2) are places, ``measure`` (M,) is in h^2.
    """
    slot, over, inside = _circles(corner, neighbours)
    tie = (np.abs(inside) < EVEN) & (np.minimum(measure[slot // 3], measure[over // 3]) > SLIVER)
    slot, over = slot[tie], over[tie]
    ties = np.bincount(np.concatenate([slot, over]) // 3, minlength=len(cells))
    alone = (ties[slot // 3] == 1) & (ties[over // 3] == 1)
    (t, i), (o, j) = np.divmod(slot[alone], 3), np.divmod(over[alone], 3)
    around = np.stack([cells[t, i], cells[t, (i + 1) % 3], cells[o, j], cells[t, (i + 2) % 3]])
    flip = (_odd(around) == [[False], [True], [False], [True]]).all(axis=0)
    # Far from a wall its particles and any other are cocircular up to round-off.
    here, there = corner[t, i], corner[o, j] - corner[o, (j + 1) % 3] + corner[t, (i + 2) % 3]
    for one, other in ((corner[t, (i + 1) % 3], there), (there, corner[t, (i + 2) % 3])):
        (a, b), (c, d) = (one - here).T, (other - here).T
        flip &= 0.5 * (a * d - b * c) > SLIVER
    if not flip.any():
        return cells
    (p, c, q, d), cells = around[:, flip], cells.copy()
    cells[t[flip]], cells[o[flip]] = np.stack([p, c, q], axis=1), np.stack([p, q, d], axis=1)
    return cells


def _odd(around: Array) -> Array:
    """Mask of the corners (4, K) of quadrilaterals that are an odd number of sides away from the lowest particle."""
    one, other = around.ravel(), np.roll(around, -1, axis=0).ravel()
    graph = csr_array((np.ones(len(one)), (one, other)), shape=(around.max(initial=-1) + 1,) * 2)
    lowest = np.unique(connected_components(graph, directed=False)[1], return_index=True)[1]
    away = dijkstra(graph, directed=False, indices=lowest, unweighted=True, min_only=True)
    return np.asarray(away[around] % 2 == 1)


def triangulate(
    position: Array,
    wall: Array,
    spacing: float,
    boundary: Array | None = None,
    period: Period | None = None,
    volume: float | None = None,
) -> Mesh:
    """Delaunay mesh of all particles without slivers along straight walls; cells sorted by their lowest particles.

    In 2-D it has the edges ``boundary`` (E, 2), with the fluids on their left, and is Delaunay otherwise; by default
    they fill the convex hull, or there is a ``period``. The spacing h [m] is the scale of what counts as flat; for
    ``volume`` see `delaunay`. `TriangulationError` if Qhull failed or left out a particle, or a flat simplex has one
    off the walls.
    """
    if period:
        cells, measure = delaunay_periodic(position, spacing, period)
    elif boundary is None:
        cells, measure, _ = delaunay(position, spacing, volume=volume)
    else:
        cells, measure, _ = inside(position, wall, spacing, boundary)
    flat = (measure < SLIVER) & wall[cells].all(axis=1) & (boundary is None)
    cells = cells[~flat]
    if (measure[~flat] <= 1e-14).any():
        i = int(cells[np.argmin(measure[~flat])].max())
        raise TriangulationError(f"a simplex at particle {i}, {position[i].tolist()}, has no area")
    used = np.zeros(len(position), dtype=bool)
    used[cells.ravel()] = True
    if not used.all():
        i = int(np.argmin(used))
        raise TriangulationError(f"particle {i} at {position[i].tolist()} is in no simplex of the mesh")
    # Sorted, neighbouring cells are close in memory, which halves the time of loops over them.
    order = np.argsort(cells.min(axis=1), kind="stable")
    return Mesh(
        position, np.ascontiguousarray(cells[order]), period=no_period(position.shape[1]) if period is None else period
    )


def delaunay_periodic(position: Array, spacing: float, period: Period) -> tuple[Array, Array]:
    """Delaunay triangles (M, 3) and measures (M,) [h^2] of a domain whose first axis or both are periodic.

    They are those of the particles and of their images on all sides, flat ones along walls included; of the images of a
    triangle, the one that has its lowest particle inside the domain is kept. The images have one triangulation, because
    the strain that breaks ties is the same for all. Particles of walls are on lines along the first axis.
    `TriangulationError` if Qhull failed, or the triangles do not fill the domain once.
    """
    count, owner, points = len(position), np.arange(len(position)), position
    for k in period.axes:  # images half a width beyond the ends; those along one axis have images along the other
        left = position[owner, k] < 0.5 * period.width[k]
        beyond = np.concatenate([np.flatnonzero(left), np.flatnonzero(~left)])
        images = points[beyond]
        images[:, k] += np.where(left[beyond], period.width[k], -period.width[k])
        owner, points = np.concatenate([owner, owner[beyond]]), np.concatenate([points, images])
    cells, _, _ = _strained(points / spacing)
    lowest = np.take_along_axis(cells, np.argmin(owner[cells], axis=1)[:, None], axis=1)[:, 0]
    cells = owner[cells[lowest < count]].astype(np.int32)
    mesh = Mesh(position, cells, period=period)
    cells = alternated(mesh.corners(), mesh.measure / spacing**2, cells, mesh.neighbours)
    measure = Mesh(position, cells, period=period).measure / spacing**2
    domain = np.where(period.width > 0, period.width, np.ptp(position, axis=0)).prod() / spacing**2
    if abs(measure.sum() - domain) > 1e-6 * domain:
        text = f"the triangles of a periodic domain of {domain:g} spacings squared have an area of {measure.sum():g}"
        raise TriangulationError(text)
    return cells, measure


def inside(position: Array, wall: Array, spacing: float, boundary: Array) -> tuple[Array, Array, Array]:
    """The triangles inside a boundary (E, 2), on its left, Delaunay but for its edges; see `cells_inside`."""
    cells, measure, neighbours = delaunay(position, spacing, wall)
    flat = (measure < SLIVER) & wall[cells].all(axis=1)
    kept = cells_inside(position, cells, neighbours, boundary, flat)
    number = np.full(len(cells) + 1, -1, dtype=neighbours.dtype)  # the last one is for -1, beyond the hull
    number[kept] = np.arange(len(kept))
    cells = np.ascontiguousarray(cells[kept])
    return cells, simplex_measure(position, cells) / spacing**2, number[neighbours[kept]]


def wall_fluid(mesh: Mesh, fluid: Array, wall: Array) -> Array:
    """The fluids (N,), of every wall particle that of the closest particle of the fluids connected to it.

    A wall particle that is connected to wall particles only (in a corner) takes the fluid of the closest of those that
    already have one.
    """
    fluid = fluid.copy()
    known = ~wall
    i, j = mesh.edges.T
    at_wall = wall[i] | wall[j]
    i, j = i[at_wall], j[at_wall]
    length = np.linalg.norm(mesh.sides(j, i), axis=1)
    one, other = np.concatenate([i, j]), np.concatenate([j, i])
    length = np.concatenate([length, length])
    order = np.lexsort((other, length, one))
    one, other = one[order], other[order]
    while not known.all():
        usable = ~known[one] & known[other]
        if not usable.any():
            break
        target, first = np.unique(one[usable], return_index=True)
        fluid[target] = fluid[other[usable][first]]
        known[target] = True
    return fluid
