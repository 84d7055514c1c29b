"""Impacts: steps in which velocities jump, and what the time integration adds to the energy in others.

Generalized-alpha has a history: the acceleration of the last step. Where an incompressible fluid is stopped within a
step, the method answers an impulse I by 2 I and, in the next step, by -I, velocities overshoot by half, and energy may
rise. Such steps are solved again with `BackwardEuler`.

Elsewhere the method's energy differs from the flow's by a part to (a dt)^2 with the accelerations a. Where these fall,
as after an impact, energy rises by a part to dt^3 per step. It is taken back by another relaxation of the acceleration,
which can be chosen when the step has been solved, see `GeneralizedAlpha`.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from tipfem.backend import runtime
from tipfem.backend.arrays import partials
from tipfem.backend.launch import launch
from tipfem.case.case import Case
from tipfem.fem import step_limits
from tipfem.fem.mass import product
from tipfem.fem.time_integration import GeneralizedAlpha, lasting, local_error
from tipfem.mesh.mesh import corners_among
from tipfem.physics.state import Solved, State
from tipfem.scratch import scratch
from tipfem.step.budget import deviations, lumping_of
from tipfem.typing import Array

# An impact is a step in which a particle's acceleration changes, times the step's length, by this part of the largest
# speed. A stop is a change of twice the velocity. Flows without impacts have up to a tenth of it, where they are rough.
JUMP = 0.35
UNCERTAIN = 0.08  # the same of a step that is one, too, if the time integration adds energy that cannot be taken back
# Particles count fully from this part of the mass that one has inside the densest fluid. Those of thin films and of
# light fluids are accelerated by as much in any flow.
FULL = 0.5
SLOW = 0.01  # spacings a step: speeds below it are not those of an impact
RISE = 5e-7  # of the energy, in a step, from which on it is taken back
MOST = 0.6  # change of the relaxation, relative


def changes(case: Case, solved: Solved) -> tuple[float, float]:
    """Jump of the velocities in a step, and the error of the time integration in it.

    Args:
        solved: a step of generalized-alpha.

    Returns:
        The largest change of a particle's acceleration times the step's length, relative to the largest speed; and
        the estimated error of displacements, see `tipfem.fem.time_integration.local_error` [spacings].
    """
    before, dt = solved.before, solved.dt
    particles, dimension = before.particles, before.particles.dimension
    full = FULL * max(fluid.density for fluid in case.fluids)
    result, count = np.zeros(5), len(particles)
    mass = before.mesh.period.section(before.mass, particles.position, particles.target)
    rates = particles.acceleration, particles.velocity
    fields = step_limits.StepFields(solved.inertia, solved.force, *rates, solved.displacement)
    launch(
        step_limits.jumps,
        mass,
        particles.target,
        particles.wall.view(np.int8),
        fields,
        partials(5),
        result,
        float(full),
        float(dt),
        dimension,
        work=(count, step_limits.PARTICLE),
    )
    change, speed, force, squares, moved = result.tolist()
    jump = float(dt * change / (speed + dt * force + SLOW * particles.spacing / dt))
    return jump, local_error(solved.scheme, math.sqrt(squares / moved) if moved else 0.0)


def struck_state(state: State, solved: Solved) -> State:
    """The state at the start of an impact, with those accelerations that generalized-alpha's ``solved`` has, too."""
    particles = state.particles
    particles = particles.shallow_copy(acceleration=lasting(particles.acceleration, solved.acceleration))
    parts = {name: part.lasting(solved.parts[name]) for name, part in state.parts.items()}
    return dataclasses.replace(state, particles=particles, parts=parts)


def without_gain(case: Case, solved: Solved) -> tuple[Solved, bool]:
    """A step of generalized-alpha, in which the time integration adds no energy.

    It is returned as it is unless the energy of fluids and walls rises by more than `RISE` of that above the lowest
    particle. Then velocities and accelerations are those of another relaxation; momenta are kept, each particle's own.

    Returns:
        The step; and whether all of the gain is taken back, by a change of the relaxation of no more than `MOST`.
    """
    scheme, before, end = solved.scheme, solved.before, solved.particles
    assert isinstance(scheme, GeneralizedAlpha)
    start, mass, work, kind = before.particles, before.mass, solved.work, case.numerics.mass
    u, v = solved.displacement, end.velocity
    ends, starts = _products(before, kind, [(v, v), (start.velocity, start.velocity)])
    falls = float(_products_of_particles(before, kind, [(solved.force, u)])[0])
    falls += work.weight
    for part in before.own_inertia:
        falls += part.work(solved.force, u, lumping_of(before, kind)[part.cell])
    rise = 0.5 * (ends - starts) - falls + work.stored - work.walls - work.friction - work.passing
    height = np.dot(end.position, -case.potential_gravity, out=scratch("gain.height", len(mass)))
    height -= height.min()
    height *= mass
    energy = 0.5 * ends + float(height.sum()) + abs(work.stored)
    if rise <= (RISE + 10 * runtime.round_off()) * energy:
        return solved, True
    # What the time integration itself gives: the rise less the gains of other terms, and more their losses.
    losses = work.viscous_dissipation + work.friction_dissipation + work.stabilisation - work.source
    gain = min(rise, rise + losses)
    held = start.wall
    if len(ends := before.boundary.entries):
        # Beside them accelerations jump with each particle that enters, which is no gain elsewhere.
        near, cells = np.zeros(len(mass), dtype=bool), before.mesh.cells
        near[ends] = True
        near[cells[corners_among(near, cells) > 0]] = True
        force = np.broadcast_to(solved.force, u.shape)[near]
        own = 0.5 * (v[near] ** 2 - start.velocity[near] ** 2) - (solved.inertia[near] + force) * u[near]
        gain -= float(mass[near] @ own.sum(axis=1))
        held = held | near
    if gain <= 0:
        return solved, True
    change = np.where(held[:, None], 0.0, end.acceleration - start.acceleration)
    step = (scheme.alpha_f - 0.5) * scheme.dt * change
    pairs = [(v, step), (step, step)]
    slope, curvature = _products(before, kind, pairs)
    if slope == 0:
        return solved, False
    # The smaller root of gain + slope e + curvature e^2 / 2 = 0, or where that is least.
    square = slope**2 - 2 * curvature * gain
    wanted = -2 * gain / (slope + math.copysign(math.sqrt(square), slope)) if square >= 0 else -slope / curvature
    more = max(-MOST, min(MOST, wanted))
    particles = end.copy()
    particles.velocity += more * step
    particles.acceleration += more * change
    relaxed = GeneralizedAlpha(scheme.rho_inf, scheme.dt, relaxation=1 + more)
    return dataclasses.replace(solved, particles=particles, scheme=relaxed), square >= 0 and more == wanted


def _products(state: State, kind: str, pairs: Sequence[tuple[Array, Array]]) -> Array:
    """a^T M b of pairs of fields (N, d) with a kind of mass matrix of a state, with its parts' own inertia."""
    result = _products_of_particles(state, kind, pairs)
    for part in state.own_inertia:
        lumpings = [lumping_of(state, kind)[part.cell]]
        result += [part.products(a, b, lumpings)[0] for a, b in pairs]
    return result


def _products_of_particles(state: State, kind: str, pairs: Sequence[tuple[Array, Array]]) -> Array:
    """The same of the particles alone."""
    products = [product(state.mass, a, b) for a, b in pairs]
    return np.asarray(products - deviations(state, kind, pairs))
