"""Delaunay triangulation of the particles, by SciPy (Qhull)."""

from __future__ import annotations

import numpy as np
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
# Displacements that break the ties between cocircular particles of periodic domains [spacings].
TIE_BREAK = 1e-7


def delaunay(position: Array, spacing: float, wall: Array | None = None) -> tuple[Array, Array, Array]:
    """Delaunay simplices of all particles, flat ones included.

    Args:
        position: (N, d) [m].
        spacing: h [m], the unit of the measures returned.
        wall: (N,) mask of the wall particles. If given, either diagonal of four cocircular wall particles will do;
            in 2-D this takes half of the time, unless other particles are cocircular.

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
            found = _oriented(centred, QUICK)
            if _is_unique(centred, *found, wall):
                return found
        except QhullError:
            pass
    try:
        return _oriented(centred, None)
    except QhullError as error:
        raise TriangulationError(f"Qhull cannot triangulate the particles: {error}") from error


def _oriented(position: Array, options: str | None) -> tuple[Array, Array, Array]:
    """Qhull's simplices of ``position`` (N, d), their measures and neighbours, as `delaunay` returns them."""
    found = Delaunay(position, qhull_options=options)
    cells, neighbours = found.simplices.astype(np.int32), found.neighbors.copy()
    measure = simplex_measure(position, cells)
    flip = measure < 0
    cells[flip, :2], neighbours[flip, :2] = cells[flip, 1::-1], neighbours[flip, 1::-1]
    return cells, np.abs(measure), neighbours


def _is_unique(position: Array, cells: Array, measure: Array, neighbours: Array, wall: Array) -> bool:
    """Whether triangles are the only Delaunay triangulation of ``position`` (N, 2), but for cocircular wall particles.

    Then none is flat, their number follows from that of the particles by Euler's formula, and the particle opposite
    each edge is outside the circumcircle.
    """
    edges = int((neighbours < 0).sum())
    if (measure < SLIVER).any() or len(cells) != 2 * len(position) - 2 - edges:
        return False
    # In complex numbers: both coordinates at once.
    point = np.ascontiguousarray(position).view(np.complex128).ravel()
    first = np.arange(len(cells))[:, None]
    edge = np.flatnonzero((neighbours >= 0) & (neighbours < first))
    cell, other = edge // 3, neighbours.ravel()[edge]
    around = cells.sum(axis=1)
    apex = around[other] - around[cell] + cells.ravel()[edge]  # the corner of the other triangle off the edge
    a, b, c = offset = point.take(cells.T.take(cell, axis=1)) - point.take(apex)
    square = offset.real**2 + offset.imag**2
    inside = square[0] * (b.conj() * c).imag + square[1] * (c.conj() * a).imag + square[2] * (a.conj() * b).imag
    close = inside > -TIE * square.max(axis=0) ** 2
    fluid = ~wall[cells[cell[close]]].all(axis=1) | ~wall[apex[close]]
    return not fluid.any() and bool((inside[close] < TIE * square[:, close].max(axis=0) ** 2).all())


def triangulate(
    position: Array, wall: Array, spacing: float, boundary: Array | None = None, period: Period | None = None
) -> Mesh:
    """Delaunay mesh of all particles.

    Args:
        position: (N, d) [m].
        wall: (N,) mask of the wall particles.
        spacing: target distance h between particles [m], the scale of what counts as flat.
        boundary: (E, 2) the edges that bound the fluids, with the fluids on their left, in 2-D; by default they fill
            the convex hull. The mesh has these edges, and is Delaunay otherwise.
        period: of the positions, none by default; with one, in 2-D, there is no ``boundary``.

    Returns:
        The mesh without slivers along straight walls; cells are positively oriented and sorted by their lowest
        particles.

    Raises:
        TriangulationError: Qhull failed or left out a particle, or a flat simplex has a particle off the walls.
    """
    if period:
        cells, measure = delaunay_periodic(position, wall, spacing, period)
    elif boundary is None:
        cells, measure, _ = delaunay(position, spacing)
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


def delaunay_periodic(position: Array, wall: Array, spacing: float, period: Period) -> tuple[Array, Array]:
    """Delaunay triangles of a domain whose first axis or both are periodic, flat ones along walls included.

    They are those of the particles and of their images on all sides; of the images of a triangle, the one that has
    its lowest particle inside the domain is kept. The images must have one triangulation: so ties between cocircular
    particles are broken by displacements that are the same for all images of a particle.

    Args:
        position: (N, 2) [m], inside the domain.
        wall: (N,) mask of the wall particles, on lines along the first axis; none if both axes are periodic.
        spacing: h [m], the unit of the measures returned.
        period: of the positions.

    Returns:
        Triangles (M, 3), positively oriented, int32, and their measures (M,) [h^2].

    Raises:
        TriangulationError: Qhull failed, or the triangles do not fill the domain once.
    """
    count, owner, points = len(position), np.arange(len(position)), position
    for k in period.axes:  # images half a width beyond the ends; those along one axis have images along the other
        left = position[owner, k] < 0.5 * period.width[k]
        beyond = np.concatenate([np.flatnonzero(left), np.flatnonzero(~left)])
        images = points[beyond]
        images[:, k] += np.where(left[beyond], period.width[k], -period.width[k])
        owner, points = np.concatenate([owner, owner[beyond]]), np.concatenate([points, images])
    apart = TIE_BREAK * spacing * np.random.default_rng(0).uniform(-1.0, 1.0, position.shape)
    apart[wall, 1] = 0.0
    cells, measure, _ = delaunay(points + apart[owner], spacing)
    lowest = np.take_along_axis(cells, np.argmin(owner[cells], axis=1)[:, None], axis=1)[:, 0]
    once = lowest < count
    cells, measure = cells[once], measure[once]
    domain = np.where(period.width > 0, period.width, np.ptp(position, axis=0)).prod() / spacing**2
    if abs(measure.sum() - domain) > 1e-6 * domain:
        text = f"the triangles of a periodic domain of {domain:g} spacings squared have an area of {measure.sum():g}"
        raise TriangulationError(text)
    return owner[cells].astype(np.int32), measure


def inside(position: Array, wall: Array, spacing: float, boundary: Array) -> tuple[Array, Array, Array]:
    """The triangles inside a boundary, Delaunay but for its edges, as `delaunay` returns all.

    Args:
        position: (N, 2) [m].
        wall: (N,) mask of the wall particles.
        spacing: h [m], the unit of the measures returned.
        boundary: (E, 2) its edges, with the inside on their left.

    Raises:
        TriangulationError: Qhull failed, or an edge cannot be recovered.
    """
    cells, measure, neighbours = delaunay(position, spacing, wall)
    flat = (measure < SLIVER) & wall[cells].all(axis=1)
    kept = cells_inside(position, cells, neighbours, boundary, flat)
    number = np.full(len(cells) + 1, -1, dtype=neighbours.dtype)  # the last one is for -1, beyond the hull
    number[kept] = np.arange(len(kept))
    cells = np.ascontiguousarray(cells[kept])
    return cells, simplex_measure(position, cells) / spacing**2, number[neighbours[kept]]


def wall_fluid(mesh: Mesh, fluid: Array, wall: Array) -> Array:
    """Assign to every wall particle the fluid of the closest particle of the fluids connected to it.

    A wall particle that is connected to wall particles only (in a corner) takes the fluid of
    the closest of those that already have one.

    Args:
        mesh: the mesh on N particles.
        fluid: (N,) fluid of each particle; values at wall particles are not used.
        wall: (N,) mask of the wall particles.

    Returns:
        (N,) fluid of each particle, wall particles included.
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
