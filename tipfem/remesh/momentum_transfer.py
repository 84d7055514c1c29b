"""Momentum transfer: velocities of particles whose mass remeshing increases.

Particles keep their velocity when the mesh is made anew, but an element's density is the mean of
its particles', so a particle of air whose new elements reach into the water can gain hundreds of times
its mass. With its own velocity and acceleration it would then have hundreds of times its
momentum: a spurious source of energy. The mass it gains belonged to its heavier neighbours, so it
moves at their velocity.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from tipfem.case.particles import Particles
from tipfem.mesh.mesh import Mesh
from tipfem.physics.carried import Carried, OwnInertia, own_inertia
from tipfem.physics.state import Solved
from tipfem.typing import Array

# Smallest relative increase of a particle's density for which momentum is transferred.
SMALLEST_INCREASE = 0.01


def conserve_along_period(solved: Solved, particles: Particles, mass: Array, parts: Mapping[str, Carried]) -> Particles:
    """Remeshed particles with the momentum and the rate of momentum that a step must leave along periodic axes.

    Between walls that slip without friction only gravity and body forces change it: sum m (v + (1/2 - alpha_f) dt a)
    grows by dt sum m b, and sum m a_alpha is sum m b. What Newton's tolerance and the changes of the mesh have left
    over is given to all particles, of masses (N,) [kg], as one velocity and one acceleration. Elsewhere they are
    returned as they are.
    """
    boundary, scheme, old, before = solved.before.boundary, solved.scheme, solved.before.particles, solved.before.mass
    if not boundary.frictionless:
        return particles
    changed, shift = particles.copy(), (0.5 - scheme.alpha_f) * scheme.dt
    before_own, own = solved.before.own_inertia, own_inertia(parts)
    for k in boundary.period.axes:
        force = (before * solved.force[:, k]).sum()
        rate = scheme.next_rate(force, _total(before, old.acceleration, before_own, k))
        momentum = _total(before, old.velocity + shift * old.acceleration, before_own, k) + scheme.dt * force
        for values, wanted in ((changed.acceleration, rate), (changed.velocity, momentum - shift * rate)):
            values[:, k] += (wanted - _total(mass, values, own, k)) / mass.sum()
    return changed


def _total(mass: Array, field: Array, own: Sequence[OwnInertia], axis: int) -> float:
    """Sum along an axis of mass (N,) times a field (N, d), with the inertia that parts of the state have."""
    return float((mass * field[:, axis]).sum()) + sum(float(part.total(field)[axis]) for part in own)


def nodal_density(mass: Array, volume: Array) -> Array:
    """Density (N,) [kg/m^3] around each particle from lumped masses and volumes (N,); NaN without any volume."""
    return np.asarray(np.divide(mass, volume, out=np.full(len(mass), np.nan), where=volume > 0))


def transfer_momentum(
    particles: Particles, mesh: Mesh, before: Array, after: Array, still: Array | None = None
) -> Particles:
    """Change the velocity and acceleration of particles that became heavier towards those of their heavier neighbours.

    v_i = (rho_i v_i + (rho'_i - rho_i) vbar_i) / rho'_i, with vbar_i the mean over the neighbours that were heavier,
    weighted by how much heavier they were; the same for the acceleration. Within one fluid nothing changes. Wall
    particles that are ``still`` (N,), by default all, do not contribute, because their velocity is prescribed.
    Densities (N,) around particles are those on the mesh before and after [kg/m^3].
    """
    still = particles.wall if still is None else still
    heavier = (after > (1 + SMALLEST_INCREASE) * before) & ~still
    if not heavier.any():
        return particles
    i, j = mesh.edges.T
    one, other = np.concatenate([i, j]), np.concatenate([j, i])
    donor = heavier[one] & (before[other] > (1 + SMALLEST_INCREASE) * before[one]) & ~still[other]
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
