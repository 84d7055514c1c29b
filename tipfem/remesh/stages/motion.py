"""Stages before the repair: where the particles are at the end of a step, and how close they are to be."""

from __future__ import annotations

import numpy as np

from tipfem.mesh.mesh import corners_among, simplex_measure
from tipfem.physics.physics import Moved
from tipfem.remesh.stages.remeshing import Remeshing
from tipfem.remesh.volumes import with_components


def set_back(r: Remeshing) -> Remeshing:
    """Put particles back into corners, and on walls, whose curves make up for none of the volume beside corners."""
    parts, particles, walls, x = dict(r.parts), r.particles, r.solved.walls, r.particles.position
    over = [walls.brinks]
    for physics in r.rules.physics:
        part, particles, brinks = physics.set_back(parts.get(physics.name), particles)
        over.append(brinks)
        if part is not None:
            parts[physics.name] = part
    particles, beside, kept = walls.set_back(particles), np.concatenate(over), 0.0
    if len(beside):
        on = np.zeros(len(x), dtype=bool)
        on[beside] = True
        cells = r.mesh.cells[corners_among(on, r.mesh.cells) > 0]
        goal = np.where(on[:, None], particles.position, x)
        gain = simplex_measure(goal, cells, r.mesh.period) - simplex_measure(x, cells, r.mesh.period)
        kept = float(gain.sum())
    return r.with_(particles=particles, parts=parts, kept=kept)


def left_by_physics(r: Remeshing) -> Remeshing:
    """Apply the changes of each physics to the end of the step, as where fluids enter and leave."""
    before, solved, parts, wanted = r.before, r.solved, dict(r.parts), r.wanted
    end = Moved(before.particles, before.boundary, r.particles, before.mesh, solved.time, solved.dt, kept=r.kept)
    for physics in r.rules.physics:
        part, end = physics.before_repair(parts.get(physics.name), end)
        if part is not None:
            parts[physics.name] = part
        if (entered := physics.entered(part)) is not None:
            wanted = wanted + entered.volume
    stored = sum(part.energy(end.particles.position) for part in parts.values())
    mesh = with_components(end.mesh, len(r.rules.fluids))
    return r.with_(end=end, particles=end.particles, mesh=mesh, parts=parts, wanted=wanted, stored=stored)


def with_targets(r: Remeshing) -> Remeshing:
    """Set target spacings; with that the particles are as the repair finds them."""
    particles = r.rules.graded(r.particles, r.mesh, r.parts)
    return r.with_(particles=particles, moved=particles, moved_mesh=r.mesh)
