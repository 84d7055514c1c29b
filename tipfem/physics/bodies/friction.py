"""Friction along outlines of bodies, in a step: by a slip length, or by the layer that the mesh does not resolve.

The law is that of walls, see `tipfem.physics.walls.friction`, in the frame of the body: friction is k times the slip
velocity of each particle, lumped over its faces, with their lengths at the start of the step. Layers stand at fixed
points of the outline.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from tipfem.backend.launch import launch
from tipfem.case.body import Body
from tipfem.case.particles import Particles
from tipfem.mesh.components import ON_HULL, ON_INTERFACE
from tipfem.mesh.mesh import Mesh
from tipfem.physics.bodies.motion import BodyMotion, BodyStates, rigid_rates, unturned
from tipfem.physics.bodies.outlines import Outline
from tipfem.physics.walls.kernels import stick_to_layers
from tipfem.physics.walls.layers import DRY, LAYER, LayerFaces, Layers, advance, begin
from tipfem.typing import Array

LEAST = 0.02  # slip length on a face with a resolved layer whose particles are held by no other [lengths of the face]
MOST = 1000  # curves of an outline, for the numbers of parts


def first_layers(
    bodies: Sequence[Body], outlines: Mapping[int, Outline], states: BodyStates, particles: Particles
) -> Layers | None:
    """No layers yet, at the particles on outlines with the law "layer"; None without such."""
    places, parts = [], []
    for b, outline in outlines.items():
        if bodies[b].law == LAYER:
            y = _home(states, b, outline, particles.position[states.label == b])
            number = outline.number(y, particles.spacing)[0]
            places.append(y[number >= 0])
            parts.append(MOST * b + number[number >= 0])
    if not places:
        return None
    place, part = np.concatenate(places), np.concatenate(parts)
    order = np.argsort(part, kind="stable")
    place, part = np.ascontiguousarray(place[order]), part[order]
    return Layers(place, part, np.full(len(place), DRY), np.zeros_like(place))


def friction_on_outlines(
    motion: BodyMotion,
    outlines: Mapping[int, Outline],
    mesh: Mesh,
    particles: Particles,
    viscosity: Array,
    density: Array,
) -> tuple[Array, Layers | None, Array | None]:
    """Friction over slip velocity (N,) of particles in a step [kg/s, per metre of depth]; the layers at its end.

    And a mask (N,) of the particles at which these are resolved; both None without any.
    """
    states, count, dt = motion.states, len(particles), motion.scheme.dt
    result, layers, stuck = np.zeros(count), states.boundary_layers, None
    assert layers is None or isinstance(layers, Layers)
    of = states.label[motion.faces[:, 0]]
    lengths = np.array([body.slip_length or 0.0 for body in motion.bodies])
    layered = np.array([body.law == LAYER for body in motion.bodies])
    holds = np.array([not body.slips_everywhere for body in motion.bodies])  # all but contacts
    angled = np.array([bool(body.contact_angle) for body in motion.bodies])
    here = np.flatnonzero((lengths > 0)[of] | layered[of] | (holds & angled)[of])
    if not len(here):
        return result, layers, stuck
    contact = np.bincount(motion.faces.ravel(), minlength=count) == 1  # of interfaces, or where fluids end
    if mesh.components is not None:
        contact |= mesh.components.mark == ON_INTERFACE + ON_HULL
    faces, cell, of = motion.faces[here], motion.cell[here], of[here]
    edge = particles.position[faces[:, 0]] - particles.position[faces[:, 1]]
    measure, length = np.linalg.norm(edge, axis=1), lengths[of]
    if layers is not None:
        on = np.flatnonzero(layered[of])
        near, order = _layer_faces(motion, outlines, mesh, particles, viscosity, density, (faces[on], cell[on], of[on]))
        new = begin(layers, near) if (layers.fluid == DRY).all() and not states.begun else layers
        layers, found, resolved = advance(new, near, dt)
        length[on[order]] = found
        stuck, weight = np.zeros(count, dtype=bool), np.zeros((count, 2))
        nodes = np.ascontiguousarray(faces[on][order], dtype=np.int32)
        arrays = nodes, near.part.astype(np.int32), viscosity[cell[on][order]], resolved.view(np.int8), weight
        launch(stick_to_layers, *arrays, stuck.view(np.int8), 2)
    if (holds & angled)[of].any():
        stuck = np.zeros(count, dtype=bool) if stuck is None else stuck
        stuck[faces[(holds & angled)[of]]] = True
    if stuck is not None:
        stuck &= ~(contact & (states.label >= 0) & angled[states.label])
    length = np.where((layered | holds)[of], np.maximum(length, LEAST * measure), length)
    beside = (angled & (lengths == 0))[of] & contact[faces].any(axis=1)
    length = np.where(beside, np.maximum(length, particles.target[faces].mean(axis=1)), length)
    share = 0.5 * viscosity[cell] * measure / length
    for end in range(2):
        np.add.at(result, faces[:, end], share)
    return result, layers, stuck


def _layer_faces(
    motion: BodyMotion,
    outlines: Mapping[int, Outline],
    mesh: Mesh,
    particles: Particles,
    viscosity: Array,
    density: Array,
    given: tuple[Array, Array, Array],
) -> tuple[LayerFaces, Array]:
    """Data for layers on faces (E, 2), their cells and bodies, part by part; and their order (E,)."""
    faces, cell, of = given
    states, half = motion.states, 0.5 * motion.scheme.dt
    apex = mesh.cells[cell].sum(axis=1) - faces.sum(axis=1)
    middle = particles.position[faces].mean(axis=1)
    part, home = np.zeros(len(faces), dtype=np.int32), np.zeros_like(middle)
    edge = particles.position[faces[:, 0]] - particles.position[faces[:, 1]]
    along = edge / np.linalg.norm(edge, axis=1)[:, None]

    def relative(index: Array) -> Array:
        """Velocities (E, 2) relative to the bodies in the middle of the step."""
        r = particles.position[index] - states.position[of, :2]
        own = rigid_rates(r, states.velocity[of], states.acceleration[of])
        return particles.velocity[index] - own[0] + half * (particles.acceleration[index] - own[1])

    outer = (relative(apex) * along).sum(axis=1)
    inner = (0.5 * (relative(faces[:, 0]) + relative(faces[:, 1])) * along).sum(axis=1)
    for b, outline in outlines.items():
        mine = np.flatnonzero(of == b)
        home[mine] = _home(states, b, outline, middle[mine])
        # A face belongs to the curve that its middle is on.
        part[mine] = MOST * b + outline.number(home[mine], 0.0)[0]
        along[mine] = unturned(along[mine], states.position[b, 2])
    order = np.argsort(part, kind="stable")
    fluid = particles.fluid[faces[:, 0]] if mesh.fluid is None else mesh.fluid[cell]
    found = LayerFaces(
        part[order],
        home[order],
        (outer[:, None] * along)[order],
        (inner[:, None] * along)[order],
        (viscosity[cell] / density[cell])[order],
        np.ascontiguousarray(np.asarray(fluid)[order]),
        particles.target[faces].mean(axis=1)[order],
        mesh.period,
    )
    return found, order


def _home(states: BodyStates, b: int, outline: Outline, x: Array) -> Array:
    """Points (K, 2) [m] where they would be at t = 0, if they moved with body ``b``."""
    return outline.reference + unturned(x - states.position[b, :2], states.position[b, 2])
