"""Kernels of friction along walls that slip.

They add to the results of `tipfem.fem.residual` and `tipfem.fem.jacobian`; vectors of unknowns are laid out as there.
"""

from typing import NamedTuple

import numpy as np
import taichi as ti

from tipfem.backend.array_types import Flags1, Ints1, Ints2, Longs1, Periods, Reals1, Reals2, Template
from tipfem.backend.launch import kernel
from tipfem.backend.periodic import difference
from tipfem.fem.element import row
from tipfem.fem.jacobian import block_entry
from tipfem.fem.residual import displacement_of
from tipfem.linalg.sparsity import Csr, run_starts
from tipfem.typing import Array

SLIDING = 10.0  # nanoseconds of one thread for a sliding particle in `slip_scale`
FACE = 100.0  # and for a face in `slip_residual` and `add_friction`


class SlidingFaces(NamedTuple):
    """Faces on walls with friction, and their nodes' lists, see `by_node`."""

    nodes: "Ints2"  # (F, d)
    starts: "Ints1"
    order: "Ints1"
    coefficient: "Reals1"  # (F,) mu / l
    normal: "Reals2"  # (F, d)
    wall_velocity: "Reals2"  # (F, d d)
    number: "int"  # F
    touched: "int"  # number of nodes


class FacesOnWalls(NamedTuple):
    """Faces on walls: their nodes (F, d), cell and wall (F,), normals and directions (F, d)."""

    nodes: "Ints2"
    cell: "Ints1"
    wall: "Ints1"
    inward: "Reals2"
    direction: "Reals2"


class SeenParticles(NamedTuple):
    """Fields (N, d) of the particles at the start of a step, ``predicted`` at its intermediate time."""

    position: "Reals2"
    velocity: "Reals2"
    acceleration: "Reals2"
    predicted: "Reals2"
    frame: "Reals2"  # positions in the tank's frame
    target: "Reals1"  # (N,) spacing


class Seen(NamedTuple):
    """Data of the faces for friction, see `see_faces`."""

    outer: "Reals2"  # (F, d)
    inner: "Reals2"
    middle: "Reals2"
    spacing: "Reals1"  # (F,)
    wall_velocity: "Reals2"  # (F, d d)
    measure: "Reals1"  # (F,)


class Rates(NamedTuple):
    """Velocities and accelerations (W, d) of wall particles, or (N, d) of all."""

    velocity: "Reals2"
    acceleration: "Reals2"


class LayerPoints(NamedTuple):
    """Points of layers (P,): distance and number of the nearest face, fluid and history (P, d)."""

    distance: "Reals1"
    face: "Ints1"
    before: "Ints1"
    history: "Reals2"


class LayerFaceArrays(NamedTuple):
    """Faces (F,) of `tipfem.physics.walls.layers.LayerFaces`, part by part, and the nearest point."""

    fluid: "Ints1"
    velocity: "Reals2"
    viscosity: "Reals1"
    spacing: "Reals1"
    part: "Ints1"
    point: "Ints1"


class AdvancedLayers(NamedTuple):
    """Results of `advance_layers`."""

    here: "Ints1"  # (P,) fluid of each point
    after: "Reals2"  # (P, d) its history
    flux: "Reals1"  # (P,) |U delta|
    length: "Reals1"  # (F,) slip length
    resolved: "Flags1"  # (F,)


def by_node(faces: Array) -> tuple[Array, Array]:
    """Index the list of corners f * d + a (F d,), ascending at each of the K nodes of faces (F, d): first (K + 1,)."""
    nodes = faces.ravel()
    order = np.argsort(nodes, kind="stable").astype(np.int32)
    return np.append(run_starts(nodes[order]), len(nodes)).astype(np.int32), order


def face_record_width(dim: int) -> int:
    """Entries of a face's linearisation, see `slip_residual`."""
    return 1 + 2 * dim * dim


@ti.func
def face_measure(side, n):
    """Length of an edge, or area of a triangle, spanned by the rows of ``side`` (d - 1, d), with a normal n."""
    result = 0.0
    if ti.static(n.n == 2):
        result = n[0] * side[0, 1] - n[1] * side[0, 0]
    else:
        one = ti.Vector([side[0, k] for k in ti.static(range(3))])
        two = ti.Vector([side[1, k] for k in ti.static(range(3))])
        result = 0.5 * n.dot(one.cross(two))
    return result


