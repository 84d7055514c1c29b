"""Slices of flows in three dimensions: tetrahedra cut by a plane, as a scene that is drawn like a flow in the plane."""

import re
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array, vstack
from scipy.spatial import ConvexHull, QhullError

from .arrays import Array
from .blocks import section
from .bodies import PlacedBody
from .faces import outer_faces
from .polygons import fill_loops
from .scene import Scene
from .tank import TankOutline
from .volume import Volume

AXES = "xyz"
_ON = 1e-6  # distance within which a particle is on the plane [spacings], and a value at its level


class Plane(NamedTuple):
    """A plane across an axis."""

    axis: int  # its number
    value: float  # of this coordinate [m]

    @classmethod
    def of(cls, text: str) -> "Plane":
        """The plane of a text such as "y=0.5"; `ValueError` for other forms."""
        found = re.fullmatch(r"\s*([xyz])\s*=\s*(\S+)\s*", text) if isinstance(text, str) else None
        try:
            if found is not None and np.isfinite(value := float(found[2])):
                return cls(AXES.index(found[1]), value)
        except ValueError:
            pass
        raise ValueError(f"slice {text!r}: expected an axis and its coordinate in metres, for example y=0.5")

    def __str__(self) -> str:
        return f"{AXES[self.axis]}={self.value:g}"

    def within(self, lower: Array, upper: Array) -> "Plane":
        """This plane, if it cuts the box between two corners (3,) [m]; else `ValueError`."""
        low, high = lower[self.axis], upper[self.axis]
        if not low < self.value < high:
            name = AXES[self.axis]
            raise ValueError(f"slice {self}: expected {name} between {low:g} and {high:g}, inside the tank")
        return self


def sliced(volume: Volume, plane: Plane) -> Scene:
    """The scene in a plane; values between the particles are linear in each tetrahedron, as in the method.

    Where particles carry the fluids, they meet where the share of each fluid's particles is one half. Drops in no cell
    are shown where they are within half a spacing of the plane.

    Args:
        volume: what is cut.
        plane: see `Plane.within`.
    """
    across = [axis for axis in range(3) if axis != plane.axis]
    across = [axis for axis in across if axis != volume.up] + [axis for axis in across if axis == volume.up]
    off = volume.position[:, plane.axis] - plane.value
    off = np.where(np.abs(off) < _ON * volume.spacing, 0.0, off)
    weights, triangles, parent, wall = _cut(volume, off)
    several = len(volume.fluid_names)
    if volume.cell_fluid is None and several > 1:
        shares = np.eye(several)[volume.fluid]
        for fluid in range(several - 1):
            weights, triangles, parent, wall = _split(weights, triangles, parent, wall, weights @ shares[:, fluid])
        owner = (weights @ shares)[triangles].mean(axis=1).argmax(axis=1) if len(triangles) else parent
    else:
        owner = (np.zeros(len(volume.cells), int) if volume.cell_fluid is None else volume.cell_fluid)[parent]
    outline, corners = _outline(volume, off, plane, across)
    drops = np.flatnonzero(volume.loose & (np.abs(off) < volume.spacing / 2))
    single = csr_array((np.ones(len(drops)), (np.arange(len(drops)), drops)), (len(drops), len(off)))
    weights = vstack([weights, single, corners]).tocsr()
    count = weights.shape[0]
    if not count:
        raise ValueError(f"slice {plane} at t = {volume.time:g} s: there is nothing in this plane")
    flags = np.zeros(count, bool)
    flags[: len(wall)] = wall
    flags[count - corners.shape[0] :] = True
    position = (weights @ volume.position)[:, across]
    nearest = np.zeros(count, int)
    for fluid in range(1, several):
        nearest[weights @ (volume.fluid == fluid) > 0.5] = fluid

    def in_plane(_: str, values: Array) -> Array:
        return np.asarray(weights @ (values[:, plane.axis] if values.ndim == 2 else values))

    # Corners as in scenes: anticlockwise.
    u, v = (position[triangles[:, k]] - position[triangles[:, 0]] for k in (1, 2))
    turned = u[:, 0] * v[:, 1] < u[:, 1] * v[:, 0]
    triangles[turned] = triangles[turned][:, ::-1]
    place = f"{AXES[plane.axis]} = {plane.value:g} m"
    same = ("time", "fluid_names", "fluid_densities", "spacing", "digits", "span")
    return Scene(
        position=position,
        cells=triangles,
        fluid=nearest,
        wall=flags,
        fields=volume.fields.changed(in_plane),
        cell_fields=volume.cell_fields.changed(lambda _, values: values[parent]),
        lower=volume.lower[across],
        upper=volume.upper[across],
        cell_fluid=owner,
        title=f"{volume.title}, {place}" if volume.title else place,
        bodies=_sections(volume, plane, across),
        tank=None if outline is None else TankOutline(outline, volume.spacing).at_start(),
        plane=(AXES[across[0]], AXES[across[1]]),
        **{name: getattr(volume, name) for name in same},
    )


