"""Free surfaces: which Delaunay simplices are fluid (alpha-shape), and which particles are on the surface.

The fluids fill the region they filled before the step, and a little more where they touch a wall or each other anew. So
the first test of a simplex is whether it lies inside the deformed simplices of the step (compare Fernandez, Marti &
Ryzhakov, arXiv:2305.00228, 2023, who use a level set): inside, large simplices are fluid too; outside, where a simplex
would add volume, it must be small. Plain alpha-shapes bridge gaps of two spacings, and gain volume with every drop that
lands.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tipfem.case.numerics import SurfaceRule
from tipfem.case.particles import Particles
from tipfem.mesh.alpha_shape import Shapes, covered, hanging
from tipfem.mesh.delaunay import SLIVER, delaunay, inside
from tipfem.mesh.mesh import Mesh, Surface, corners_among
from tipfem.typing import Array

Filled = Callable[[Array], Array]

FLAT = 1e-12  # measure in h^d below which a simplex has no gradients
WALL_REACH = 1.5  # longest edge of a face of the wall that particles touch [spacings]


class SurfaceMesher:
    """Meshes of particles with a free surface, by a rule.

    ``filled`` masks positions (K, d) [m] in the fluids at the start; None if unknown.
    """

    def __init__(self, rule: SurfaceRule, filled: Filled | None = None) -> None:
        self.rule, self.filled = rule, filled

    def start(self, particles: Particles, boundary: Array | None = None) -> Mesh:
        """The first mesh, within a boundary (E, 2) or the hull; replaces the fluid -1 of dry wall particles."""
        x, wall, rule = particles.position, particles.wall, self.rule
        dry = particles.fluid < 0
        particles.fluid = np.where(dry, 0, particles.fluid).astype(np.int32)
        cells, measure, neighbours = _triangles(particles, boundary)
        may = (measure > FLAT) & (corners_among(dry, cells) == 0)
        candidate = np.flatnonzero(may & (corners_among(wall, cells) <= x.shape[1]))
        shapes = Shapes.of(x, cells[candidate], particles.spacing)
        if self.filled is None:
            fluid = shapes.radius < rule.first * rule.alpha
        else:
            fluid = (shapes.radius < rule.inner) & self.filled(x[cells[candidate]].mean(axis=1))
        keep = np.zeros(len(cells), dtype=bool)
        keep[candidate[fluid]] = True
        mesh = self._finish(x, wall, cells, measure, neighbours, keep, particles.spacing, may, start=True)
        return mesh.with_flying(np.where(mesh.surface.loose, particles.spacing ** x.shape[1], 0.0))

    def remesh(
        self,
        particles: Particles,
        before: Mesh,
        relocated: Array,
        boundary: Array | None = None,
        moves: Array | None = None,
    ) -> Mesh:
        """The mesh after a step, from the one of the step at the positions after it.

        ``relocated`` (N,) masks the particles that were relocated since, ``moves`` (K, 3) has those relocated into
        edges of the mesh of the step, and the ends of these; ``boundary`` as in `start`.
        """
        x, wall, h = particles.position, particles.wall, particles.spacing
        cells, measure, neighbours = _triangles(particles, boundary, wall)
        old = before.surface
        used = before.used
        below = used & ~old.front & ~relocated
        if moves is not None:
            # Inside an edge with an end below the surface. Were these taken for particles on it, cells between several
            # of them would be left out, as holes in the fluid.
            below[moves[:, 0]] = below[moves[:, 1:]].any(axis=1)
        solid = corners_among(wall, cells) == cells.shape[1]
        keep = (measure > FLAT) & ~solid & (corners_among(below, cells) == cells.shape[1])
        undecided = np.flatnonzero((measure > FLAT) & ~solid & ~keep)
        keep[undecided[self._fluid(particles, cells[undecided], before, below, old, used)]] = True
        deep = below & ~wall
        released = hanging(before, particles.pressure, deep) & ~relocated
        keep &= (corners_among(released, cells) == 0) | (corners_among(deep, cells) > 0)
        return self._finish(x, wall, cells, measure, neighbours, keep, h, measure > FLAT)

    def _fluid(
        self, particles: Particles, cells: Array, before: Mesh, below: Array, old: Surface, used: Array
    ) -> Array:
        """Mask (K,) of the fluid ones among simplices (K, d + 1) with a particle that was not below the surface."""
        rule, wall, d = self.rule, particles.wall, particles.dimension
        shapes = Shapes.of(particles.position, cells, particles.spacing)
        at_wall = corners_among(wall, cells) == d
        deep = corners_among(below & ~wall, cells) > 0
        inside = deep.copy()
        # Larger ones are not fluid, inside or outside.
        near = np.flatnonzero(~deep & (at_wall | (shapes.radius < max(rule.alpha, rule.join))))
        middle = particles.position[cells[near]].mean(axis=1)
        inside[near] = covered(middle, cells[near], before)
        limit = np.where(deep, rule.inner, np.where(inside, rule.alpha, rule.join))
        fluid = (shapes.radius < limit) & (inside | (shapes.height.min(axis=1) < rule.gap))
        k = np.flatnonzero(at_wall & ~deep)
        fluid[k] = self._touches(particles, cells[k], shapes[k], inside[k], old, used)
        return np.asarray(fluid)

    def _touches(
        self, particles: Particles, cells: Array, shapes: Shapes, inside: Array, old: Surface, used: Array
    ) -> Array:
        """Mask (K,) of the fluid ones among simplices (K, d + 1) of one particle over a face of the wall."""
        rule, d = self.rule, particles.dimension
        apex = np.argmin(particles.wall[cells], axis=1)
        rows = np.arange(len(cells))
        height, foot = shapes.height[rows, apex], shapes.foot(apex)
        others = np.ones(cells.shape, dtype=bool)
        others[rows, apex] = False
        lowest = np.where(others, foot, 1.0).min(axis=1)
        close = height < 0.5 * rule.touch
        # Position of the foot between the face's wet particles and its last wet or dry ones, from 0 to 1.
        ends = (old.front | ~used)[cells] & others
        partly, progress = _towards(ends, others, foot)
        stays = ~ends.any(axis=1) | ((~partly | (progress > 2 * rule.dry / d) | close) & (lowest > -0.25))
        # No lower limit on the height: a particle must not pass through the wall.
        corner = particles.position[cells]
        longest = np.zeros(len(cells))
        for a in range(d + 1):
            for b in range(a):
                length = np.linalg.norm(corner[:, a] - corner[:, b], axis=1) / particles.spacing
                longest = np.where(others[:, a] & others[:, b], np.maximum(longest, length), longest)
        low = (height < rule.touch) & (longest < WALL_REACH)
        kept = inside & stays & ((shapes.radius < rule.alpha) | low)
        partly, progress = _towards(~used[cells] & others, others, foot)
        passed = (~partly | (progress > 1 / d) | close) & (lowest > -1e-9)
        low = height < np.where(partly, rule.wet, rule.touch)
        v = particles.velocity[cells]
        relative = v[rows, apex] - np.where(others[..., None], v, 0.0).sum(axis=1) / d
        approaches = partly | (np.einsum("ki,ki->k", relative, shapes.gradient[rows, apex]) < 0)
        new = ~inside & passed & low & approaches & (longest < WALL_REACH)
        return np.asarray(kept | new)

    def _finish(
        self,
        position: Array,
        wall: Array,
        cells: Array,
        measure: Array,
        neighbours: Array,
        keep: Array,
        h: float,
        may: Array,
        *,
        start: bool = False,
    ) -> Mesh:
        """The mesh of the simplices kept and, in corners of walls, those beside them, with its surface, no volumes."""
        solid = corners_among(wall, cells) == cells.shape[1]
        corner = np.flatnonzero(may & solid & (measure > SLIVER) & _beside(keep, neighbours))
        keep[corner[Shapes.of(position, cells[corner], h).radius < self.rule.alpha]] = True
        out = keep[:, None] & ~((neighbours >= 0) & keep[neighbours])
        k, opposite = np.nonzero(out)
        facet = np.ones((len(k), cells.shape[1]), dtype=bool)
        facet[np.arange(len(k)), opposite] = False
        corners = cells[k][facet].reshape(len(k), cells.shape[1] - 1)
        other = neighbours[k, opposite]
        backed = wall[corners].all(axis=1) & ((other < 0) | solid[other])
        front = np.zeros(len(position), dtype=bool)
        front[corners[~backed]] = True
        if not start:
            keep &= ~solid | _beside(keep & ~solid, neighbours)
        mesh = Mesh(position, np.ascontiguousarray(cells[keep]))
        used = mesh.used
        zero = np.zeros(len(position))
        surface = Surface(front & used, ~used, ~used & ~wall, zero, zero)
        return Mesh(position, mesh.cells, surface=surface)


def _triangles(particles: Particles, boundary: Array | None, wall: Array | None = None) -> tuple[Array, Array, Array]:
    """Simplices, measures and neighbours of all particles inside a boundary; without one as `delaunay`."""
    if boundary is None:
        return delaunay(particles.position, particles.spacing, wall)
    return inside(particles.position, particles.wall, particles.spacing, boundary)


def _beside(keep: Array, neighbours: Array) -> Array:
    """Mask (M,) of the simplices that share a facet with one that is kept; ``neighbours`` (M, d + 1) by `delaunay`."""
    return np.asarray(((neighbours >= 0) & keep[neighbours]).any(axis=1))


def _towards(ends: Array, others: Array, foot: Array) -> tuple[Array, Array]:
    """Whether some but not all ``others`` are ``ends`` (K, d + 1), and the mean of ``foot`` over the ends (K,)."""
    count = ends.sum(axis=1)
    return (count > 0) & (ends != others).any(axis=1), np.where(ends, foot, 0.0).sum(axis=1) / np.maximum(count, 1)


def spray_volumes(mesh: Mesh, fluid: Array, count: int) -> Array:
    """Volumes (F,) of each fluid that particles carry outside the cells [m^d], see `Surface.spray`."""
    surface = mesh.surface
    if not (surface.volume.any() or surface.deficit.any()):
        return np.zeros(count)
    return np.bincount(fluid, weights=surface.spray, minlength=count)


def filled_cells(mesh: Mesh, particles: Particles, rule: SurfaceRule, filled: Filled | None) -> Array:
    """(M,) mask of the cells of a first mesh that are fluid; particles of walls without any have the fluid -1."""
    wall = corners_among(particles.wall, mesh.cells)
    wet = corners_among(particles.fluid < 0, mesh.cells) == 0
    radius = Shapes.of(particles.position, mesh.cells, particles.spacing).radius
    if filled is None:
        fluid = wet & (radius < rule.first * rule.alpha)
        corner = wet & (wall == mesh.dimension + 1) & (radius < rule.alpha)
    else:
        inside = wet & filled(particles.position[mesh.cells].mean(axis=1))
        fluid, corner = inside & ((radius < rule.inner) | (wall > 0)), inside
    fluid &= wall <= mesh.dimension
    while (more := corner & ~fluid & _beside(fluid, mesh.neighbours)).any():
        fluid |= more  # into sharp corners, and thin wedges between a level and a wall, triangle by triangle
        if filled is None:
            break
    return np.asarray(fluid)
