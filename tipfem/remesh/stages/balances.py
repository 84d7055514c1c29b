"""The last stages: momenta and energy are what they were."""

from __future__ import annotations

from tipfem.physics.carried import Remap, own_inertia
from tipfem.remesh.energy_balance import Change
from tipfem.remesh.momentum_transfer import conserve_along_period
from tipfem.remesh.stages.empty_space import gained_by_spray
from tipfem.remesh.stages.remeshing import Remeshing


def momentum_kept(r: Remeshing) -> Remeshing:
    """Restore the momentum along periodic sides."""
    particles = conserve_along_period(r.solved, r.particles, r.mass, r.parts)
    r.account.add("walls", particles, r.mesh, r.material)
    return r.with_(particles=particles)


def energy_kept(r: Remeshing) -> Remeshing:
    """Take out of differences of velocity what the remeshing has added to the energy; what cannot be is owed."""
    balance, own = r.rules.balance, r.before.own_inertia
    if balance is None:
        return r
    if r.end.left is not None:
        own = [part.without(r.end.left) for part in own]
    work = r.solved.work
    change = Change(r.moved, r.moved_mesh, r.renumbered, r.relocated, own, work.dissipated, r.solved.dt, work.passed)
    # What parts have lost for good stays lost.
    stored = sum(part.energy(r.mesh.position) + part.lost for part in r.parts.values())
    if r.spray is not None:
        stored += gained_by_spray(r, balance.gravity)
    more = own_inertia(r.parts), stored - r.stored
    particles, memory = balance.keep(change, r.particles, r.mesh, r.mass, r.before.memory, *more)
    return r.with_(particles=particles, memory=memory)


def handed_over(r: Remeshing) -> Remeshing:
    """Velocities for the particles of what is meshed from now on: its energy comes with it."""
    remap = Remap(r.before.mesh, r.mesh, r.renumbered, r.relocated, r.solved.force[:1])
    for physics in r.rules.physics:
        before, part, particles = r.before.parts.get(physics.name), r.part(physics), r.particles
        velocity = physics.handed_over(before, part, particles, remap, r.boundary)
        if velocity is not None:
            new = particles.shallow_copy(velocity=velocity)
            r = r.with_(particles=new)
            if (balance := r.rules.balance) is not None:
                now, was = (balance.kinetic(of, r.mesh, own_inertia(r.parts)) for of in (new, particles))
                part = physics.booked(part, now - was, r.mass @ (velocity - particles.velocity))
                assert part is not None
                r = r.with_(parts={**r.parts, physics.name: part})
    return r