@ti.func
def measure_change(side, change, n):
    """Derivative of `face_measure` along a change (d - 1, d) of ``side``."""
    result = 0.0
    if ti.static(n.n == 2):
        result = face_measure(change, n)
    else:
        for a in ti.static(range(2)):
            mixed = side
            for k in ti.static(range(3)):
                mixed[a, k] = change[a, k]
            result += face_measure(mixed, n)
    return result


@ti.func
def block_of(row_offsets: Template, columns: Template, i, j):
    """Number of the block of row ``i`` and column ``j``, which are on a face together."""
    found = row_offsets[i]
    for s in range(row_offsets[i], row_offsets[i + 1]):
        if columns[s] == j:
            found = s
    return found


@kernel
def slip_scale(sliding: Ints1, friction: Reals1, scale: Reals1, count: ti.i32, dim: Template, serial: Template):
    """One scale for all momentum rows of a sliding particle, so that scaling commutes with the projection.

    sliding (count,): the particles; friction (count,) is the contribution of the wall to diag(A).
    """
    ti.loop_config(serialize=serial)
    for s in range(count):
        i = sliding[s]
        diagonal = friction[s]
        if scale[i * (dim + 1)] > 0.0:  # particles in no element have none
            for k in ti.static(range(dim)):
                diagonal += 1.0 / (dim * scale[i * (dim + 1) + k])
            for k in ti.static(range(dim)):
                scale[i * (dim + 1) + k] = 1.0 / diagonal


@kernel
def slip_residual(
    faces: SlidingFaces,
    period: Periods,
    motion: Reals2,
    x: Reals1,
    scale: Reals1,
    record: Reals2,
    out: Reals1,
    cv: float,
    cf: float,
    dim: Template,
    serial: Template,
):
    """Add Navier's friction to the scaled residual: node a of a face gets A / d mu / l (v_alpha,a - v_wall,a).

    A is the face's measure at the intermediate positions; lumping (nodal quadrature) keeps friction on the diagonal,
    however short the slip length. The projection removes the normal part of the wall's velocity.
    """
    ti.loop_config(serialize=serial)
    for f in range(faces.number):
        n = row(faces.normal, f, dim)
        first = row(motion, faces.nodes[f, 0], dim) + cf * displacement_of(x, faces.nodes[f, 0], dim)
        side = ti.Matrix.zero(float, dim - 1, dim)
        for a in ti.static(range(1, dim)):
            corner = row(motion, faces.nodes[f, a], dim) + cf * displacement_of(x, faces.nodes[f, a], dim)
            for k in ti.static(range(dim)):
                side[a - 1, k] = corner[k] - first[k]
                if ti.static(len(period.shape) == 2):
                    side[a - 1, k] -= period[0, k] * ti.floor(side[a - 1, k] * period[1, k] + 0.5)
                record[f, 1 + dim * dim + (a - 1) * dim + k] = side[a - 1, k]
        record[f, 0] = face_measure(side, n)
        for a in ti.static(range(dim)):
            i = faces.nodes[f, a]
            for k in ti.static(range(dim)):
                slip = cv * x[i * (dim + 1) + k] + motion[i, dim + k] - faces.wall_velocity[f, a * dim + k]
                record[f, 1 + a * dim + k] = slip
    ti.loop_config(serialize=serial)
    for q in range(faces.touched):
        for c in range(faces.starts[q], faces.starts[q + 1]):
            f = faces.order[c] // dim
            a = faces.order[c] - f * dim
            for k in ti.static(range(dim)):
                r = faces.nodes[f, a] * (dim + 1) + k
                force = scale[r] * record[f, 0] / dim * faces.coefficient[f] * record[f, 1 + a * dim + k]
                out[r] = out[r] + force