def _cut(volume: Volume, off: Array) -> tuple[csr_array, Array, Array, Array]:
    """Triangles in a plane at distances ``off`` (N,): weights (P, N), points (T, 3), cells (T,), walls (P,)."""
    below = off[volume.cells] < 0
    number = below.sum(axis=1)
    found, parents = [], []
    for low in (1, 2, 3):
        cell = np.flatnonzero(number == low)
        order = np.argsort(~below[cell], axis=1, kind="stable")  # those below first
        a, b, c, d = np.take_along_axis(volume.cells[cell], order, axis=1).T
        sides = {1: [(a, b), (a, c), (a, d)], 2: [(a, c), (a, d), (b, d), (b, c)], 3: [(a, d), (b, d), (c, d)]}[low]
        pairs = np.stack([np.stack(side, axis=1) for side in sides], axis=1).reshape(len(cell), len(sides), 2)
        for corners in ([0, 1, 2], [0, 2, 3])[: len(sides) - 2]:
            found.append(pairs[:, corners])
            parents.append(cell)
    ends = np.concatenate(found).reshape(-1, 2)
    ends = np.where((off[ends[:, 1]] == 0)[:, None], ends[:, 1:], ends)  # a particle on the plane is one point
    keys, pairs, number = _unique(ends, len(off))
    share = _crossing(off, pairs)
    rows = np.arange(len(pairs))
    entries = np.concatenate([1 - share, share]), (np.concatenate([rows, rows]), pairs.T.ravel())
    triangles, parent = number.reshape(-1, 3), np.concatenate(parents)
    kept = np.all(triangles != np.roll(triangles, 1, axis=1), axis=1)
    faces = outer_faces(volume.cells, volume.position)
    faces = faces[volume.wall[faces].all(axis=1)]
    along = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]], faces[:, [0, 0]], faces[:, [1, 1]]])
    wall = np.isin(keys, _unique(np.concatenate([along, faces[:, [2, 2]]]), len(off))[0])
    return csr_array(entries, (len(pairs), len(off))), triangles[kept], parent[kept], wall


def _split(
    weights: csr_array, triangles: Array, parent: Array, wall: Array, share: Array
) -> tuple[csr_array, Array, Array, Array]:
    """Triangles of `_cut` cut where a value (P,) at their points is one half."""
    share = np.where(np.abs(share - 0.5) < _ON, 0.5, share) - 0.5
    corners = share[triangles]
    crossed = (corners < 0).any(axis=1) & (corners > 0).any(axis=1)
    # The corner that is alone below or above first; one at the level is on the side of two.
    at = corners[crossed]
    alone = np.where((at < 0).sum(axis=1) == 1, (at < 0).argmax(axis=1), (at > 0).argmax(axis=1))
    turned = np.take_along_axis(triangles[crossed], (alone[:, None] + np.arange(3)) % 3, axis=1)
    a, b, c = turned.T
    count = len(share)

    def cut(ends: Array) -> Array:
        return np.where((share[ends] == 0)[:, None], ends[:, None], np.stack([a, ends], axis=1))

    pairs = np.concatenate([cut(b), cut(c)])
    keys, ends, number = _unique(pairs, count)
    within = _crossing(share, ends)[:, None]
    new = weights[ends[:, 0]].multiply(1 - within) + weights[ends[:, 1]].multiply(within)
    sides = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    side, times = np.unique(np.sort(sides, axis=1) @ np.array([count, 1]), return_counts=True)
    held = wall[ends].all(axis=1) & (np.isin(keys, side[times == 1]) | (ends[:, 0] == ends[:, 1]))
    p, q = count + number[: len(a)], count + number[len(a) :]
    parts = [np.stack(part, axis=1) for part in ((a, p, q), (p, b, c), (p, c, q))]
    made = np.concatenate([triangles[~crossed], *parts])
    owner = np.concatenate([parent[~crossed], np.tile(parent[crossed], 3)])
    # A point at the level is one, and triangles that it leaves without an area are none.
    same = np.arange(count + len(ends))
    whole = ends[:, 0] == ends[:, 1]
    same[count:][whole] = ends[whole, 0]
    made = same[made]
    kept = np.all(made != np.roll(made, 1, axis=1), axis=1)
    return vstack([weights, new]).tocsr(), made[kept], owner[kept], np.concatenate([wall, held])


