"""Cut the mesh where fluids meet.

If every cell has a fluid, nothing is cut: the interface consists of the edges between cells of different fluids. If
the particles carry the fluid, a cell whose particles differ is cut at the mid-points of its edges: the single particle
keeps the corner triangle (a quarter of the area), the other two the quadrilateral. With three fluids the cuts run from
the mid-points to the centroid, a third of the area each. The line between two colours is the interface as the method
represents it, not a contour.
"""

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, Delaunay

from .arrays import Array


class FluidRegions(NamedTuple):
    """The cells split by fluid."""

    triangles: Array  # (T, 3, 2) corners [m]
    fluid: Array  # (T,) fluid of each triangle
    segments: Array  # (S, 2, 2) ends of the interface segments [m]


class Edges(NamedTuple):
    """The edges of cells, each once, in the order of their particles' numbers."""

    pairs: Array  # (E, 2) particles, the lower number first
    first: Array  # (E,) where the sides of each edge begin in ``sides``
    shared_by: Array  # (E,) number of cells that share each edge; 1 on the mesh's boundary
    sides: Array  # (3 M,) sides of the cells by edge: M k + m is the side of cell m from its corner k to the next one


def fluid_regions(
    position: Array, cells: Array, fluid: Array, cell_fluid: Array | None = None, edges: Edges | None = None
) -> FluidRegions:
    """Split the cells (M, 3) by fluid, of the particles (N,) or of the cells (M,), if not None."""
    if cell_fluid is not None:
        known = cell_edges(cells) if edges is None else edges
        return FluidRegions(position[cells], cell_fluid, position[_edges_between(known, cell_fluid)])
    a, b, c = fluid[cells].T
    pure = (a == b) & (b == c)
    three = (a != b) & (b != c) & (c != a)
    two = ~(pure | three)

    # Turn each two-fluid cell so that its single particle comes first; the orientation is kept.
    single = np.where(b == c, 0, np.where(a == c, 1, 2))[two]
    turned = np.take_along_axis(cells[two], (single[:, None] + np.arange(3)) % 3, axis=1)
    i, j, k = np.moveaxis(position[turned], 1, 0)
    ij, ik = (i + j) / 2, (i + k) / 2
    one, other = fluid[turned[:, 0]], fluid[turned[:, 1]]

    p, q, r = np.moveaxis(position[cells[three]], 1, 0)
    centre = (p + q + r) / 3
    pq, qr, rp = (p + q) / 2, (q + r) / 2, (r + p) / 2
    corners = [(p, pq, rp), (q, qr, pq), (r, rp, qr)]  # corner, next mid-point, previous mid-point

    triangles = [position[cells[pure]], _stack(i, ij, ik), _stack(ij, j, k), _stack(ij, k, ik)]
    owners = [a[pure], one, other, other]
    segments = [_stack(ij, ik)]
    for n, (corner, after, before) in enumerate(corners):
        triangles += [_stack(corner, after, centre), _stack(corner, centre, before)]
        owners += [fluid[cells[three][:, n]]] * 2
        segments += [_stack(after, centre)]
    return FluidRegions(np.concatenate(triangles), np.concatenate(owners), np.concatenate(segments))


def cell_edges(cells: Array) -> Edges:
    """The edges of ``cells`` (M, 3)."""
    count = 3 * len(cells)
    if count == 0:
        none = np.empty(0, np.int64)
        return Edges(np.empty((0, 2), np.int64), none, none, none)
    low, high = np.empty(count, np.int64), np.empty(count, np.int64)
    for k in range(3):
        part = slice(k * len(cells), (k + 1) * len(cells))
        np.minimum(cells[:, k], cells[:, (k + 1) % 3], out=low[part])
        np.maximum(cells[:, k], cells[:, (k + 1) % 3], out=high[part])
    # Pair and side in one number: NumPy sorts numbers several times as fast as it sorts their order.
    base, bits = int(high.max()) + 1, count.bit_length()
    keys = low * base + high
    if (base * base) << bits < 1 << 63:
        packed = np.sort((keys << bits) | np.arange(count))
        keys, sides = packed >> bits, packed & ((1 << bits) - 1)
    else:
        sides = np.argsort(keys, kind="stable")
        keys = keys[sides]
    first = np.flatnonzero(np.diff(keys, prepend=-1))
    pairs = np.stack(np.divmod(keys[first], base), axis=1)
    return Edges(pairs, first, np.diff(first, append=count), sides)


