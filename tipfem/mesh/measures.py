"""Measures of a mesh: fronts and depths of fluids; hydrostatic pressure of layers; which cell a place is in."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tipfem.case.fluid import Fluid
from tipfem.mesh.mesh import Mesh, corners_among
from tipfem.typing import Array

INWARDS = np.array([1e-8, 0.618e-8])  # part of the way to the opposite side by which lines in 3-D are moved


class Energy(NamedTuple):
    """Energy of all particles: kinetic and potential [J, per metre of depth in 2-D]."""

    kinetic: float
    potential: float


def locate(mesh: Mesh, places: Array) -> tuple[Array, Array]:
    """The cell (K,) that contains each of ``places`` (K, d), -1 for none, and barycentric weights (K, d + 1)."""
    d = mesh.dimension
    corner = mesh.corners()  # (M, d + 1, d)
    low, high = corner.min(axis=1), corner.max(axis=1)
    cell, weights = np.full(len(places), -1), np.zeros((len(places), d + 1))
    slack = 1e-9 * (high - low).max()
    for k, place in enumerate(places):
        # The place's image beside each cell; without periodic sides the place itself.
        images = corner[:, 0] + mesh.period.shortest(place - corner[:, 0]) if mesh.period else place
        near = np.flatnonzero(((low - slack <= images) & (images <= high + slack)).all(axis=1))
        if not len(near):
            continue
        sides = (corner[near, 1:] - corner[near, :1]).transpose(0, 2, 1)
        inner = np.linalg.solve(sides, mesh.period.shortest(place - corner[near, 0])[:, :, None])[:, :, 0]
        all_weights = np.concatenate([1 - inner.sum(axis=1, keepdims=True), inner], axis=1)
        best = int(np.argmax(all_weights.min(axis=1)))
        if all_weights[best].min() > -1e-7:
            cell[k], weights[k] = near[best], all_weights[best]
    return cell, weights


def extent(mesh: Mesh, fluid: Array, index: int, axis: int) -> float:
    """Largest coordinate that a fluid reaches along an axis [m], NaN without any of it.

    Where every cell has one fluid, these are the fluid's cells. Otherwise the fluid (N,) of particles reaches to the
    middle of the edges that join it to another; particles in no cell do not count.
    """
    if mesh.fluid is not None:
        cells = mesh.cells[mesh.fluid == index]
        return float(mesh.position[:, axis].take(cells).max()) if len(cells) else float("nan")
    own = (fluid == index) & mesh.used
    if not own.any():
        return float("nan")
    coordinate = mesh.position[:, axis]
    i, j = mesh.edges.T
    mixed = own[i] != own[j]
    middle = 0.5 * (coordinate[i[mixed]] + coordinate[j[mixed]])
    return float(max(coordinate[own].max(), middle.max(initial=-np.inf)))


def depth(mesh: Mesh, fluid: Array, index: int, place: float) -> float:
    """Length of a fluid along the vertical line x = ``place`` of a 2-D mesh [m]; `ValueError` if it does not cross it.

    Where every cell has one fluid, whole cells count. Otherwise cells between fluids are cut through the middle of
    their edges: three triangles at the corners, and a fourth between them that belongs to the fluid of most corners (in
    a cell of three fluids, of the first).
    """
    fluid, x, y, cells, owner = _crossed(mesh, fluid, place, "depth")
    if owner is not None:
        return float(_chord(x[cells], y[cells])[owner == index].sum())
    total = 0.0
    for triangle, label in _mid_edge_pieces(cells, fluid):
        px = np.stack([x[a] / 2 + x[b] / 2 for a, b in triangle], axis=1)
        py = np.stack([y[a] / 2 + y[b] / 2 for a, b in triangle], axis=1)
        total += float(_chord(px, py)[label == index].sum())
    return total


def spans(mesh: Mesh, index: int, place: Array, axis: int) -> tuple[float, float]:
    """Highest point of a fluid on a line along an axis of a 3-D mesh, NaN without any, and its length there [m].

    ``place`` (2,) has the line's other coordinates, in their order [m]; cells have one fluid each.
    """
    across, along = np.delete(mesh.position, axis, axis=1), mesh.position[:, axis]
    # A line along a wall, or an edge of the tank, would be in the face of a cell, or of several.
    across = across - (place + INWARDS * (across.min(axis=0) + across.max(axis=0) - 2 * place))
    met = np.asarray(mesh.fluid) == index
    for at in across.T:
        met &= (corners_among(at <= 0, mesh.cells) > 0) & (corners_among(at >= 0, mesh.cells) > 0)
    cells = mesh.cells[met]
    if not len(cells):
        return math.nan, 0.0
    # The shape functions of the corners along the line, start + rate * s, are not negative in a cell.
    side = np.concatenate([across, along[:, None]], axis=1)[cells]
    rows = np.linalg.inv(np.concatenate([side, np.ones((len(cells), 4, 1))], axis=2)).transpose(0, 2, 1)
    rate, start = rows[:, :, 2], rows[:, :, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        zero = -start / rate
    low = np.where(rate > 0, zero, np.where((rate == 0) & (start < 0), np.inf, -np.inf)).max(axis=1)
    high = np.where(rate < 0, zero, np.inf).min(axis=1)
    met = high >= low
    return (float(high[met].max()) if met.any() else math.nan), float((high - low)[met].sum())


def volume_within(corner: Array, lower: Array, upper: Array) -> float:
    """Volume that tetrahedra with the corners (M, 4, 3) have in a box from ``lower`` (3,) to ``upper`` (3,) [m^3]."""
    for axis in range(3):
        for value, sign in ((lower[axis], 1.0), (upper[axis], -1.0)):
            corner = _beyond(corner, sign * (corner[:, :, axis] - value))
    a, b, c = (corner[:, k] - corner[:, 0] for k in (1, 2, 3))
    return float(np.abs((np.cross(a, b) * c).sum(axis=1)).sum() / 6)


def _beyond(corner: Array, height: Array) -> Array:
    """Tetrahedra (K, 4, 3) that fill what others (M, 4, 3) have where the heights (M, 4) of their corners are above 0.

    Those that a plane cuts are a corner, a corner less than the whole, or a wedge with a face at each end.
    """
    above = height > 0
    count = above.sum(axis=1)
    parts = [corner[count == 4]]
    # The corners above the plane first.
    order = np.argsort(~above, axis=1, kind="stable")
    x, h = np.take_along_axis(corner, order[:, :, None], axis=1), np.take_along_axis(height, order, axis=1)

    def cut(here: Array, i: int, j: int) -> Array:
        part = h[here, i] / (h[here, i] - h[here, j])
        return np.asarray(x[here, i] + part[:, None] * (x[here, j] - x[here, i]))

    one, two, three = (np.flatnonzero(count == k) for k in (1, 2, 3))
    parts.append(np.stack([x[one, 0], cut(one, 0, 1), cut(one, 0, 2), cut(one, 0, 3)], axis=1))
    wedges = (
        ((x[two, 0], cut(two, 0, 2), cut(two, 0, 3)), (x[two, 1], cut(two, 1, 2), cut(two, 1, 3))),
        ((x[three, 0], x[three, 1], x[three, 2]), (cut(three, 0, 3), cut(three, 1, 3), cut(three, 2, 3))),
    )
    for (a, b, c), (d, e, f) in wedges:
        parts += [np.stack(each, axis=1) for each in ((a, b, c, d), (b, c, d, e), (c, d, e, f))]
    return np.concatenate(parts)


def area_vectors(position: Array, corners: Array) -> Array:
    """Area vectors (E, 3) of triangles (E, 3) at positions (N, 3) [m^2]."""
    a, b, c = position[corners.T]
    return 0.5 * np.cross(b - a, c - a)


def outward(cells: Array, cell: Array, i: Array) -> Array:
    """Corners (K, 3) of the faces opposite to corners ``i`` (K,) of tetrahedra (K,), with normals out of these."""
    order = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])
    return np.asarray(cells[cell[:, None], order[i]])


def faces_at_empty_space(mesh: Mesh) -> tuple[Array, Array]:
    """Cells of fluids (K,) and their corners (K,) opposite to the faces beside empty space."""
    surface = mesh.surface
    if surface.empty is None or surface.beside is None:
        none = np.zeros(0, dtype=np.int64)
        return none, none
    row, i = np.nonzero((surface.beside >= 0) & (surface.beside < len(mesh.cells)))
    face, cell = outward(surface.empty, row, i), surface.beside[row, i]
    return cell, np.argmin((mesh.cells[cell][:, :, None] == face[:, None, :]).any(axis=2), axis=1)


def wall_faces(mesh: Mesh) -> tuple[Array, Array]:
    """Corners (K, 3) of the faces of the hull of tetrahedra that are not beside empty space, and their cells (K,)."""
    hull = mesh.neighbours < 0
    hull[faces_at_empty_space(mesh)] = False
    cell, i = np.nonzero(hull)
    return outward(mesh.cells, cell, i), cell


def surface_height(mesh: Mesh, fluid: Array, index: int, place: float) -> float:
    """Height of the highest point of a fluid on the vertical line x = ``place`` [m], NaN without any; see `depth`."""
    fluid, x, y, cells, owner = _crossed(mesh, fluid, place, "height")
    if owner is not None:
        own = cells[owner == index]
        return _highest(x[own], y[own])
    highest = math.nan
    for triangle, label in _mid_edge_pieces(cells, fluid):
        px = np.stack([x[a] / 2 + x[b] / 2 for a, b in triangle], axis=1)[label == index]
        py = np.stack([y[a] / 2 + y[b] / 2 for a, b in triangle], axis=1)[label == index]
        highest = float(np.fmax(highest, _highest(px, py)))
    return highest


def _crossed(mesh: Mesh, fluid: Array, place: float, what: str) -> tuple[Array, Array, Array, Array, Array | None]:
    """Find the nodes and cells of a mesh that a vertical line crosses.

    Returns:
        Of N nodes, maybe copies of particles, the fluid (N,), and places (N,) off the line and (N,) along it [m]; of K
        cells the nodes (K, 3) and, where cells have fluids, these (K,).
    """
    left, right = ends(mesh)
    if not left <= place <= right:
        raise ValueError(f"{what}: the line x = {place:g} m does not cross the mesh of {left:g} to {right:g} m")
    # A line along the left wall would be in no element's interior.
    line = max(place, left + 1e-9 * (right - left))
    mesh, fluid = _around(mesh, fluid, line)
    x, y = mesh.position[:, 0] - line, mesh.position[:, 1]
    before = (x < 0).take(mesh.cells.T)
    crossed = np.flatnonzero(before.any(axis=0) & ~before.all(axis=0))
    return fluid, x, y, mesh.cells[crossed], None if mesh.fluid is None else mesh.fluid[crossed]


def ends(mesh: Mesh) -> tuple[float, float]:
    """The least and the largest x of a mesh [m]; with a periodic first axis, of its domain."""
    if mesh.period:
        return 0.0, float(mesh.period.width[0])
    return float(mesh.position[:, 0].min()), float(mesh.position[:, 0].max())


def _around(mesh: Mesh, fluid: Array, line: float) -> tuple[Mesh, Array]:
    """The mesh, and the fluid of its nodes; with a periodic first axis, one that has the line x = ``line`` inside."""
    if not mesh.period:
        return mesh, fluid
    position = mesh.position.copy()
    position[:, 0] = line + mesh.period.shortest(position[:, 0] - line, 0)
    middle = 0.5 * mesh.period.width[0]
    position[:, 0] += middle - line
    unrolled, owner = replace(mesh, position=mesh.period.wrapped(position)).unrolled
    unrolled.position[:, 0] += line - middle
    return unrolled, fluid[owner]


def _highest(x: Array, y: Array) -> float:
    """Largest y at x = 0 of triangles with corners x, y (K, 3); NaN where none crosses it."""
    highest = math.nan
    for a, b in ((0, 1), (1, 2), (2, 0)):
        cut = (x[:, a] < 0) != (x[:, b] < 0)
        weight = x[cut, a] / (x[cut, a] - x[cut, b])
        if cut.any():
            highest = float(np.fmax(highest, ((1 - weight) * y[cut, a] + weight * y[cut, b]).max()))
    return highest


def _mid_edge_pieces(cells: Array, fluid: Array) -> list[tuple[list[tuple[Array, Array]], Array]]:
    """Four triangles a cell through the mid-edges, as pairs of particles, and fluids; inside that of most corners."""
    a, b, c = cells.T
    fa, fb, fc = fluid[a], fluid[b], fluid[c]
    most = np.where((fb == fc) & (fa != fb), fb, fa)
    pieces = [
        ([(a, a), (a, b), (a, c)], fa),
        ([(b, b), (b, c), (a, b)], fb),
        ([(c, c), (a, c), (b, c)], fc),
        ([(a, b), (b, c), (a, c)], most),
    ]
    return pieces


def _chord(x: Array, y: Array) -> Array:
    """Length (K,) of the line x = 0 inside triangles with corners x, y (K, 3)."""
    order = np.argsort(x, axis=1)
    x, y = np.take_along_axis(x, order, axis=1), np.take_along_axis(y, order, axis=1)
    cut = (x[:, 0] < 0) & (x[:, 2] >= 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        long_side = y[:, 0] - x[:, 0] * (y[:, 2] - y[:, 0]) / (x[:, 2] - x[:, 0])
        left = y[:, 0] - x[:, 0] * (y[:, 1] - y[:, 0]) / (x[:, 1] - x[:, 0])
        right = y[:, 2] - x[:, 2] * (y[:, 1] - y[:, 2]) / (x[:, 1] - x[:, 2])
    other = np.where(x[:, 1] >= 0, left, right)
    return np.where(cut, np.abs(long_side - other), 0.0)


def area_within(corners: Array, lower: Array, upper: Array, *, axial: bool = False) -> Array:
    """Area (K,) [m^2], of rings volume [m^3], of triangles (K, 3, 2) in a box from ``lower`` to ``upper`` [m]."""
    polygon = corners
    for axis in (0, 1):
        for sense, bound in ((1.0, lower[axis]), (-1.0, upper[axis])):
            if math.isfinite(bound):
                polygon = _clipped(polygon, sense * (polygon[..., axis] - bound))
    x, y = polygon[..., 0], polygon[..., 1]
    double = x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1)
    area = 0.5 * double.sum(axis=1)
    if axial:
        area = math.pi / 3 * (double * (x + np.roll(x, -1, axis=1))).sum(axis=1)
    return np.asarray(np.abs(area))


def _clipped(polygon: Array, height: Array) -> Array:
    """Convex polygons (K, 2n, 2): the parts of others (K, n, 2) where a linear ``height`` (K, n) is not negative.

    The corners outside become the point where the outline leaves, but the last of them has that where it enters, too.
    """
    inside, after = height >= 0, np.roll(height, -1, axis=1)
    differ = height != after
    part = np.where(differ, height / np.where(differ, height - after, 1.0), 0.0)
    ends = polygon + part[..., None] * (np.roll(polygon, -1, axis=1) - polygon)
    leaves, enters = inside & (after < 0), ~inside & (after >= 0)
    rows = np.arange(len(polygon))
    left, entered = (ends[rows, np.argmax(there, axis=1)][:, None] for there in (leaves, enters))
    first = np.where(inside[..., None], polygon, left)
    second = np.where(inside[..., None], polygon, np.where(enters[..., None], entered, left))
    clipped = np.stack([first, second], axis=2).reshape(len(polygon), 2 * polygon.shape[1], 2)
    clipped[~inside.any(axis=1)] = 0.0
    return np.asarray(clipped)


# Points of Dunavant's rule of degree 5 for triangles, in barycentric coordinates, and their weights. D. A. Dunavant,
# "High degree efficient symmetrical Gaussian quadrature rules for the triangle", 1985, doi:10.1002/nme.1620210612.
_NEAR, _FAR = (6 + math.sqrt(15)) / 21, (6 - math.sqrt(15)) / 21
_POINTS = np.array(
    [[1 / 3] * 3] + [[1 - 2 * a if k == j else a for k in range(3)] for a in (_NEAR, _FAR) for j in range(3)]
)
_WEIGHTS = np.array([9 / 40] + [(155 + math.sqrt(15)) / 1200] * 3 + [(155 - math.sqrt(15)) / 1200] * 3)


def wave_integrals(x: Array, area: Array, number: float) -> tuple[float, float]:
    """Integrals of cos(k x) and sin(k x), k = ``number``, over triangles with corners x (K, 3) and areas (K,) [m^2]."""
    phase = number * (x @ _POINTS.T)
    return float(area @ (np.cos(phase) @ _WEIGHTS)), float(area @ (np.sin(phase) @ _WEIGHTS))


def hydrostatic_pressure(height: Array, layers: Sequence[tuple[Fluid, float]], gravity: float = 9.81) -> Array:
    """Pressure (K,) [Pa] at heights over the floor of layers (fluid, thickness [m]) at rest, from the floor up."""
    height = np.asarray(height, dtype=float)
    pressure, floor = np.zeros_like(height), 0.0
    for fluid, thickness in layers:
        covered = np.clip(floor + thickness - height, 0.0, thickness)
        pressure += fluid.density * gravity * covered
        floor += thickness
    return pressure
