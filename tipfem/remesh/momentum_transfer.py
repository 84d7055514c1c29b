"""Momentum transfer: what a remeshing does to particles whose share of the heavy fluid it changes.

The particles keep their velocity when the mesh is made anew, but an element's density is the mean of
its particles', so a particle of air whose new elements reach into the water weighs hundreds of times
more than before. With its own velocity and acceleration it would then carry hundreds of times its
momentum: a source of energy out of nothing. The mass it gained was its heavier neighbours', and so
is the velocity of that mass.
"""

from __future__ import annotations

import numpy as np

from tipfem.case.particles import Particles
from tipfem.mesh.mesh import Mesh
from tipfem.typing import Array

# A particle's density must rise by this part before anything is transferred.
RISE = 0.01


def nodal_density(mass: Array, volume: Array) -> Array:
    """Density (N,) [kg/m^3] around each particle from lumped masses and volumes (N,); NaN without any volume."""
    return np.asarray(np.divide(mass, volume, out=np.full(len(mass), np.nan), where=volume > 0))


def transfer_momentum(
    particles: Particles, mesh: Mesh, before: Array, after: Array, still: Array | None = None
) -> Particles:
    """Give what became heavier the velocity and acceleration of the neighbours its mass came from.

    v_i = (rho_i v_i + (rho'_i - rho_i) vbar_i) / rho'_i, with vbar_i the mean over the neighbours that were
    heavier, weighted by how much heavier they were; the same for the acceleration. Within one fluid
    nothing changes. Wall particles give nothing: they stand still for the fluid's sake, not as its part.

    Args:
        particles: the state on N particles.
        mesh: the new mesh.
        before: (N,) density around each particle on the old mesh [kg/m^3].
        after: (N,) the same on the new one.
        still: (N,) mask of the particles that stand still; by default all wall particles.

    Returns:
        The state, with new velocities and accelerations where density rose.
    """
    still = particles.wall if still is None else still
    risen = (after > (1 + RISE) * before) & ~still
    if not risen.any():
        return particles
    i, j = mesh.edges.T
    one, other = np.concatenate([i, j]), np.concatenate([j, i])
    donor = risen[one] & (before[other] > (1 + RISE) * before[one]) & ~still[other]
    one, other = one[donor], other[donor]
    weight = before[other] - before[one]
    total = np.bincount(one, weights=weight, minlength=len(particles))
    taking = np.flatnonzero(total > 0)
    part = 1.0 - before[taking] / after[taking]
    changed = particles.copy()
    for values in (changed.velocity, changed.acceleration):
        old = values.copy()
        for k in range(particles.dimension):
            mean = np.bincount(one, weights=weight * old[other, k], minlength=len(particles))[taking] / total[taking]
            values[taking, k] += part * (mean - old[taking, k])
    return changed
