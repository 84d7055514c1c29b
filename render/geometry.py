"""Geometry shared by the pictures of a scene: computed at its first picture and kept with it, whatever is shown."""

from functools import cached_property
from typing import NamedTuple

import numpy as np

from .arrays import Array
from .interface import (
    Edges,
    FluidRegions,
    areas,
    cell_edges,
    fluid_regions,
    loose_particles,
    outer_sides,
    solid_triangles,
    walls_around,
)


class Surroundings(NamedTuple):
    """Walls and particles outside the cells."""

    walls: Array  # (W, 2) edges of cells along walls, pairs of particles
    around: Array  # (H, 2) edges around all walls where some are dry
    inside: Array  # (T, 3) triangles that fill the space between dry walls
    spray: Array  # (N,) mask of the particles off the walls that are in no cell
    dry: Array  # (N,) mask of the wall particles that are in no cell


class Bounds(NamedTuple):
    """Boxes around triangles or segments, one of each."""

    lower: Array  # (K, 2) lower corners [m]
    upper: Array  # (K, 2) upper corners [m]

    @classmethod
    def around(cls, corners: Array) -> "Bounds":
        """The boxes around polygons with corners (K, C, 2) [m]."""
        lower, upper = corners[:, 0], corners[:, 0]
        for k in range(1, corners.shape[1]):  # faster than a reduction over a short axis
            lower, upper = np.minimum(lower, corners[:, k]), np.maximum(upper, corners[:, k])
        return cls(lower, upper)

    def touching(self, lower: Array, upper: Array) -> Array:
        """Numbers (S,) of the boxes that touch the one from lower (2,) to upper (2,) [m]."""
        x = (self.lower[:, 0] <= upper[0]) & (self.upper[:, 0] >= lower[0])
        return np.flatnonzero(x & (self.lower[:, 1] <= upper[1]) & (self.upper[:, 1] >= lower[1]))


class Geometry:
    """Edges, interface and walls of a scene, in metres or as indices."""

    def __init__(self, position: Array, cells: Array, fluid: Array, wall: Array, cell_fluid: Array | None) -> None:
        self._position, self._cells, self._fluid = position, cells, fluid
        self._wall, self._cell_fluid = wall, cell_fluid

    @cached_property
    def edges(self) -> Edges:
        """Edges of the cells."""
        return cell_edges(self._cells)

    @cached_property
    def regions(self) -> FluidRegions:
        """The cells split by fluid, and the interface."""
        return fluid_regions(self._position, self._cells, self._fluid, self._cell_fluid, self.edges)

    @cached_property
    def rim(self) -> Array:
        """Sides (S, 2) of single cells, with the cell on the left."""
        return np.stack(outer_sides(self._position, self._cells), axis=1)

    @cached_property
    def loose(self) -> tuple[Array, Array]:
        """Particles in no cell, see `loose_particles`."""
        return loose_particles(self._cells, self._wall)

    @cached_property
    def surroundings(self) -> Surroundings:
        """Walls and loose particles."""
        pairs = self.edges.pairs
        hull = pairs[(self.edges.shared_by == 1) & self._wall[pairs].all(axis=1)]
        # Dry walls are drawn around the empty space between them.
        spray, dry = self.loose
        box, inside = walls_around(self._position, self._wall & dry.any())
        return Surroundings(hull, box, inside, spray, dry)

    @cached_property
    def solids(self) -> tuple[Array, Array, Array, Array]:
        """Solid parts between the walls of fluids that fill their tank, see `solid_triangles`."""
        border = self.edges.pairs[self.edges.shared_by == 1]
        if not len(border) or not self._wall[border].all():
            border = border[:0]
        return solid_triangles(self._position, border, float(areas(self._position, self._cells).sum()))

    @cached_property
    def cell_bounds(self) -> Bounds:
        """Boxes around the cells."""
        return Bounds.around(self._position[self._cells])

    @cached_property
    def edge_bounds(self) -> Bounds:
        """Boxes around the edges."""
        return Bounds.around(self._position[self.edges.pairs])

    @cached_property
    def region_bounds(self) -> Bounds:
        """Boxes around the triangles of the regions."""
        return self.cell_bounds if self._cell_fluid is not None else Bounds.around(self.regions.triangles)

    @cached_property
    def interface_bounds(self) -> Bounds:
        """Boxes around the segments of the interface."""
        return Bounds.around(self.regions.segments)