def _crossing(values: Array, pairs: Array) -> Array:
    """Share (K,) of the way along pairs (K, 2) at which values (N,) pass zero; 0 where both ends are one point."""
    one, other = values[pairs].T
    return np.asarray(one / np.where(one == other, 1.0, one - other))


def _unique(pairs: Array, count: int) -> tuple[Array, Array, Array]:
    """Different ones of pairs (S, 2) of numbers below count, in any order: keys (K,), ends (K, 2), numbers (S,)."""
    low, high = np.sort(pairs, axis=1).astype(np.int64).T
    keys, first, number = np.unique(low * count + high, return_index=True, return_inverse=True)
    return keys, np.stack([low[first], high[first]], axis=1), number.reshape(-1)


def _sections(volume: Volume, plane: Plane, across: list[int]) -> tuple[PlacedBody, ...]:
    """The blocks where the plane cuts them."""
    polygons = [polygon[:, across] for polygon in section(volume.blocks_now, plane.axis, plane.value)]
    return tuple(PlacedBody(corners, fill_loops([corners]), None) for corners in polygons)


def _outline(volume: Volume, off: Array, plane: Plane, across: list[int]) -> tuple[dict[str, object] | None, csr_array]:
    """The walls' outline in the plane as `TankOutline` takes it, and weights (C, N) of its corners; none with blocks.

    ``off`` (N,) are the distances of the particles from the plane, ``across`` the axes in it.
    """
    walls, none = np.flatnonzero(volume.wall), csr_array((0, len(off)))
    if volume.blocks is not None:  # that of the box: particles may be on no corner of it
        found = [box[:, across] for box in section(volume.blocks.walls(volume.pose)[None], plane.axis, plane.value)]
        loops = [{"corners": places[ConvexHull(places).vertices]} for places in found]
        return ({"loops": loops, "reference": loops[0]["corners"][0]} if loops else None), none
    try:
        hull = walls[ConvexHull(volume.position[walls]).simplices]
        sides = np.concatenate([hull[:, [0, 1]], hull[:, [1, 2]], hull[:, [2, 0]]])
        sides = _unique(sides, len(off))[1]
        sides = sides[off[sides].prod(axis=1) < 0]
        share = (off[sides[:, 0]] / (off[sides[:, 0]] - off[sides[:, 1]]))[:, None]
        places = ((1 - share) * volume.position[sides[:, 0]] + share * volume.position[sides[:, 1]])[:, across]
        ring = ConvexHull(places).vertices
    except (QhullError, ValueError, IndexError):  # walls that enclose nothing here
        return None, none
    points = places[ring]
    before, after = points - np.roll(points, 1, axis=0), np.roll(points, -1, axis=0) - points
    bend = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    ring = ring[bend > 1e-6 * np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1)]
    rows, ends, part = np.arange(len(ring)), sides[ring], share[ring, 0]
    entries = np.concatenate([1 - part, part]), (np.concatenate([rows, rows]), ends.T.ravel())
    facts = {"loops": [{"corners": places[ring]}], "reference": places[ring[0]]}
    return facts, csr_array(entries, (len(ring), len(off)))
