"""Stages where there is empty space: for the repair it is meshed, as a fluid without density.

Spray is the particles that are in no cell of a fluid. Without empty space there is none, and the stages do nothing.
"""

from __future__ import annotations

import numpy as np

from tipfem.case.particles import Particles
from tipfem.mesh.mesh import simplex_measure
from tipfem.remesh import surface_volumes
from tipfem.remesh.stages.remeshing import Remeshing
from tipfem.remesh.triangles import empty_space
from tipfem.remesh.triangles.spray import Spray
from tipfem.remesh.volumes import with_components
from tipfem.typing import Array

AHEAD = 2.0  # steps by which cells are flooded before something enters


def spray_kept_in_tank(r: Remeshing) -> Remeshing:
    """Stop the spray, and surfaces, at walls, and let the particles of dry walls go with these."""
    walls, before, particles, surface = r.solved.walls, r.before, r.particles, r.before.mesh.surface
    particles = _stopped(r, particles, surface.loose)
    if surface.empty is not None:
        particles = walls.carry(before.particles, particles, surface.dry(particles.wall))
        # Where no cell of empty space has turned over, no surface has passed a wall.
        if len(surface.empty) and simplex_measure(particles.position, surface.empty, r.mesh.period).min() < 0:
            particles = _stopped(r, particles, surface.front & ~particles.wall)
    return r.with_(particles=particles)


def _stopped(r: Remeshing, particles: Particles, may: Array) -> Particles:
    """The particles, with those of a mask (N,) that have passed a wall in front of it."""
    if not may.any():
        return particles
    if r.before.boundary.convex:
        particles = surface_volumes.kept_inside(particles)
    return r.before.boundary.stopped(particles, may, r.solved.time)


def with_empty_space(r: Remeshing) -> Remeshing:
    """Add the cells of empty space, which are of fluid F, and flood those that something enters."""
    surface, particles, count = r.mesh.surface, r.particles, len(r.rules.fluids)
    if surface.empty is None:
        return r
    ends = surface.empty, r.before.particles.position, particles.position
    cells = empty_space.followed(*ends, particles.spacing, r.mesh.period)
    whole = empty_space.beyond(r.mesh, cells, count)
    if r.before.boundary.is_open:
        # Of cells of empty space that are flooded no volume is missing.
        there = simplex_measure(particles.position, cells, r.mesh.period)
        whole = whole.with_(measure=np.concatenate([r.mesh.measure, there]))
    soon, wanted = r.solved.time + AHEAD * r.solved.dt, r.wanted
    for physics in r.rules.physics:
        was = np.asarray(whole.fluid)
        whole = physics.flooded(r.part(physics), whole, r.before.boundary, particles.position, soon)
        taken = physics.taken_up(r.part(physics), r.before.mesh, particles.position)
        if taken is not None:  # and where gaps open it is in cells again
            there = simplex_measure(particles.position, whole.cells, r.mesh.period)
            now, then = (np.bincount(of, there, minlength=count + 1)[:count] for of in (np.asarray(whole.fluid), was))
            wanted = wanted - taken + now - then
    spray = Spray(particles, surface, count, full=any(part.full for part in r.parts.values()))
    return r.with_(wanted=wanted, mesh=with_components(whole, count + 1), spray=spray)


def without_empty_space(r: Remeshing) -> Remeshing:
    """Leave the cells of empty space out again."""
    if r.spray is None:
        return r
    particles, spray = r.particles, r.spray.renumbered(r.renumbered, len(r.particles))
    mesh = empty_space.without(r.mesh, particles.wall, len(r.rules.fluids), spray.volume)
    return r.with_(mesh=mesh, spray=spray)


def spray_labelled(r: Remeshing) -> Remeshing:
    """Keep the fluids of the spray, and set the pressure to zero where there is none."""
    if r.spray is None:
        return r
    particles, surface = r.particles, r.mesh.surface
    fluid = np.where(surface.loose, r.spray.fluid, particles.fluid)
    pressure = np.where(surface.pinned, 0.0, particles.pressure)
    return r.with_(particles=particles.shallow_copy(fluid=fluid, pressure=pressure))


def pieces_keep_momentum(r: Remeshing) -> Remeshing:
    """Restore the momenta of the pieces of fluid, each by itself, those in the air among them."""
    if r.spray is None:
        return r
    solved, mesh, particles = r.solved, r.mesh, r.particles
    leaves = surface_volumes.leave(mesh, particles.wall, r.relocated)
    if not r.before.boundary.is_open and r.rules.grading is None:
        given = surface_volumes.carried_through(solved, r.end.particles, leaves, r.renumbered)
    else:
        masses = r.rules.density[r.moved_mesh.fluid] * r.moved_mesh.measure, r.before.mass
        given = surface_volumes.carried_past(r.end, r.moved_mesh, *masses, leaves, r.renumbered)
    given = surface_volumes.without_spin_of_spray(given, particles.position, mesh)
    if solved.uniform:
        given = given._replace(force=given.mass[:, None] * solved.force[:1])
    return r.with_(particles=surface_volumes.restore_momenta(particles, mesh, r.mass, given))


def gained_by_spray(r: Remeshing, gravity: Array) -> float:
    """Energy of the spray after the repair, less that before it [J, per metre of depth]."""
    of = r.rules.density, gravity
    after = empty_space.spray_energy(r.particles, r.mesh.surface, *of)
    return after - empty_space.spray_energy(r.moved, r.moved_mesh.surface, *of)