def outer_sides(position: Array, cells: Array) -> tuple[Array, Array]:
    """Starts (S,) and ends (S,) of the sides that one cell alone has, with that cell on the left.

    Of a particle that cells surround, its cells' next corners are those before, too: the sums of their numbers are the
    same, here of random numbers. Of their own numbers they may be, too, where two outlines touch. The sides between the
    other particles are few, and compared one by one.
    """
    (ax, bx, cx), (ay, by, cy) = (axis[cells.T] for axis in position.T)
    clockwise = (bx - ax) * (cy - ay) < (by - ay) * (cx - ax)
    a, b, c = np.where(clockwise, cells[:, ::-1].T, cells.T)
    count = len(position)
    code = np.random.default_rng(0).integers(1 << 32, size=count).astype(float)
    rim = np.zeros(count)
    for corner, after, before in ((a, b, c), (b, c, a), (c, a, b)):
        rim += np.bincount(corner, code[after] - code[before], count)
    open_ = rim != 0
    ends = [(one, other, open_[one] & open_[other]) for one, other in ((a, b), (b, c), (c, a))]
    starts, stops = (np.concatenate([side[k][side[2]] for side in ends]) for k in (0, 1))
    key = np.minimum(starts, stops).astype(np.int64) * count + np.maximum(starts, stops)
    _, number, shared_by = np.unique(key, return_inverse=True, return_counts=True)
    single = shared_by[number] == 1
    return starts[single], stops[single]


def edge_means(edges: Edges, values: Array, chosen: Array | slice = slice(None)) -> Array:
    """Mean (E, K) on each edge, or the ``chosen`` ones, over the cells that share it, of the cells' values (M, K)."""
    first, shared_by = edges.first[chosen], edges.shared_by[chosen]
    if len(first) == 0:
        return np.empty((0, values.shape[1]))
    if edges.shared_by.max() <= 2:
        one, other = (values[edges.sides[place] % len(values)] for place in (first, first + shared_by - 1))
        return np.asarray((one + other) / 2)
    total = np.add.reduceat(values[edges.sides % len(values)], edges.first)
    return np.asarray((total / edges.shared_by[:, None])[chosen])


def particle_fluids(cells: Array, fluid: Array, cell_fluid: Array) -> tuple[Array, Array]:
    """Fluid (N,) of each particle by its cells, and mask (N,) of those between fluids, which keep ``fluid`` (N,)."""
    lowest, highest = _extremes(cells.ravel(), np.repeat(cell_fluid, 3), len(fluid))
    return np.where(lowest == highest, lowest, fluid), lowest < highest


def loose_particles(cells: Array, wall: Array) -> tuple[Array, Array]:
    """Masks (N,) of the particles off the walls, and of wall particles, that are in no cell; none without cells."""
    unused = np.full(len(wall), len(cells) > 0)
    unused[cells] = False
    return unused & ~wall, unused & wall


def walls_around(position: Array, wall: Array) -> tuple[Array, Array]:
    """Edges (S, 2) around the wall particles, none for fewer than three, and triangles (T, 3) between them."""
    index = np.flatnonzero(wall)
    if len(index) < 3:
        return np.empty((0, 2), np.int64), np.empty((0, 3), np.int64)
    around = index[ConvexHull(position[index] - position[index].mean(axis=0)).vertices]
    edges = np.stack([around, np.roll(around, -1)], axis=1)
    return edges, np.stack([np.full(len(around), around[0]), *edges.T], axis=1)


