"""Stages after the repair: fluids and numbers of the particles, what the physics carry, and what walls prescribe."""

from __future__ import annotations

import numpy as np

from tipfem.physics.carried import Remap, held_by_gaps, kept_where_sliding
from tipfem.remesh.parts import carried, imposed
from tipfem.remesh.stages.remeshing import Remeshing
from tipfem.remesh.triangles.fitted import particle_fluid


def labelled(r: Remeshing) -> Remeshing:
    """Label particles with the fluid of their cells, and renumber the reference and the fixed ones."""
    particles, reference, fixed = r.particles, r.reference, r.fixed
    if r.renumbered is not None:
        reference = int(r.renumbered[reference]) if reference >= 0 else -1
        fixed = np.zeros(len(particles), dtype=bool)
        fixed[r.renumbered[r.fixed]] = True
    fluid = particle_fluid(r.mesh, len(particles), r.rules.rank)
    return r.with_(particles=particles.shallow_copy(fluid=fluid), reference=reference, fixed=fixed)


def carried_along(r: Remeshing) -> Remeshing:
    """Bring what the physics carry to the new particles and cells."""
    force = r.solved.force[:1] if r.solved.uniform else r.solved.force
    remap = Remap(r.before.mesh, r.mesh, r.renumbered, r.relocated, force, r.relabelled)
    parts, particles = carried(r.rules.physics, r.parts, r.particles, remap)
    return r.with_(particles=particles, parts=parts)


def led_by_walls(r: Remeshing) -> Remeshing:
    """Find the wall of each wall particle, and give it the velocity that wall, physics and parts prescribe there."""
    particles, boundary = r.solved.walls.reassign(r.particles, r.mesh, held_by_gaps(r.parts))
    particles = kept_where_sliding(r.parts, r.particles, particles)
    for physics in r.rules.physics:
        particles = physics.imposed(r.part(physics), particles, boundary, r.solved.time, 0.25 * r.solved.dt)
    return r.with_(particles=imposed(r.parts, particles), boundary=boundary)


def weighed(r: Remeshing) -> Remeshing:
    """Find what the elements are made of, and the masses of the particles."""
    material, mass = r.rules.material(r.mesh)
    return r.with_(material=material, mass=mass)