@kernel
def add_friction(
    faces: SlidingFaces,
    record: Reals2,
    scale: Reals1,
    matrix: Csr,
    cv: float,
    cf: float,
    rows: ti.i32,
    dim: Template,
    serial: Template,
):
    """Add the derivative of `slip_residual`, from the faces' linearisation, to the blocks of the Jacobian.

    faces (F, d): nodes of the mesh that is solved on, of ``rows`` nodes, whose rows and columns are those of their
    particles.
    """
    ti.loop_config(serialize=serial)
    for q in range(faces.touched):
        couplings = matrix.row_offsets[rows]
        for c in range(faces.starts[q], faces.starts[q + 1]):
            f = faces.order[c] // dim
            one = faces.order[c] - f * dim
            i = faces.nodes[f, one]
            n = row(faces.normal, f, dim)
            side = ti.Matrix.zero(float, dim - 1, dim)
            for a in ti.static(range(dim - 1)):
                for k in ti.static(range(dim)):
                    side[a, k] = record[f, 1 + dim * dim + a * dim + k]
            for other in ti.static(range(dim)):
                s = block_of(matrix.row_offsets, matrix.columns, i, faces.nodes[f, other])
                for m in ti.static(range(dim)):
                    # The corner's displacement changes the sides from the first corner.
                    change = ti.Matrix.zero(float, dim - 1, dim)
                    for a in ti.static(range(dim - 1)):
                        if ti.static(other == 0):
                            change[a, m] = -cf
                        elif ti.static(other == a + 1):
                            change[a, m] = cf
                    growth = measure_change(side, change, n)
                    for k in ti.static(range(dim)):
                        force = growth * record[f, 1 + one * dim + k]
                        if ti.static(k == m):
                            if one == other:
                                force += record[f, 0] * cv
                        uu = block_entry(couplings, s, k, m, dim)
                        matrix.values[uu] = (
                            matrix.values[uu] + scale[i * (dim + 1) + k] * force / dim * faces.coefficient[f]
                        )


@ti.func
def slid_by(free: Template, w, v):
    """Component of a vector along the walls of wall particle ``w``, by the projectors (W, d d)."""
    d = ti.static(v.n)
    result = ti.Vector.zero(float, d)
    for k, m in ti.static(ti.ndrange(d, d)):
        result[k] += free[w, k * d + m] * v[m]
    return result


@kernel
def hold(
    index: Longs1,
    free: Reals2,
    walls: Rates,
    given: Rates,
    result: Rates,
    of_walls: float,
    of_given: float,
    more: float,
    dim: Template,
):
    """Parts of sums of the walls' rates (W, d) and ``given`` ones (N, d) that walls hold, and ``more`` of these.

    ``index`` (W,): the wall particles; ``free`` (W, d d): projectors on the directions in which they slide.
    """
    ti.loop_config(serialize=True)
    for w in range(index.shape[0]):
        i = index[w]
        v = of_walls * row(walls.velocity, w, dim) + of_given * row(given.velocity, i, dim)
        a = of_walls * row(walls.acceleration, w, dim) + of_given * row(given.acceleration, i, dim)
        v, a = v - slid_by(free, w, v), a - slid_by(free, w, a)
        for k in ti.static(range(dim)):
            result.velocity[w, k] = more * given.velocity[i, k] + v[k]
            result.acceleration[w, k] = more * given.acceleration[i, k] + a[k]


@kernel
def slide(
    index: Longs1,
    free: Reals2,
    values: Reals2,
    held: Reals2,
    walls: Reals2,
    of_held: float,
    of_walls: float,
    dim: Template,
):
    """Set values (N, d) of wall particles to what slides of them and multiples of ``held`` (W, d), ``walls`` (N, d)."""
    ti.loop_config(serialize=True)
    for w in range(index.shape[0]):
        i = index[w]
        slid = slid_by(free, w, row(values, i, dim))
        for k in ti.static(range(dim)):
            values[i, k] = slid[k] + of_held * held[w, k] + of_walls * walls[i, k]


@kernel
def move(
    index: Longs1,
    free: Reals2,
    start: Reals2,
    walls: Reals2,
    one: Reals2,
    other: Reals2,
    result: Reals2,
    of_one: float,
    of_other: float,
    dim: Template,
):
    """Wall particles' positions (N, d): from ``start`` moved by ``walls``, and by what slides of a combination."""
    ti.loop_config(serialize=True)
    for w in range(index.shape[0]):
        i = index[w]
        slid = slid_by(free, w, of_one * row(one, i, dim) + of_other * row(other, i, dim))
        for k in ti.static(range(dim)):
            result[i, k] = start[i, k] + (walls[i, k] + slid[k])


@kernel
def list_nodes(faces: Ints2, cell: Ints1, cells: Ints2, owner: Ints1, nodes: Ints2):
    """The nodes (F, d) of faces of the mesh that is solved on, from their particles (F, d) and cells (F,)."""
    ti.loop_config(serialize=True)
    for f in range(faces.shape[0]):
        for a in range(faces.shape[1]):
            for i in range(cells.shape[1]):
                if owner[cells[cell[f], i]] == faces[f, a]:
                    nodes[f, a] = cells[cell[f], i]