def solid_triangles(position: Array, border: Array, area: float) -> tuple[Array, Array, Array, Array]:
    """Solid parts within the convex hull of the walls, with edges ``border`` (B, 2) and an area between them [m^2].

    Triangles (T, 3) of the Delaunay triangulation of the points along walls, among them some between the walls; the
    radii (T,) up to which each is filled [m], see `_whole_radii`; edges (S, 2) of the hull that are no wall, and their
    radii (S,) [m]. None if the area is all of the hull.
    """
    walls = np.unique(border)
    none = np.empty((0, 3), np.int64), np.empty(0), np.empty((0, 2), np.int64), np.empty(0)
    if len(walls) < 3:
        return none
    points = position[walls] - position[walls].mean(axis=0)
    if ConvexHull(points).volume - area < 1e-9 * np.ptp(points) ** 2:
        return none
    triangulation = Delaunay(points)
    found = walls[triangulation.simplices]
    corners = position[found]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    with np.errstate(divide="ignore"):
        radius = sides.prod(axis=1) / (4 * areas(position, found))
    around = np.sort(walls[triangulation.convex_hull], axis=1)
    key, known = (pairs @ np.array([len(position), 1]) for pairs in (around, np.sort(border, axis=1)))
    feet = around[~np.isin(key, known)]
    return found, *_whole_radii(position, border, found, radius, feet)


def _whole_radii(
    position: Array, border: Array, found: Array, radius: Array, feet: Array
) -> tuple[Array, Array, Array]:
    """Circumradii of triangles, 0 for those of parts that are solid however large they are drawn.

    These parts are holes in a tank, and what stands on a wall or hangs from it, so that the wall goes on at both sides
    of its foot, as a block on the floor. Others, as what is beside an L, are open: only their walls are drawn, and what
    is too thin between these. ``found`` (T, 3) are the triangles with circumradii (T,) [m], ``feet`` (S, 2) the edges
    of the hull that are no wall. Returned are radii (T,), feet (S, 2), and half of their lengths (S,), or 0 of those
    parts.
    """
    count, way = len(found), position[feet[:, 1]] - position[feet[:, 0]]
    length = np.linalg.norm(way, axis=1)
    base = np.array([len(position), 1])
    sides = np.sort(np.stack([found, np.roll(found, -1, axis=1)], axis=2).reshape(-1, 2), axis=1) @ base
    owner = np.repeat(np.arange(count), 3)
    shared = ~np.isin(sides, np.sort(border, axis=1) @ base)
    order = np.flatnonzero(shared)[np.argsort(sides[shared], kind="stable")]
    pair = np.flatnonzero(sides[order][1:] == sides[order][:-1])
    one, other = owner[order[pair]], owner[order[pair + 1]]
    _, part = connected_components(coo_array((np.ones(len(one)), (one, other)), (count, count)), directed=False)
    both = np.concatenate([border, border[:, ::-1]])
    along = position[both[:, 1]] - position[both[:, 0]]
    along /= np.linalg.norm(along, axis=1, keepdims=True)

    def goes_on(corner: int, direction: Array) -> bool:
        there = along[both[:, 0] == corner]
        return bool((abs(there[:, 0] * direction[1] - there[:, 1] * direction[0]) < 1e-3).any())

    units = way / length[:, None]
    flush = np.array([goes_on(a, u) and goes_on(b, u) for (a, b), u in zip(feet, units, strict=True)], bool)
    place = np.argsort(sides)
    on = part[owner[place[np.searchsorted(sides, feet @ base, sorter=place)]]]
    beside = on[~flush]
    return np.where(np.isin(part, beside), radius, 0.0), feet, np.where(np.isin(on, beside), length / 2, 0.0)


def areas(position: Array, cells: Array) -> Array:
    """Areas (M,) of triangles (M, 3) [m^2]."""
    a, b, c = (position[cells[:, k]] for k in range(3))
    return np.asarray(abs((b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])) / 2)


def _edges_between(edges: Edges, cell_fluid: Array) -> Array:
    """Edges (S, 2) whose cells belong to different fluids."""
    if len(edges.first) == 0:
        return edges.pairs
    fluid = cell_fluid[edges.sides % len(cell_fluid)]
    differ = np.minimum.reduceat(fluid, edges.first) != np.maximum.reduceat(fluid, edges.first)
    return np.asarray(edges.pairs[differ])


def _extremes(index: Array, values: Array, count: int) -> tuple[Array, Array]:
    """Lowest and highest of the values of each index, both (count,); without a value, highest is -1."""
    lowest, highest = np.full(count, np.iinfo(np.int64).max), np.full(count, -1)
    np.minimum.at(lowest, index, values)
    np.maximum.at(highest, index, values)
    return lowest, highest


def _stack(*points: Array) -> Array:
    return np.stack(points, axis=1)
