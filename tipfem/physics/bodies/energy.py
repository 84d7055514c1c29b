"""Energy of the bodies that float, for the balance of a step.

The bodies' equations, tested with their increments in the step, give the balance that is derived in
docs/theory/energy.md; the work of the fluids on the bodies is the same with the opposite sign in that of the fluids.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tipfem.case.body import Body
from tipfem.fem.time_integration import TimeScheme
from tipfem.physics.bodies.motion import BodyStates
from tipfem.typing import Array


@dataclass(frozen=True)
class BodyBalance:
    """Energies of the bodies that float in a step [J, per metre of depth], summed over them."""

    kinetic: float = 0.0  # at the end of the step
    # of gravity, relative to the reference points at height zero, and of springs; at the end of the step
    potential: float = 0.0
    change: float = 0.0  # of both in the step
    dampers: float = 0.0  # work that dampers take in the step
    # work of inertia, springs and weight less the change of their energies, and of the fluids' forces along the
    # particles' displacements less that of force and moment; a loss
    numerical: float = 0.0
    work: float = 0.0  # of the fluids on the bodies
    external: float = 0.0  # work of the body force, gravity excepted


def body_balance(
    bodies: Sequence[Body], gravity: Array, old: BodyStates, new: BodyStates, scheme: TimeScheme, body_force: Array
) -> BodyBalance:
    """The balance of a step, with the bodies ``old`` at its start, on its N particles, and ``new`` at its end."""
    total = np.zeros(7)
    for b, body in enumerate(bodies):
        if not body.floats or old.held[b]:
            continue
        increment = new.position[b] - old.position[b]
        inertia = np.array([body.total_mass, body.total_mass, body.inertia_about_reference])
        before, after = (_energies(body, gravity, states, b, inertia) for states in (old, new))
        change = after - before
        arms = np.stack([_centre(body, states.position[b, 2]) for states in (old, new)])
        arm = scheme.alpha_f * arms[0] + scheme.cf * arms[1]
        force = body_force[old.label == b].mean(axis=0)
        weight, further = (_weight(body, g, arm) @ increment for g in (gravity, force - gravity))
        stretched = scheme.alpha_f * old.position[b] + scheme.cf * new.position[b] - np.append(body.reference, 0.0)
        springs = (np.asarray(body.stiffness) * stretched) @ increment
        # Not by increments: where the relaxation was chosen after the solve, their rates are not those of its scheme.
        velocity = scheme.alpha_f * old.velocity[b] + scheme.cf * new.velocity[b] if scheme.weighs else new.velocity[b]
        dampers = (np.asarray(body.damping) * velocity) @ increment
        inertial = (inertia * new.middle[b]) @ increment
        numerical = inertial + springs - weight - change.sum() + new.work[b] - new.force[b] @ increment
        kinetic, potential = after[0], after[1:].sum()
        total += kinetic, potential, change.sum(), dampers, numerical, new.work[b], further
    return BodyBalance(*total.tolist())


def _centre(body: Body, angle: float) -> Array:
    """(2,) the centre of mass relative to the reference point [m]."""
    x, y = body.centre_of_mass - body.reference
    return np.array([np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y])


def _weight(body: Body, gravity: Array, arm: Array) -> Array:
    """(3,) force and moment of an acceleration at the centre of mass."""
    return np.asarray(body.total_mass * np.append(gravity, arm[0] * gravity[1] - arm[1] * gravity[0]))


def _energies(body: Body, gravity: Array, states: BodyStates, b: int, inertia: Array) -> Array:
    """(3,) kinetic energy, potential energy, and energy of the springs [J]."""
    position = states.position[b]
    place = position[:2] + _centre(body, position[2])
    stretched = position - np.append(body.reference, 0.0)
    return np.array(
        [
            0.5 * (inertia * states.velocity[b] ** 2).sum(),
            -body.total_mass * float(gravity @ place),
            0.5 * (np.asarray(body.stiffness) * stretched**2).sum(),
        ]
    )