@kernel
def list_faces(
    cells: Ints2,
    wall: Flags1,
    on: Flags1,
    normal: Reals2,
    position: Reals2,
    period: Periods,
    near: Ints1,
    count: Ints1,
    part: Ints1,
    cell: Ints1,
    nodes: Ints2,
    dim: Template,
):
    """The faces of a mesh on the straight parts of walls, part by part, and in each as their cells are numbered.

    A cell has one face on a straight wall: with all of its corners there it would have no volume. wall (N,): whether
    particles are on a wall; on (P N,): whether on each part, whose normals into the fluid are ``normal`` (P, d). Of
    each face its ``part`` (F,), ``cell`` (F,) and ``nodes`` (F, d), in the order in which its measure is positive;
    count (1,): how many there are. near (M,) is scratch.
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        beside, found, n = 0, 0, wall.shape[0]
        for c in range(cells.shape[0]):
            corners = 0
            for i in ti.static(range(dim + 1)):
                corners += ti.cast(wall[cells[c, i]], ti.i32)
            if corners >= dim:
                near[beside] = c
                beside += 1
        for p in range(normal.shape[0]):
            for b in range(beside):
                c, corners = near[b], 0
                for i in ti.static(range(dim + 1)):
                    corners += ti.cast(on[p * n + cells[c, i]], ti.i32)
                if corners == dim:
                    k = 0
                    for i in ti.static(range(dim + 1)):
                        if on[p * n + cells[c, i]]:
                            nodes[found, k] = cells[c, i]
                            k += 1
                    side = ti.Matrix.zero(float, dim - 1, dim)
                    for a, m in ti.static(ti.ndrange(dim - 1, dim)):
                        side[a, m] = difference(position, period, nodes[found, a + 1], nodes[found, 0], m)
                    if face_measure(side, row(normal, p, dim)) < 0:
                        nodes[found, 0], nodes[found, 1] = nodes[found, 1], nodes[found, 0]
                    part[found], cell[found] = p, c
                    found += 1
        count[0] = found


@ti.func
def velocity_of_wall(poses: Template, own: Template, m: Template, w, x, direction):
    """Velocity of wall ``w`` at x at the start (m = 0) or the end (1) of a step, see `see_faces`."""
    d = ti.static(x.n)
    v = ti.Vector.zero(float, d)
    for i in ti.static(range(d)):
        v[i] = poses[m, i]
        for j in ti.static(range(d)):
            v[i] += poses[m, 2 * d + i * d + j] * (x[j] - poses[m, d + j])
            along = own[m, w * (d + 1) + j] + own[m, w * (d + 1) + d] * direction[j]
            v[i] += poses[m, (2 + d) * d + i * d + j] * along
    return v


@kernel
def see_faces(
    faces: FacesOnWalls,
    cells: Ints2,
    particles: SeenParticles,
    period: Periods,
    poses: Reals2,
    own: Reals2,
    seen: Seen,
    dt: float,
    cf: float,
    dim: Template,
):
    """Collect the data of the F faces on walls for friction, see `tipfem.physics.walls.friction.WallFaces`.

    Of the particles in the next row the velocity relative to the wall, along it, in the tank's frame, in the middle of
    the step: outer (F, d); the same of those of the face at its start: inner (F, d). In that frame the face's
    ``middle`` (F, d), from the positions there, ``frame`` (N, d); the mean ``spacing`` (F,) of its particles' targets;
    the wall's velocity at each of its nodes at the intermediate time, wall_velocity (F, d d), with the positions
    ``predicted`` (N, d); and its ``measure`` (F,).

    poses (2, 2 d + 2 d^2): velocity, centre, angular velocity and rotation of the tank before and after the step;
    own (2, W (d + 1)): velocity of each of W walls along itself, and its speed in the ``direction`` (F, d).
    """
    ti.loop_config(serialize=True)
    for f in range(faces.nodes.shape[0]):
        along, n, apex = row(faces.direction, f, dim), row(faces.inward, f, dim), cells[faces.cell[f], dim]
        for a in ti.static(range(dim)):
            apex += cells[faces.cell[f], a] - faces.nodes[f, a]
        x = row(particles.position, apex, dim)
        v = row(particles.velocity, apex, dim) + 0.5 * dt * row(particles.acceleration, apex, dim)
        for m in ti.static(range(2)):
            v -= 0.5 * velocity_of_wall(poses, own, m, faces.wall[f], x, along)
        mean, mid, size = ti.Vector.zero(float, dim), ti.Vector.zero(float, dim), 0.0
        side = ti.Matrix.zero(float, dim, dim)
        for a in ti.static(range(dim)):
            i = faces.nodes[f, a]
            now = velocity_of_wall(poses, own, 0, faces.wall[f], row(particles.position, i, dim), along)
            then = velocity_of_wall(poses, own, 1, faces.wall[f], row(particles.predicted, i, dim), along)
            mean += (row(particles.velocity, i, dim) - now) / dim
            size += particles.target[i] / dim
            for k in ti.static(range(dim)):
                mid[k] += difference(particles.frame, period, i, faces.nodes[f, 0], k) / dim
                side[a, k] = difference(particles.position, period, i, faces.nodes[f, 0], k)
                seen.wall_velocity[f, a * dim + k] = (1.0 - cf) * now[k] + cf * then[k]
        if ti.static(dim == 2):
            seen.measure[f] = ti.sqrt(side[1, 0] ** 2 + side[1, 1] ** 2)
        else:
            one = ti.Vector([side[1, k] for k in ti.static(range(3))])
            two = ti.Vector([side[2, k] for k in ti.static(range(3))])
            seen.measure[f] = 0.5 * one.cross(two).norm()
        seen.spacing[f] = size
        u, s = ti.Vector.zero(float, dim), ti.Vector.zero(float, dim)  # in the tank's frame
        for i, j in ti.static(ti.ndrange(dim, dim)):
            u[j] += v[i] * poses[0, (2 + dim) * dim + i * dim + j]
            s[j] += mean[i] * poses[0, (2 + dim) * dim + i * dim + j]
        u, s = u - u.dot(n) * n, s - s.dot(n) * n
        for k in ti.static(range(dim)):
            seen.outer[f, k], seen.inner[f, k] = u[k], s[k]
            seen.middle[f, k] = particles.frame[faces.nodes[f, 0], k] + mid[k]
            if ti.static(len(period.shape) == 2):
                if period[0, k] > 0.0:
                    seen.middle[f, k] -= period[0, k] * ti.floor(seen.middle[f, k] / period[0, k])
                    if seen.middle[f, k] >= period[0, k]:
                        seen.middle[f, k] = 0.0


@kernel
def advance_layers(
    points: LayerPoints,
    faces: LayerFaceArrays,
    dt: float,
    reach: float,
    flows: float,
    least: float,
    found: AdvancedLayers,
    dim: Template,
):
    """See `tipfem.physics.walls.layers.advance`; slip lengths are at least ``least`` spacings."""
    ti.loop_config(serialize=True)
    for i in range(points.face.shape[0]):
        f = points.face[i]
        h, u = faces.spacing[f], row(faces.velocity, f, dim)
        found.here[i] = faces.fluid[f] if points.distance[i] < reach * h else -1
        old = row(points.history, i, dim)
        if found.here[i] != points.before[i]:
            old *= 0.0
        speed = u.norm()
        new = old + 4.0 / ti.math.pi * dt * faces.viscosity[f] * speed * u
        # A layer that the mesh resolves needs no more of a history than that: after a reversal it must be thin again.
        size, most = new.norm(), ti.max((h * speed) ** 2, old.norm())
        if size > most:
            new *= most / size
        found.flux[i] = 0.5 * (ti.sqrt(old.norm()) + ti.sqrt(new.norm()))
        for k in ti.static(range(dim)):
            found.after[i, k] = new[k] if found.here[i] >= 0 else 0.0
    ti.loop_config(serialize=True)
    for _ in range(1):
        first = 0
        while first < faces.part.shape[0]:
            last, square = first, 0.0
            while last < faces.part.shape[0] and faces.part[last] == faces.part[first]:
                square += row(faces.velocity, last, dim).norm_sqr()
                last += 1
            usual = ti.sqrt(square / (last - first))
            for f in range(first, last):
                # Where several fluids meet, a face takes the nearest point of its own.
                mean, h, speed = 0.0, faces.spacing[f], row(faces.velocity, f, dim).norm()
                if found.here[faces.point[f]] == faces.fluid[f]:
                    mean = found.flux[faces.point[f]]
                thickness = mean / speed if mean < 0.5 * h * speed else 0.5 * h
                found.length[f] = ti.max(0.5 * ti.math.pi * thickness * (1.0 - 2.0 * thickness / h), least * h)
                # Where the flow stops or turns round, u delta is that of before, and tells nothing about delta.
                found.resolved[f] = mean > 0.0 and mean >= 0.5 * h * ti.max(speed, flows * usual)
            first = last


@kernel
def stick_to_layers(
    nodes: Ints2, part: Ints1, viscosity: Reals1, resolved: Flags1, weight: Reals2, stuck: Flags1, dim: Template
):
    """Mark as ``stuck`` (N,) the particles on faces of one part with a resolved layer; the more viscous fluid decides.

    The faces (F,) are sorted by their ``part``; weight (N, 2), zero before and after, is scratch.
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        first = 0
        while first < part.shape[0]:
            last = first
            while last < part.shape[0] and part[last] == part[first]:
                for a in ti.static(range(dim)):
                    weight[nodes[last, a], 0] += viscosity[last]
                    weight[nodes[last, a], 1] += viscosity[last] if resolved[last] else 0.0
                last += 1
            for f in range(first, last):
                for a in ti.static(range(dim)):
                    if weight[nodes[f, a], 1] > 0.5 * weight[nodes[f, a], 0]:
                        stuck[nodes[f, a]] = 1
            for f in range(first, last):
                for a in ti.static(range(dim)):
                    weight[nodes[f, a], 0], weight[nodes[f, a], 1] = 0.0, 0.0
            first = last


