"""Points of a box, in 2-D or 3-D, on a rectilinear lattice that fits its walls; some may be periodic."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from tipfem.geometry.blocks import BlockedBox
from tipfem.geometry.box_sides import SIDES
from tipfem.geometry.lattice import BESIDE, Part, faces_of_part, fitted_lines, lines, shifted_on_faces, snap_to_faces
from tipfem.geometry.period import Period
from tipfem.typing import Array


@dataclass(frozen=True)
class BoxPoints:
    """The N points of a box; see `tipfem.geometry.plane.shape_points.ShapePoints` for those of other shapes."""

    size: Array  # (d,) of the box, from the origin [m]
    period: Period  # of the positions
    counts: tuple[int, ...]  # number of lines along each axis
    position: Array  # (N, d) [m], the last axis running fastest
    wall: Array  # (N,) mask of those on walls
    on_face: Array  # (N,) mask of those on faces between parts
    held: Array  # (N, d) mask of the coordinates that are those of walls, or of faces at which the filled parts end
    flat: Array  # (N, d) mask of the coordinates that are those of faces between parts, where lines are on these
    ends: Array  # (N, d) mask of the coordinates that are those of walls, or of periodic sides
    buried: Array  # (N,) mask of those where there is no tank, but a block
    blocks: BlockedBox | None  # the box with its blocks, if it has any

    @staticmethod
    def of(
        size: Array,
        spacing: float,
        faces: list[set[float]],
        period: Period,
        is_empty: Part | None,
        blocks: BlockedBox | None = None,
        *,
        fitted: bool,
    ) -> BoxPoints:
        """The lattice of a box of ``size`` (d,) [m] with ``faces`` [m] along each axis; see `tipfem.geometry.lattice`.

        ``is_empty`` masks points in empty parts, None where no part may be empty. Lines are on the faces if ``fitted``,
        else on both sides. There are no points in ``blocks``.
        """
        along, ends_along = [], []
        for axis, length in enumerate(size.tolist()):
            if fitted:
                along.append(fitted_lines(axis, length, spacing, faces[axis]))
            else:
                lower = np.zeros_like(size)
                ends = faces_of_part(faces[axis], axis, lower, size, spacing, is_empty) if is_empty else set()
                along.append(lines(axis, length, spacing, faces[axis], ends))
                ends_along.append(ends)
        position = np.stack([x.ravel() for x in np.meshgrid(*along, indexing="ij")], axis=1)
        at_end = (position == 0.0) | (position == size)
        at_end[:, period.axes] = False
        held = at_end.copy()
        for axis, ends in enumerate(ends_along):
            held[:, axis] |= np.isclose(position[:, axis, None], sorted(ends), rtol=0, atol=1e-9 * spacing).any(axis=1)
        flat = np.zeros_like(held)
        for axis, ends in enumerate(faces if fitted else ()):
            flat[:, axis] = np.isclose(position[:, axis, None], sorted(ends), rtol=0, atol=1e-9 * spacing).any(axis=1)
        nowhere = np.zeros(len(position), dtype=bool)
        on_ends, wall, buried = (position == 0.0) | (position == size), at_end.any(axis=1), nowhere
        if blocks is not None:
            wet, wall = blocks.around(position, BESIDE * spacing)
            on, buried = blocks.on_edges(position, 1e-9 * spacing), ~wet
            wall |= buried
            on_ends = held = np.stack(
                [on[:, blocks.normal[:, axis] != 0].any(axis=1) for axis in range(len(size))], axis=1
            )
        counts = tuple(len(x) for x in along)
        return BoxPoints(size, period, counts, position, wall, nowhere, held, flat, on_ends, buried, blocks)

    @property
    def line(self) -> Array:
        """(N, d) numbers of the lines that each point is on, from the nearer end."""
        from_end = [np.minimum(np.arange(n), np.arange(n)[::-1]) for n in self.counts]
        return np.stack([k.ravel() for k in np.meshgrid(*from_end, indexing="ij")], axis=1)

    @property
    def images(self) -> Array:
        """(N,) mask of the points in blocks, and of images on the last line along a periodic axis."""
        last: Array = self.buried.copy()
        number = np.unravel_index(np.arange(len(self.position)), self.counts)
        for k in self.period.axes:
            last |= number[k] == self.counts[k] - 1
        return last

    def fitted(self, part: Part) -> BoxPoints:
        """The points, with some moved onto the faces between parts; see `snap_to_faces`."""
        position, on_face = snap_to_faces(self.position, self.counts, self.size, self.ends, part)
        for k in self.period.axes:  # faces between the two ends, too
            on_face |= position[:, k] == 0.0
        return replace(self, position=position, on_face=on_face)

    def along_faces(self, by: Array, spacing: float, part: Part) -> BoxPoints:
        """The points, with those on faces between parts displaced by (N, 3) [m] along these.

        Four points of a lattice on a plane may make a cell without volume. Points on edges of boxes stay on these.
        """
        position, steps = self.position.copy(), BESIDE * spacing * np.eye(len(self.size))
        on = np.flatnonzero(self.on_face)
        x, flat = position[on], self.flat[on]
        for axis, step in enumerate(steps):
            flat[:, axis] &= part(x + step) != part(x - step)
        held, curved = self.held[on] | flat, ~flat.any(axis=1)
        x[~curved] += np.where(held, 0.0, by[on])[~curved]
        x[curved] = shifted_on_faces(x[curved], by[on[curved]], held[curved], spacing, part)
        position[on] = x
        return replace(self, position=position)

    def shifted(self, by: Array, *, along_walls: bool) -> BoxPoints:
        """The points displaced by (N, d) [m], but for those on faces and walls; in 3-D along these, if they may.

        In 3-D four wall particles of a lattice can be in one plane across an edge of the tank. The missing simplices
        matter only beside walls that slip and where fluids end.
        """
        held = (self.wall | self.on_face)[:, None]
        if along_walls and len(self.size) == 3:
            held = self.held | self.on_face[:, None]
        return replace(self, position=self.position + np.where(held, 0.0, by))

    def along_walls(self, x: Array, velocity: Array, slips: Callable[[str], bool]) -> Array:
        """Velocities (K, d) [m/s] of points x (K, d) [m] on walls, less parts across walls that slip; 0 on others."""
        velocity = velocity.copy()
        for name, (axis, upper) in SIDES.items():
            if axis >= len(self.size) or axis in self.period.axes:
                continue
            here = x[:, axis] == (self.size[axis] if upper else 0.0)
            velocity[here, axis] = 0.0
            if not slips(name):
                velocity[here] = 0.0
        if (blocks := self.blocks) is not None:
            on = blocks.on_edges(x, 1e-9 * self.size.max())
            for plane in np.flatnonzero(~blocks.outer).tolist():
                here = on[:, plane]
                velocity[here] *= slips(blocks.names[plane]) * (blocks.normal[plane] == 0)
        return velocity

    def at_interfaces(self, fluid: Array, fluid_at: Part) -> Array:
        """(N,) mask of the points whose neighbours have another fluid than their own (N,)."""
        grid = fluid.reshape(self.counts)
        mask = np.zeros(self.counts, dtype=bool)
        for axis in range(len(self.counts)):
            of, to = np.moveaxis(grid, axis, 0), np.moveaxis(mask, axis, 0)
            differs = of[1:] != of[:-1]
            to[1:] |= differs
            to[:-1] |= differs
        return mask.ravel()

    def limited(self, size: Array, spacing: float) -> Array:
        """Target spacings (N,) where the walls allow no larger ones: those of blocks allow none."""
        if self.blocks is None:
            return size
        on = self.blocks.on_edges(self.position, 1e-9 * spacing)[:, ~self.blocks.outer].any(axis=1)
        return np.where(on | self.buried, spacing, size)

    def fewer_on_walls(self, kept: Array, fixed: Array, target: Array, stride: Array, spacing: float) -> Array:
        """The mask (N,) of the points that stay: the walls are lines of the lattice, and nothing else applies there."""
        return kept
