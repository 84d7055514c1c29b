"""Friction along walls that slip, in a step: the faces of the mesh on them, and their boundary layers.

A wall has friction by a slip length of its own (Navier), or by that of the layer that the mesh does not resolve, see
`tipfem.physics.walls.layers`. It consists of parts: straight ones, each on a side of the domain, and curves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tipfem.case.boundary import Boundary
from tipfem.case.particles import Particles
from tipfem.fem.time_integration import TimeScheme
from tipfem.mesh.components import ON_HULL, ON_INTERFACE
from tipfem.mesh.mesh import Mesh, corners_among
from tipfem.physics.walls.curve_step import CurveStep
from tipfem.physics.walls.layers import LAYER, RESOLVED, LayerFaces, Layers, advance, begin
from tipfem.physics.walls.motion import WallMotion
from tipfem.typing import Array


@dataclass(frozen=True)
class Faces:
    """The F faces of the walls that slip with friction.

    Attributes:
        nodes: (F, d) particles, in the order in which the measure is positive with the normal.
        cell: (F,) the faces' cells.
        coefficient: (F,) viscosity over slip length [Pa s / m].
        normal: (F, d) of the wall, into the fluid, at the intermediate time.
        wall_velocity: (F, d * d) of the wall at each node, at the intermediate time [m/s].
        friction: (K,) their contribution to diag(A) of each sliding particle [kg / s^2].
    """

    nodes: Array
    cell: Array
    coefficient: Array
    normal: Array
    wall_velocity: Array
    friction: Array

    @staticmethod
    def none(dimension: int, sliding: int) -> Faces:
        """No faces, of walls with a number of ``sliding`` particles."""
        vectors, numbers = np.zeros((0, dimension)), np.zeros(0, dtype=np.int32)
        nothing = np.zeros(0), vectors, np.zeros((0, dimension * dimension)), np.zeros(sliding)
        return Faces(vectors.astype(np.int32), numbers, *nothing)


@dataclass(frozen=True)
class WallStart:
    """What friction has to know of the walls in a step from t_n to t_n + dt; N particles, d dimensions.

    Attributes:
        boundary: of the case.
        scheme: time integration, with the step's length.
        before, after: motion of the walls at t_n and at t_n + dt.
        rotation: (d, d) of the tank in between.
        frame: (N, d) the positions at t_n in the tank's own frame [m].
        predicted: (N, d) positions of wall particles at t_n + dt, exact for the fixed ones [m].
        sliding: (K,) the particles that slide along their walls.
        curves: the curves in the step; None without any.
    """

    boundary: Boundary
    scheme: TimeScheme
    before: WallMotion
    after: WallMotion
    rotation: Array
    frame: Array
    predicted: Array
    sliding: Array
    curves: CurveStep | None


@dataclass(frozen=True)
class WallFaces:
    """The F faces of the mesh on walls with friction.

    Attributes:
        part: (F,) number of the part of a wall that each is on: that in `Boundary.members`, or, for a curve, after all
            of these.
        wall: (F,) number of the wall.
        nodes: (F, d) particles of each face, in the order in which the measure is positive with the normal.
        cell: (F,) the faces' cells.
        normal: (F, d) into the fluid, at the intermediate time.
        inward: (F, d) the same in the tank's own frame.
        direction: (F, d) in which the wall slides with a positive speed.
    """

    part: Array
    wall: Array
    nodes: Array
    cell: Array
    normal: Array
    inward: Array
    direction: Array

    def __getitem__(self, index: Array) -> WallFaces:
        return WallFaces(
            self.part[index],
            self.wall[index],
            self.nodes[index],
            self.cell[index],
            self.normal[index],
            self.inward[index],
            self.direction[index],
        )


def friction_in_step(
    start: WallStart,
    mesh: Mesh,
    particles: Particles,
    viscosity: Array,
    density: Array | None,
    layers: Layers | None,
) -> tuple[Faces, Layers | None, Array | None]:
    """The friction of the walls in a step.

    Args:
        start: of the step, see `WallStart`.
        mesh: of the step.
        particles: the state at t_n.
        viscosity: (M,) of the elements [Pa s].
        density: (M,) of the elements [kg/m^3]; walls with a layer need it.
        layers: at t_n; None before the first step.

    Returns:
        The faces; the layers at the end of the step, None without walls of that law; and a mask (N,) of the particles
        at which layers are resolved, None without such walls.
    """
    boundary, scheme, d = start.boundary, start.scheme, mesh.dimension
    begins, stuck = layers is None, None
    layers = layers or Layers.on(boundary, start.frame[boundary.index])
    faces = _faces_on_walls(start, mesh, particles)
    if faces is None:
        return Faces.none(d, len(start.sliding)), layers, stuck
    length = np.array([wall.slip_length or 0.0 for wall in boundary.walls])[faces.wall]
    if layers is not None:
        assert density is not None
        on = np.flatnonzero(np.array([wall.law == LAYER for wall in boundary.walls])[faces.wall])
        layered = faces[on]
        mu = viscosity[layered.cell]
        seen = _layer_faces(start, layered, mesh, particles, mu / density[layered.cell])
        layers, length[on], resolved = advance(begin(layers, seen) if begins else layers, seen, scheme.dt)
        # Where fluids meet, the more viscous one decides.
        count, stuck = len(mesh.position), np.zeros(len(mesh.position), dtype=bool)
        for part in np.unique(layered.part):
            mine = np.flatnonzero(layered.part == part)
            node, weight = layered.nodes[mine].ravel(), np.repeat(mu[mine], d)
            sticking = np.bincount(node, weight * np.repeat(resolved[mine], d), count)
            stuck |= sticking > 0.5 * np.bincount(node, weight, count)
    length, stuck = _beside_contacts(length, stuck, faces, boundary, mesh, particles)
    face, coefficient = faces.nodes, viscosity[faces.cell] / length
    now = _velocity(faces, start.before, mesh.position[face])
    then = _velocity(faces, start.after, start.predicted[face])
    wall_velocity = (scheme.alpha_f * now + scheme.cf * then).reshape(-1, d * d)
    edge = mesh.period.shortest(mesh.position[face[:, 1:]] - mesh.position[face[:, :1]])
    measure = np.linalg.norm(edge[:, 0] if d == 2 else 0.5 * np.cross(edge[:, 0], edge[:, 1]), axis=1)
    share = np.repeat(scheme.cv * coefficient * measure / d, d)
    # Of integers where all of these walls are dry.
    friction = np.bincount(face.ravel(), share, minlength=len(mesh.position))[start.sliding].astype(float)
    return Faces(face, faces.cell, coefficient, faces.normal, wall_velocity, friction), layers, stuck


def _beside_contacts(
    length: Array, stuck: Array | None, faces: WallFaces, boundary: Boundary, mesh: Mesh, particles: Particles
) -> tuple[Array, Array | None]:
    """Slip lengths (F,) and stuck particles, as contacts with an angle need them; see `friction_in_step`.

    A no-slip wall holds the fluid as a resolved layer does. Beside a contact the slip length is at least a spacing,
    unless the wall has one of its own: a line of contact on a wall that held it could not move (C. Huh & L. E. Scriven,
    Hydrodynamic model of steady movement of a solid/liquid/fluid contact line, Journal of Colloid and Interface Science
    35, 1971). The spacing stands for the length on which it slips in nature.
    """
    angled = np.array([bool(wall.contact_angle) for wall in boundary.walls])[faces.wall]
    if not angled.any():
        return length, stuck
    spacing = particles.target[faces.nodes].mean(axis=1)
    if mesh.components is not None:
        contact = mesh.components.mark == ON_INTERFACE + ON_HULL
    else:  # where the fluid ends along a wall
        contact = np.bincount(faces.nodes.ravel(), minlength=len(particles)) == 1
        contact[boundary.index[boundary.pinned]] = False
    own = np.array([wall.slip_length is not None for wall in boundary.walls])[faces.wall]
    length = np.where(angled & (length == 0), RESOLVED * spacing, length)
    length = np.where(angled & ~own & contact[faces.nodes].any(axis=1), np.maximum(length, spacing), length)
    if stuck is not None:
        moves = np.zeros(len(contact), dtype=bool)
        moves[faces.nodes[angled]] = True
        stuck = stuck & ~(contact & moves)
    return length, stuck


def _faces_on_walls(start: WallStart, mesh: Mesh, particles: Particles) -> WallFaces | None:
    """The faces on walls with friction, part by part; None without such walls."""
    b, d, parts = start.boundary, mesh.dimension, list[tuple[Array, ...]]()
    mask, directions = np.zeros(len(mesh.position), dtype=bool), b.domain.direction * b.domain.sense[:, None]
    mask[b.index] = True
    beside = np.flatnonzero(corners_among(mask, mesh.cells) >= d)  # the cells that may have a face on a wall
    corners = mesh.cells[beside]
    for number, (k, side, members) in enumerate(b.members):
        if not _has_friction(b, k):
            continue
        mask[:] = False
        mask[b.index[members]] = True
        # A cell has one face on a straight wall: with all of its corners there it would have no volume.
        one_face = np.flatnonzero(corners_among(mask, corners) == d)
        cell = beside[one_face]
        face = corners[one_face][mask[corners[one_face]]].reshape(-1, d)
        n = start.rotation @ b.side_normal[side]
        edge = mesh.period.shortest(mesh.position[face[:, 1:]] - mesh.position[face[:, :1]])
        measure = n[0] * edge[:, 0, 1] - n[1] * edge[:, 0, 0] if d == 2 else np.cross(edge[:, 0], edge[:, 1]) @ n
        face[measure < 0, :2] = face[measure < 0, 1::-1]
        of_part = (np.tile(vector, (len(face), 1)) for vector in (n, b.side_normal[side], directions[side]))
        parts.append((np.full(len(face), number), np.full(len(face), k), face, cell, *of_part))
    for number, curve in enumerate(b.curves if start.curves is not None else ()):
        assert start.curves is not None
        if not _has_friction(b, curve.wall):
            continue
        # Where the fluid ends on a curve, the face beside the last one is of its surface.
        whole = particles.wall[start.curves.pressed].all(axis=1)
        here = np.flatnonzero((start.curves.curve == number) & whole)
        face, cell = start.curves.pressed[here][:, ::-1], start.curves.cell[here]  # with the fluid on the right
        edge = mesh.position[face[:, 0]] - mesh.position[face[:, 1]]
        edge /= np.linalg.norm(edge, axis=1)[:, None]
        n = np.stack([-edge[:, 1], edge[:, 0]], axis=1)
        turn = start.before.pose.rotation
        direction = b.domain.sense[curve.edges[0]] * (edge @ turn)
        of_wall = np.full(len(face), len(b.members) + number), np.full(len(face), curve.wall)
        parts.append((*of_wall, face, cell, n, n @ turn, direction))
    if not parts:
        return None
    part, wall, nodes, cells, normal, inward, along = (np.concatenate(column) for column in zip(*parts, strict=True))
    return WallFaces(part, wall, nodes, cells, normal, inward, along)


def _has_friction(boundary: Boundary, wall: int) -> bool:
    """Whether a wall slips with friction, by its number."""
    return boundary.walls[wall].has_friction


def _velocity(faces: WallFaces, motion: WallMotion, x: Array) -> Array:
    """Velocities (F, n, d) of the walls at points x (F, n, d), n beside each face [m/s]."""
    n = x.shape[1]
    direction = np.repeat(faces.direction, n, axis=0)
    return motion.along(np.repeat(faces.wall, n), x.reshape(-1, x.shape[-1]), direction).reshape(x.shape)


def _layer_faces(start: WallStart, faces: WallFaces, mesh: Mesh, particles: Particles, viscosity: Array) -> LayerFaces:
    """Faces as the layers there see them.

    Args:
        start: of the step.
        faces: F, on walls with layers.
        mesh: of the step.
        particles: the state at t_n.
        viscosity: (F,) kinematic viscosity [m^2/s].
    """
    face, turn = faces.nodes, start.before.pose.rotation
    apex = mesh.cells[faces.cell].sum(axis=1) - face.sum(axis=1)
    x = particles.position[apex][:, None]
    v = particles.velocity[apex] + 0.5 * start.scheme.dt * particles.acceleration[apex]
    along = 0.5 * (_velocity(faces, start.before, x) + _velocity(faces, start.after, x))[:, 0]
    wall = _velocity(faces, start.before, particles.position[face])
    u, slip = (v - along) @ turn, (particles.velocity[face] - wall).mean(axis=1) @ turn
    u -= (u * faces.inward).sum(axis=1)[:, None] * faces.inward
    slip -= (slip * faces.inward).sum(axis=1)[:, None] * faces.inward
    fluid = particles.fluid[face[:, 0]] if mesh.fluid is None else mesh.fluid[faces.cell]
    period, place = mesh.period, start.frame[face]
    middle = period.wrapped(period.unwrapped(place).mean(axis=1))
    spacing = particles.target[face].mean(axis=1)
    return LayerFaces(faces.part, middle, u, slip, viscosity, fluid, spacing, period)