@kernel
def add_shares(nodes: Ints2, share: Reals1, sliding: Longs1, total: Reals1, result: Reals1):
    """Sums of the shares (F,) of faces (F, d) at ``sliding`` particles (K,): result (K,). total (N,) is scratch."""
    ti.loop_config(serialize=True)
    for k in range(sliding.shape[0]):
        total[sliding[k]] = 0.0
    ti.loop_config(serialize=True)
    for f in range(nodes.shape[0]):
        for a in range(nodes.shape[1]):
            total[nodes[f, a]] = total[nodes[f, a]] + share[f]
    ti.loop_config(serialize=True)
    for k in range(sliding.shape[0]):
        result[k] = total[sliding[k]]


@kernel
def find_nearest(
    place: Reals2, part: Ints1, others: Reals2, part_of_others: Ints1, period: Periods, distance: Reals1, number: Ints1
):
    """Distance (P,) from places (P, 2) to the nearest of others (Q, 2) on the same part of a wall, and its number (P,).

    1e15 m, and 0, where there is none on that part; the first of several at the same distance. Both are sorted by part.
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        first = 0
        for i in range(place.shape[0]):
            least, found = 1e30, 0
            while first < others.shape[0] and part_of_others[first] < part[i]:
                first += 1
            j = first
            while j < others.shape[0] and part_of_others[j] == part[i]:
                square = 0.0
                for k in ti.static(range(2)):
                    d = others[j, k] - place[i, k]
                    if ti.static(len(period.shape) == 2):
                        d -= period[0, k] * ti.floor(d * period[1, k] + 0.5)
                    square += d * d
                if square < least:
                    least, found = square, j
                j += 1
            distance[i], number[i] = ti.sqrt(least), found


@kernel
def friction_work(
    record: Reals2,
    nodes: Ints2,
    coefficient: Reals1,
    wall_velocity: Reals2,
    sliding: Ints1,
    rows: Reals2,
    displacement: Reals2,
    number: Ints1,
    dissipated: Reals2,
    done: Reals2,
    dt: float,
    dim: Template,
):
    """Dissipation of friction on faces (F,) but for the factor dt, and work against it: (F, d * d), to be summed.

    ``record`` has the slips of the residual; ``nodes`` (F, d) are particles. In the rows of ``sliding`` ones (K,)
    the slip is projected by ``rows`` (K, d * d); other particles have none. number (N,) is scratch.
    """
    ti.loop_config(serialize=True)
    for i in range(number.shape[0]):
        number[i] = -1
    ti.loop_config(serialize=True)
    for k in range(sliding.shape[0]):
        number[sliding[k]] = k
    ti.loop_config(serialize=True)
    for f in range(nodes.shape[0]):
        for a in ti.static(range(dim)):
            k = number[nodes[f, a]]
            for i in ti.static(range(dim)):
                slip = 0.0
                for j in ti.static(range(dim)):
                    if k >= 0:
                        slip += rows[ti.max(k, 0), i * dim + j] * record[f, 1 + a * dim + j]
                force = record[f, 0] * coefficient[f] / dim * slip
                dissipated[f, a * dim + i] = force * slip
                done[f, a * dim + i] = force * (displacement[nodes[f, a], i] - dt * wall_velocity[f, a * dim + i])
