"""Meshers: Delaunay meshes of the whole tank, or of the fluids below a free surface."""

from __future__ import annotations

from typing import Protocol

from tipfem.case.boundary.boundary import Boundary
from tipfem.case.particles import Particles
from tipfem.mesh.delaunay import triangulate
from tipfem.mesh.free_surface import SurfaceMesher
from tipfem.mesh.mesh import Mesh
from tipfem.physics.state import Solved
from tipfem.remesh.cavity.following import followed, improved
from tipfem.remesh.triangles.delaunay_repair import repaired
from tipfem.typing import Array


class Mesher(Protocol):
    """Makes Delaunay meshes of particles."""

    def start(self, particles: Particles, boundary: Boundary) -> Mesh:
        """The first mesh; see `Remesher.start` for errors."""

    def remesh(self, solved: Solved, particles: Particles, moves: Array) -> tuple[Mesh, bool]:
        """The mesh after a step, and whether it was triangulated anew although the last could have been repaired.

        ``moves`` (K, 3) are those of relocation, after which the particles are; see `relocate`.
        """


class TankMesher:
    """Meshes of the whole tank, where walls surround the fluids.

    The last mesh is repaired where possible, see `delaunay_repair` and in 3-D `cavity.following`, unless Qhull makes
    every one.
    """

    def __init__(self, *, repairs: bool) -> None:
        self.repairs = repairs

    def start(self, particles: Particles, boundary: Boundary) -> Mesh:
        """See `Mesher.start`."""
        return self._anew(particles, boundary, 0.0)

    def remesh(self, solved: Solved, particles: Particles, moves: Array) -> tuple[Mesh, bool]:
        """See `Mesher.remesh`."""
        old, moved, found = solved.before.mesh, solved.particles.position, None
        if self.repairs and old.dimension == 2:
            found = repaired(old, moved, particles.position, moves)
        elif self.repairs:
            found = followed(old, moved, particles.position, moves, particles.wall, particles.spacing)
        if found:
            return found, False
        return self._anew(particles, solved.before.boundary, solved.time), True

    def _anew(self, particles: Particles, boundary: Boundary, time: float) -> Mesh:
        edges = boundary.edges(particles, time)
        mesh = triangulate(particles.position, particles.wall, particles.spacing, edges, boundary.period)
        return improved(mesh, particles.wall, particles.spacing) if self.repairs else mesh


class FreeSurfaceMesher:
    """Meshes of the fluids below a free surface, which a mesher finds."""

    def __init__(self, mesher: SurfaceMesher) -> None:
        self.mesher = mesher

    def start(self, particles: Particles, boundary: Boundary) -> Mesh:
        """See `Mesher.start`."""
        return self.mesher.start(particles, boundary.edges(particles, 0.0))

    def remesh(self, solved: Solved, particles: Particles, moves: Array) -> tuple[Mesh, bool]:
        """See `Mesher.remesh`; nothing is repaired here."""
        relocated = (particles.position != solved.particles.position).any(axis=1)
        edges = solved.before.boundary.edges(particles, solved.time)
        return self.mesher.remesh(particles, solved.mesh, relocated, edges, moves), False
