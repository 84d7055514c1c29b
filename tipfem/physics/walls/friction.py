"""Friction along walls that slip, in a step: the faces of the mesh on them, and their boundary layers.

A wall has friction by a slip length of its own (Navier), or by that of the layer that the mesh does not resolve, see
`tipfem.physics.walls.layers`. It consists of parts: straight ones, each on a side of the domain, and curves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tipfem.backend.launch import launch
from tipfem.case.boundary.boundary import Boundary
from tipfem.case.particles import Particles
from tipfem.fem.time_integration import TimeScheme
from tipfem.geometry.plane.vectors import turned
from tipfem.mesh.components import ON_HULL, ON_INTERFACE
from tipfem.mesh.mesh import Mesh
from tipfem.physics.walls import kernels
from tipfem.physics.walls.curve_step import CurveStep
from tipfem.physics.walls.layers import LAYER, RESOLVED, LayerFaces, Layers, advance, begin
from tipfem.physics.walls.motion import WallMotion
from tipfem.scratch import filled, owned, picked, scratch
from tipfem.typing import Array


@dataclass(frozen=True)
class Faces:
    """The F faces of the walls that slip with friction."""

    nodes: Array  # (F, d) particles, in the order in which the measure is positive with the normal
    cell: Array  # (F,) the faces' cells
    coefficient: Array  # (F,) viscosity over slip length [Pa s / m]
    normal: Array  # (F, d) of the wall, into the fluid, at the intermediate time
    wall_velocity: Array  # (F, d * d) of the wall at each node, at the intermediate time [m/s]
    friction: Array  # (K,) their contribution to diag(A) of each sliding particle [kg / s^2]

    @staticmethod
    def none(dimension: int, sliding: int) -> Faces:
        """No faces, of walls with a number of ``sliding`` particles."""
        vectors, numbers = np.zeros((0, dimension)), np.zeros(0, dtype=np.int32)
        nothing = np.zeros(0), vectors, np.zeros((0, dimension * dimension)), np.zeros(sliding)
        return Faces(vectors.astype(np.int32), numbers, *nothing)


@dataclass(frozen=True)
class WallStart:
    """Walls in a step from t_n to t_n + dt, as friction needs them; N particles, d dimensions."""

    boundary: Boundary  # of the case
    scheme: TimeScheme  # time integration, with the step's length
    # before, after: motion of the walls at t_n and at t_n + dt
    before: WallMotion
    after: WallMotion
    rotation: Array  # (d, d) of the tank in between
    frame: Array  # (N, d) the positions at t_n in the tank's own frame [m]
    predicted: Array  # (N, d) positions of wall particles at t_n + dt, exact for the fixed ones [m]
    sliding: Array  # (K,) the particles that slide along their walls
    curves: CurveStep | None  # the curves in the step; None without any


@dataclass(frozen=True)
class WallFaces:
    """The F faces of the mesh on walls with friction."""

    # (F,) number of the part of a wall that each is on: that in `Boundary.members`, or, for a curve, after all of these
    part: Array
    wall: Array  # (F,) number of the wall
    nodes: Array  # (F, d) particles of each face, in the order in which the measure is positive with the normal
    cell: Array  # (F,) the faces' cells
    normal: Array  # (F, d) into the fluid, at the intermediate time
    inward: Array  # (F, d) the same in the tank's own frame
    direction: Array  # (F, d) in which the wall slides with a positive speed


def friction_in_step(
    start: WallStart, mesh: Mesh, particles: Particles, viscosity: Array, density: Array | None, layers: Layers | None
) -> tuple[Faces, Layers | None, Array | None]:
    """The friction of the walls in a step: its faces, and the layers at its end, None without walls of that law.

    And a mask (N,) of the particles at which layers are resolved. ``density`` (M,) is needed by walls with a layer.
    """
    boundary, scheme, d, count = start.boundary, start.scheme, mesh.dimension, len(mesh.position)
    begins, stuck = layers is None, None
    layers = layers or Layers.on(boundary, start.frame[boundary.index])
    faces = _faces_on_walls(start, mesh, particles)
    if faces is None:
        return Faces.none(d, len(start.sliding)), layers, stuck
    length = np.array([wall.slip_length or 0.0 for wall in boundary.walls])[faces.wall]
    seen = _seen(start, faces, mesh, particles)
    if layers is not None:
        assert density is not None
        on = np.flatnonzero(np.array([wall.law == LAYER for wall in boundary.walls])[faces.wall])
        nodes, part, cell = faces.nodes[on], faces.part[on], faces.cell[on]
        mu = viscosity[cell]
        fluid = particles.fluid[nodes[:, 0]] if mesh.fluid is None else mesh.fluid[cell]
        middle, outer, inner, spacing = (values[on] for values in (seen.middle, seen.outer, seen.inner, seen.spacing))
        near = LayerFaces(part, middle, outer, inner, mu / density[cell], fluid, spacing, mesh.period)
        layers, length[on], resolved = advance(begin(layers, near) if begins else layers, near, scheme.dt)
        # Where fluids meet, the more viscous one decides.
        stuck, weight = filled(False, "", count, bool), filled(0.0, "friction.weight", (count, 2))
        flags = resolved.view(np.int8), weight, stuck.view(np.int8)
        launch(kernels.stick_to_layers, nodes, part, mu, *flags, d)
    length, stuck = _beside_contacts(length, stuck, faces, boundary, mesh, particles)
    # Of an axisymmetric flow on the band that a face sweeps, at its radius at the start of the step.
    band = mesh.period.radius(mesh.position[faces.nodes]).mean(axis=1) if mesh.period.axial else 1.0
    carries = np.array([wall.carries for wall in boundary.walls])[faces.wall]
    coefficient = viscosity[faces.cell] / np.where(carries, np.inf, length) * band
    if carries.any():
        assert density is not None
        mu, rho, h = viscosity[faces.cell], density[faces.cell], seen.spacing
        coefficient[carries] = ((mu / h + rho * h / scheme.dt) / RESOLVED * band)[carries]
    friction, share = owned(len(start.sliding)), scheme.cv * coefficient * seen.measure / d
    launch(kernels.add_shares, faces.nodes, share, start.sliding, scratch("friction.sum", count), friction)
    return Faces(faces.nodes, faces.cell, coefficient, faces.normal, seen.wall_velocity, friction), layers, stuck


def _beside_contacts(
    length: Array, stuck: Array | None, faces: WallFaces, boundary: Boundary, mesh: Mesh, particles: Particles
) -> tuple[Array, Array | None]:
    """Slip lengths (F,) and stuck particles, as contacts with an angle need them; see `friction_in_step`.

    A no-slip wall holds the fluid as a resolved layer does. Beside a contact the slip length is at least a spacing,
    unless the wall has one of its own: a line of contact on a wall that held it could not move (C. Huh & L. E. Scriven,
    Hydrodynamic model of steady movement of a solid/liquid/fluid contact line, Journal of Colloid and Interface Science
    35, 1971). The spacing stands for the length on which it slips in nature.
    """
    angles = [bool(wall.contact_angle) for wall in boundary.walls]
    angled = np.array(angles)[faces.wall] if any(angles) else np.zeros(0, dtype=bool)
    if not angled.any():
        return length, stuck
    spacing = particles.target[faces.nodes].mean(axis=1)
    if mesh.components is not None:
        contact = mesh.components.mark == ON_INTERFACE + ON_HULL
    if mesh.components is None or not mesh.used.all():  # also where the fluids end along a wall
        ends = np.bincount(faces.nodes.ravel(), minlength=len(particles)) == 1
        ends[boundary.index[boundary.pinned]] = False
        contact = ends if mesh.components is None else contact | ends
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
    straight = [number for number, (k, *_) in enumerate(b.members) if b.walls[k].has_friction]
    if straight:
        walls, side = (np.array([b.members[number][k] for number in straight], dtype=np.int32) for k in range(2))
        on = filled(0, "friction.on", (len(straight), len(mesh.position)), np.int8)
        for row, number in enumerate(straight):
            on[row, b.index[b.members[number][2]]] = 1
        # No more than both sides of a wall have, for which a plane has two triangles a particle at most.
        most = 2 * (d - 1) * sum(len(b.members[number][2]) for number in straight)
        count, part, cell, face = (np.empty(shape, dtype=np.int32) for shape in (1, most, most, (most, d)))
        launch(
            kernels.list_faces,
            np.ascontiguousarray(mesh.cells),
            particles.wall.view(np.int8),
            on.ravel(),
            b.side_normal[side] @ start.rotation.T,
            mesh.position,
            mesh.period.array,
            scratch("friction.cells", len(mesh.cells), np.int32),
            count,
            part,
            cell,
            face,
            d,
        )
        part, cell, face = part[: count[0]], cell[: count[0]], face[: count[0]]
        normal, direction = b.side_normal[side], (b.domain.direction * b.domain.sense[:, None])[side]
        vectors = (picked(values, part) for values in (normal @ start.rotation.T, normal, direction))
        parts.append((np.array(straight, dtype=np.int32)[part], walls[part], face, cell, *vectors))
    for number, curve in enumerate(b.curves if start.curves is not None else ()):
        assert start.curves is not None
        if not b.walls[curve.wall].has_friction:
            continue
        here = np.flatnonzero(start.curves.curve == number)
        chord, of = start.curves.pressed[here][:, ::-1], start.curves.cell[here]  # with the fluid on the right
        edge = mesh.position[chord[:, 0]] - mesh.position[chord[:, 1]]
        edge /= np.linalg.norm(edge, axis=1)[:, None]
        n = turned(edge)
        turn = start.before.pose.rotation
        direction = b.domain.sense[curve.edges[0]] * (edge @ turn)
        of_wall = np.full(len(chord), len(b.members) + number), np.full(len(chord), curve.wall)
        parts.append((*of_wall, chord, of, n, n @ turn, direction))
    if not parts:
        return None
    columns = parts[0] if len(parts) == 1 else tuple(np.concatenate(column) for column in zip(*parts, strict=True))
    *numbers, normal, inward, along = columns
    part, wall, nodes, cells = (np.ascontiguousarray(column, dtype=np.int32) for column in numbers)
    return WallFaces(part, wall, nodes, cells, normal, inward, along)


def _seen(start: WallStart, faces: WallFaces, mesh: Mesh, particles: Particles) -> kernels.Seen:
    """Data of faces for friction: see `kernels.see_faces`."""
    count, d = faces.nodes.shape
    motions = start.before, start.after
    poses = np.stack([motion.array for motion in motions])
    own = np.stack([motion.along_walls.ravel() for motion in motions])
    outer, inner, middle = owned((3, count, d))
    seen = kernels.Seen(outer, inner, middle, owned(count), owned((count, d * d)), owned(count))
    x, v, a = map(np.ascontiguousarray, (particles.position, particles.velocity, particles.acceleration))
    fields = x, v, a, np.ascontiguousarray(start.predicted), np.ascontiguousarray(start.frame)
    launch(
        kernels.see_faces,
        kernels.FacesOnWalls(faces.nodes, faces.cell, faces.wall, faces.inward, faces.direction),
        np.ascontiguousarray(mesh.cells),
        kernels.SeenParticles(*fields, particles.target),
        mesh.period.array,
        poses,
        own,
        seen,
        start.scheme.dt,
        start.scheme.cf,
        d,
    )
    return seen
