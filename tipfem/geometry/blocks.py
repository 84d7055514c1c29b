"""Boxes with blocks in them: regions in 3-D whose walls are planes along the axes, with edges into the fluid."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.ndimage import generate_binary_structure, label

from tipfem.geometry.box_sides import SIDES
from tipfem.geometry.polyhedron import Polyhedron
from tipfem.typing import Array

JITTER, DEEP = 0.1, 1.2  # of points in blocks, and how deep they are, lest a cell join one with a particle [spacings]


class BlockedBox(Polyhedron):
    """A box from the origin without the blocks in it, boxes themselves, which may touch and overlap.

    The box has a ``size`` (3,), the blocks lower and upper corners (2, 3) by their names [m], see ``record``. ``names``
    of planes are those of the side of the box, or of a block and of its side; ``outer`` (S,) masks the sides of the
    box; ``joined`` are names of the blocks with a side that goes on in that of another one, and has only one of their
    names; ``volume`` is that of the region [m^3]. See `Polyhedron` for other attributes. `ValueError` if nothing is
    left of the box, blocks cut it in two, or two of them, or two parts of the region, touch at an edge or at a corner
    alone.
    """

    convex = False

    def __init__(self, size: Array, blocks: Mapping[str, Array]) -> None:
        self.record: dict[str, Any] = {"size": size, "blocks": dict(blocks)}
        self._size, slack = size, 1e-9 * size.max()
        self._cuts = [
            _distinct([0.0, length, *(x for b in blocks.values() for x in b[:, k])], length, slack)
            for k, length in enumerate(size.tolist())
        ]
        middle = [0.5 * (cuts[1:] + cuts[:-1]) for cuts in self._cuts]
        at = np.stack(np.meshgrid(*middle, indexing="ij"), axis=-1)
        # Number of the block that fills each cell between cuts, -1 for none, with a row around: the box's walls.
        of = np.full(np.array(at.shape[:3]) + 2, len(blocks))
        of[1:-1, 1:-1, 1:-1] = -1
        for number, box in enumerate(blocks.values()):
            inside = ((at > box[0]) & (at < box[1])).all(axis=-1)
            of[1:-1, 1:-1, 1:-1][inside & (of[1:-1, 1:-1, 1:-1] < 0)] = number
        self._solid = of >= 0
        self._require_one_region()
        cells = np.stack(np.meshgrid(*(np.diff(cuts) for cuts in self._cuts), indexing="ij"), axis=-1).prod(axis=-1)
        self.volume, self.whole = float(cells[~self._solid[1:-1, 1:-1, 1:-1]].sum()), float(cells.sum())
        side_name = {side: name for name, side in SIDES.items()}
        self.joined: set[str] = set()
        found: list[tuple[str, int, float, bool, Array, bool]] = []
        for axis in range(3):
            for k, place in enumerate(self._cuts[axis].tolist()):
                below, above = (np.take(of, k + step, axis)[1:-1, 1:-1] for step in (0, 1))
                for low, behind, before in ((True, below, above), (False, above, below)):
                    face = (behind >= 0) & (before < 0)
                    if not face.any():
                        continue
                    # Of blocks each side is a plane of its own, but where those of two go on in each other.
                    masks: dict[int, Array] = {}
                    parts = label(face)[0]
                    for part in range(1, parts.max() + 1):
                        owners = np.unique(behind[parts == part])
                        masks[int(owners[0])] = masks.get(int(owners[0]), False) | (parts == part)
                        self.joined |= {list(blocks)[k] for k in owners if len(owners) > 1 and k < len(blocks)}
                    for own, mask in masks.items():
                        outer = own == len(blocks)
                        side = side_name[axis, low != outer]
                        name = side if outer else f"{list(blocks)[own]} {side}"
                        found.append((name, axis, place, low, mask, outer))
        self.names = tuple(each[0] for each in found)
        self._axis, place = np.array([each[1] for each in found]), np.array([each[2] for each in found])
        sign = np.array([1.0 if each[3] else -1.0 for each in found])
        self._faces, self.outer = [each[4] for each in found], np.array([each[5] for each in found])
        self.normal = sign[:, None] * np.eye(3)[self._axis]
        self.offset = sign * place
        self.direction, self.sense = np.zeros_like(self.normal), np.ones(len(found))

    def _require_one_region(self) -> None:
        """See the class for errors."""
        solid = self._solid
        if solid.all() or label(~solid, generate_binary_structure(3, 1))[1] > 1:
            raise ValueError("must leave one part of the tank, with a way from each place in it to each other")
        for axis in range(3):
            one, other = (k for k in range(3) if k != axis)
            four = [np.roll(solid, (-i, -j), (one, other)) for i, j in itertools.product((0, 1), repeat=2)]
            if ((four[0] == four[3]) & (four[1] == four[2]) & (four[0] != four[1])).any():
                raise ValueError("must not touch each other, or a wall, at an edge alone")
        ways = list(itertools.product((0, 1), repeat=3))
        eight = {way: np.roll(solid, [-k for k in way], (0, 1, 2)) for way in ways}
        total = sum(each.astype(int) for each in eight.values())
        for way in ways:
            here, far = eight[way], eight[tuple(1 - k for k in way)]
            if ((here & far & (total == 2)) | (~here & ~far & (total == 6))).any():
                raise ValueError("must not touch each other, or a wall, at a corner alone")

    @property
    def kinds(self) -> Array:
        """See `Polyhedron.kinds`; faces of one direction meet only in one plane."""
        return np.asarray(2 * self._axis + (self.normal.sum(axis=1) > 0))

    def cuts(self, axis: int) -> set[float]:
        """Coordinates of the faces of blocks along an axis [m]."""
        return set(self._cuts[axis].tolist())

    def _cells(self, x: Array, axis: int) -> Array:
        """(K,) number of the cells between cuts along an axis, in `_solid`, that points are in."""
        return np.searchsorted(self._cuts[axis], x[:, axis])

    def solid(self, x: Array) -> Array:
        """Mask (K,) of the points (K, 3) [m] in blocks or outside of the box."""
        return np.asarray(self._solid[tuple(self._cells(x, axis) for axis in range(3))])

    def around(self, x: Array, reach: float) -> tuple[Array, Array]:
        """Masks (K,) of the points (K, 3) with fluid, and of those with a wall, within ``reach`` along the axes [m]."""
        # How many of the cells before each are solid: sums over boxes of cells are differences of these.
        before = np.pad(self._solid, ((1, 0),) * 3).astype(int).cumsum(axis=0).cumsum(axis=1).cumsum(axis=2)
        low = [np.searchsorted(cuts, x[:, k] - reach, "right") for k, cuts in enumerate(self._cuts)]
        high = [np.searchsorted(cuts, x[:, k] + reach, "left") + 1 for k, cuts in enumerate(self._cuts)]
        solid = np.zeros(len(x), dtype=int)
        for way in itertools.product((0, 1), repeat=3):
            solid += (-1) ** (3 - sum(way)) * before[tuple((low, high)[end][k] for k, end in enumerate(way))]
        every = np.prod([b - a for a, b in zip(low, high, strict=True)], axis=0)
        return solid < every, solid > 0

    def clear(self, x: Array, reach: float) -> Array:
        """See `Polyhedron.clear`."""
        return ~self.around(x, reach)[1]

    def inner(self, spacing: float) -> Array:
        """Points (K, 3) of a lattice in blocks, `DEEP` spacings below their faces [m]."""
        axes = [spacing * (0.5 + np.arange(int(length / spacing))) for length in self._size.tolist()]
        x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        x += np.random.default_rng(0).uniform(-JITTER, JITTER, x.shape) * spacing
        return np.asarray(x[~self.around(x, DEEP * spacing)[0]])

    def on_edges(self, x: Array, tolerance: float) -> Array:
        """See `Polyhedron.on_edges`; planes end at the edges of blocks."""
        on = super().on_edges(x, tolerance)
        for plane, (axis, face) in enumerate(zip(self._axis.tolist(), self._faces, strict=True)):
            i = np.flatnonzero(on[:, plane])
            one, other = (k for k in range(3) if k != axis)
            low, high = x[i] - tolerance, x[i] + tolerance
            wide = np.pad(face, 1)
            within = np.zeros(len(i), dtype=bool)
            for a, b in itertools.product((low, high), repeat=2):
                within |= wide[self._cells(a, one), self._cells(b, other)]
            on[i[~within], plane] = False
        return on

    def passed(self, x: Array) -> Array:
        """The plane (K,) of a block that each point (K, 3) [m] in one has passed, the nearest; -1 for others."""
        result = np.full(len(x), -1)
        in_box = ((x > 0) & (x < self._size)).all(axis=1)
        inside = np.flatnonzero(in_box & self.solid(x))
        if not len(inside):
            return result
        y, nearest = x[inside], np.full(len(inside), np.inf)
        for plane in np.flatnonzero(~self.outer).tolist():
            axis, face = int(self._axis[plane]), self._faces[plane]
            apart = np.full(len(y), np.inf)
            one, other = (k for k in range(3) if k != axis)
            depth = self.offset[plane] - y @ self.normal[plane]
            for i, j in zip(*np.nonzero(face), strict=True):
                away = [
                    np.maximum(np.maximum(self._cuts[k][n] - y[:, k], y[:, k] - self._cuts[k][n + 1]), 0.0)
                    for k, n in ((one, i), (other, j))
                ]
                apart = np.minimum(apart, np.hypot(*away))
            distance = np.where(depth >= 0, np.hypot(depth, apart), np.inf)
            closer = distance < nearest
            nearest[closer], result[inside[closer]] = distance[closer], plane
        return result


def _distinct(values: list[float], length: float, slack: float) -> Array:
    """The values within 0 and ``length``, in order, of which those closer than ``slack`` are one [m]."""
    ordered = np.unique(np.clip(values, 0.0, length))
    kept = ordered[np.append(True, np.diff(ordered) > slack)]
    kept[-1] = length
    return np.asarray(kept)
