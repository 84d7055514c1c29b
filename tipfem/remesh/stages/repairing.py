"""The stage of the repair itself, see `tipfem.remesh.triangles.fitted`."""

from __future__ import annotations

from functools import partial

import numpy as np

from tipfem.physics.carried import sliding
from tipfem.remesh.stages.remeshing import Remeshing
from tipfem.remesh.triangles.fitted import repair
from tipfem.scratch import filled
from tipfem.typing import Array

STILL = 1e-9  # displacement in a step of what is at rest [spacings]
# After how many steps it is examined whether particles and cells are to be sorted: where more than this part of the
# cells have corners with numbers farther apart than so many rows of a lattice, of so many particles at least.
SORTED, PART, ROWS, MANY = 8, 0.1, 4.0, 2000


def repaired(r: Remeshing) -> Remeshing:
    """Repair the triangulation."""
    rules, density = r.rules, r.rules.density
    count, boundary = len(r.particles), r.before.boundary
    energies = [physics.sides(r.part(physics), count, boundary) for physics in rules.physics]
    fixed, slippery, curved = held(r)
    curves = r.solved.walls.curves is not None or any(physics.curved for physics in rules.physics)
    particles, mesh, relocated, renumbered, relabelled = repair(
        r.particles,
        r.mesh,
        density if r.spray is None else np.append(density, 0.0),
        fixed,
        rules.fitting,
        slippery=slippery,
        total=r.wanted if rules.keep else None,
        graded=rules.grading is not None or any(physics.open for physics in rules.physics),
        account=r.account,
        keep_cells=r.solved.keeps_cells,
        energies=next(filter(None, energies), None),
        spray=r.spray,
        curved=curved,
        put_on_curves=partial(put_on_curves, r) if curves else None,
        at_rest=STILL * r.particles.spacing,
        closed=next(filter(None, (physics.closed(r.part(physics), r.particles) for physics in rules.physics)), None),
        sort=r.before.step % SORTED == 0 and scattered(r.mesh.cells, count),
    )
    return r.with_(particles=particles, mesh=mesh, relocated=relocated, renumbered=renumbered, relabelled=relabelled)


def scattered(cells: Array, count: int) -> bool:
    """Whether the corners of many cells have numbers far apart among ``count``, so that they are not near in memory."""
    if count < MANY:
        return False
    apart = cells.max(axis=1) - cells.min(axis=1)
    return bool(np.count_nonzero(apart > ROWS * np.sqrt(count)) > PART * len(cells))


def held(r: Remeshing) -> tuple[Array, Array, Array | None]:
    """Masks (N,) of the particles that a repair keeps, that slide along walls, and that are on curves.

    The last one is None where the repair need not know.
    """
    boundary, fixed, parts = r.before.boundary, r.before.fixed.copy(), r.parts
    fixed[boundary.index[boundary.pinned]] = True
    slippery = filled(False, "held.slippery", len(fixed), bool)
    slippery[boundary.index[boundary.slides]] = True
    if r.solved.walls.stuck is not None:
        slippery[r.solved.walls.stuck] = False
    slides = sliding(parts, len(fixed))
    slippery[slides], fixed[slides] = True, False
    for part in parts.values():
        if part.stuck is not None:
            slippery[part.stuck] = False
        if part.full:  # what the outlines of gaps enclose is counted
            gaps = r.mesh.cells[np.asarray(r.mesh.fluid) == len(r.rules.fluids)]
            fixed[gaps], slippery[gaps] = True, False
    boundary.hold_ends(fixed, slippery)
    curved = r.end.curved
    if boundary.curves and r.spray is None:
        on = np.zeros(len(fixed), dtype=bool)
        on[boundary.index[boundary.on_curve >= 0]] = True
        curved = on if curved is None else on | curved
    return fixed, slippery, curved


def put_on_curves(r: Remeshing, position: Array, new: Array, ends: Array) -> Array:
    """Positions (N, 2), with those of new particles on curves put there; see `Physics.put_on_curves`."""
    position = r.solved.walls.put_on_curves(position, new, ends)
    for physics in r.rules.physics:
        position = physics.put_on_curves(r.part(physics), position, new, ends)
    return position
