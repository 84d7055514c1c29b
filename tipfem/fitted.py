"""Remeshing with interfaces along edges: the triangulation moves with the particles and is repaired in place.

Every triangle belongs to one fluid for good; flips, collapses and splits of edges hand that on. So a
remeshing moves no volume from one fluid to another but where an interface is made coarser, slides
along a wall, or a film breaks; and that is undone at once, see `conservation`.
"""

from __future__ import annotations

import numpy as np

from tipfem.conservation import restore
from tipfem.fitting import FittedRule
from tipfem.mesh import Mesh
from tipfem.moving import Triangulation
from tipfem.particles import Array, Particles
from tipfem.triangulation import TriangulationError

# How far from a new particle others must be, in spacings; less where there is no such place.
ROOM = (0.6, 0.5, 0.4, 0.3, 0.2, 0.1)
# Height over a long interface edge, in spacings, below which a particle is taken to be on it.
SLIVER = 0.05


def repair(
    particles: Particles, mesh: Mesh, density: Array, fixed: Array, rule: FittedRule,
    *, slippery: Array | None = None, total: Array | None = None,
) -> tuple[Particles, Mesh, Array]:
    """Remesh particles that have moved.

    Args:
        particles: the moved state on N particles; which are walls may change, see Returns.
        mesh: the triangles they moved with, none inverted.
        density: (F,) of the fluids [kg/m^3].
        fixed: (N,) particles that must keep their place, as the corners of the tank.
        rule: when to change what.
        slippery: (N,) wall particles that slide with the fluid; where interfaces meet walls there, they do so, too.
        total: (F,) volume that each fluid is to have afterwards [m^2]; by default the solve's changes of volume
            stay, and only those of the remeshing are undone.

    Returns:
        The state, where some particles have a new place (N stays the same); the mesh; and (N,) a mask of
        those particles.

    Raises:
        TriangulationError: the repair did not come to an end, or left a triangle without area.
    """
    moved = mesh.carried(particles.position).measure
    if (moved <= 0).any():
        raise TriangulationError("a triangle was inverted before it could be repaired")
    h, held = particles.spacing, fixed.astype(bool)
    least = 0.02 * h * h
    t = Triangulation.of(particles, mesh, density, moved)
    flips = t.make_delaunay(rule.slack)
    sticks = held if slippery is None else held | (slippery > 0)
    t.slide_contacts(sticks, particles.position - mesh.position, rule.reach * h, 0.35 * h, least)
    broken = t.break_films(rule.film * h)
    if taken := t.take_in(SLIVER * h, h):
        flips += taken + t.make_delaunay(rule.slack)
    sizes = (rule.chain * h, rule.edge * h, rule.film * h, least)
    t.coarsen(held, rule.close * h, *sizes, most=len(held))
    edges, needed = t.longest_edges(rule.long * h, t.wanted_edges())
    if needed > len(t.freed):
        # Nothing that crowds is left to take: take from where particles stand closest.
        t.coarsen(held, rule.spare * h, *sizes, most=needed - len(t.freed))
        edges, _ = t.longest_edges(rule.long * h, t.wanted_edges())
    relocated = np.zeros(len(held), dtype=bool)
    relocated[t.freed] = True
    for room in ROOM:
        if not len(t.freed):
            break
        t.refine(edges, room * h)
        flips += t.make_delaunay(rule.slack)
        edges, _ = t.longest_edges(rule.long * h, t.wanted_edges())
    if len(t.freed):
        raise TriangulationError(f"{len(t.freed)} particles that crowded others find no room elsewhere")
    t.compact()
    new = Mesh(np.ascontiguousarray(t.state[:, :2]), t.cells, t.fluid)
    new.__dict__["across"] = t.across
    position = restore(new.position, new, t.marks(), mesh, moved, relocated, total, 0.05 * h)
    if not (flips or broken or relocated.any() or (position != particles.position).any()):
        return particles, mesh.carried(particles.position), relocated
    return *_taken(t, particles, new, position), relocated


def _taken(t: Triangulation, particles: Particles, new: Mesh, position: Array) -> tuple[Particles, Mesh]:
    """State and mesh of a repaired triangulation at its last positions (N, 2); see `repair` for errors."""
    if (new.measure <= 0).any():
        place = position[t.cells[np.argmin(new.measure), 0]].tolist()
        raise TriangulationError(f"the triangle at {place} has no area after the repair")
    velocity, acceleration, pressure = (np.ascontiguousarray(t.state[:, k]) for k in (slice(2, 4), slice(4, 6), 6))
    state = particles.changed(
        position=position, velocity=velocity, acceleration=acceleration, pressure=pressure, wall=t.wall.astype(bool)
    )
    mesh = Mesh(position, t.cells, t.fluid)
    for name in ("across", "measure", "bodies"):
        mesh.__dict__[name] = new.__dict__[name]
    return state, mesh
