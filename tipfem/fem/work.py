"""Kernels that sum energy and momentum of the particles, and the work of the forces of a step.

`step_work` reads the linearisation (``record``) and the element vectors (``local``) of the last residual, so it must
run before the next residual or Jacobian-vector product.
"""

from typing import NamedTuple

import numpy as np
import taichi as ti

from tipfem.backend.array_types import Flags1, Ints1, Ints2, Periods, Reals1, Reals2, Template
from tipfem.backend.launch import FEW_PARTS, add_parts, fold_parts, folds, kernel, part_of, shared_by_gpu
from tipfem.fem.bundles import Linearisation, Rates, Sizes, Topology
from tipfem.fem.element import row
from tipfem.fem.residual import ENDS, HOOP, PRESSURES, RADII, SHARES, displacement_of, gathered, linearisation

SUM = 5.0  # nanoseconds of one thread for a particle in `state_sums` and `step_sums`
WORKS = 6  # number of sums in `step_work`, not counting the force of the walls


class Start(NamedTuple):
    """Particles at the start of a step."""

    wall: "Flags1"  # (N,)
    velocity: "Reals2"  # (N, d)
    acceleration: "Reals2"


class End(NamedTuple):
    """Particles (N, d) at the end of a step, and their displacements in it."""

    position: "Reals2"
    velocity: "Reals2"
    acceleration: "Reals2"
    u: "Reals2"


class Loads(NamedTuple):
    """a_alpha = relative + force (N, d), and gravity (d,) [m/s^2]."""

    relative: "Reals2"
    force: "Reals2"
    gravity: "Reals1"


@kernel
def step_work(
    mesh: Topology,
    period: Periods,
    linear: Linearisation,
    source: Reals1,
    wall: Ints1,
    x: Reals1,
    partial: Reals2,
    result: Reals1,
    rates: Rates,
    sizes: Sizes,
    parts: ti.i32,
    stride: Template,
):
    """Work of the terms of the residual at ``x`` when it is tested with the displacements u and pressures p in ``x``.

    With L = sum_a u_a (x) g_a, H = sum_a u_a (x) G_a = (I - cf L)^-1 L, tau the viscous stress, and the
    invariants I2, I3 of H, result holds sums over the elements [J, per metre of depth in 2-D]:

    0: dt w tau : l, viscous dissipation;  1: w tau : L, work against the viscous stress
    2: A pbar ((2 cf - 1) I2 + (3 cf^2 - 1) I3) = pbar (w tr L - A (J_{n+1} - 1))  (without I3 in 2-D)
    3: A tau_s grad p . q, stabilisation;  4: A pbar s, volume source
    5: work of the walls, R . u of their particles;  6 ... 5 + d: the force of the walls, sum of R [N]
    """
    record, local = ti.static(linear)
    cf, dt = ti.static((rates.cf, rates.dt))
    elements, nodes, dim = ti.static(sizes)
    for t in range(parts * stride):
        works = ti.Vector.zero(float, WORKS)
        holding = ti.Vector.zero(float, dim)
        first, last = part_of(t, parts, stride, elements)
        for e in range(first, last):
            g_now, _c_next, _sigma, l, q, pressure_force, tail = linearisation(record, e, dim)
            w, area = tail[0], tail[1]
            big_l = ti.Matrix.zero(float, dim, dim)
            mean_p = 0.0
            # grad phi_0 = -sum of the others
            for a in ti.static(range(1, dim + 1)):
                g = ti.Vector([g_now[ti.static(a - 1), k] for k in ti.static(range(dim))])
                big_l += (
                    displacement_of(x, mesh.cells[e, a], dim) - displacement_of(x, mesh.cells[e, 0], dim)
                ).outer_product(g)
            for a in ti.static(range(dim + 1)):
                mean_p += x[mesh.cells[e, a] * (dim + 1) + dim] / (dim + 1)
            stress = tail[4] * (l + l.transpose())
            h = (ti.Matrix.identity(float, dim) - cf * big_l).inverse() @ big_l
            second = 0.5 * (h.trace() * h.trace() - (h @ h).trace())
            growth = (2.0 * cf - 1.0) * second
            if ti.static(dim == 3):
                growth += (3.0 * cf * cf - 1.0) * h.determinant()
            works[3] += tail[2] * pressure_force.dot(q) / tail[3]
            if ti.static(len(period.shape) == 3):
                more = ti.static(4 * dim * dim + 2 * dim + 5)
                turn = ti.static(2.0 * np.pi)
                mean_r = (record[e, more + RADII] + record[e, more + RADII + 1] + record[e, more + RADII + 2]) / 3.0
                rate, plane, flat = (record[e, more + HOOP], record[e, more + HOOP + 1], record[e, more + HOOP + 2])
                start = area / flat  # mean of 2 pi r at the start of the step
                spread, pushed, swelled = 0.0, 0.0, 0.0
                for a in ti.static(range(dim + 1)):
                    u, p = x[mesh.cells[e, a] * (dim + 1)], x[mesh.cells[e, a] * (dim + 1) + dim]
                    spread += u / (dim + 1)
                    pushed += w * (p * record[e, more + RADII + a] + p * 3.0 * mean_r) / 12.0 * big_l.trace()
                    pushed += w * turn * record[e, more + PRESSURES + a] * u
                    begin = record[e, more + SHARES + a] * start
                    swelled += p * flat * (plane * record[e, more + ENDS + a] - begin)
                    works[4] += p * flat * begin * source[e]
                works[0] += dt * w * (mean_r * (stress * l).sum() + 2.0 * tail[4] * rate * rate * mean_r)
                works[1] += w * (mean_r * (stress * big_l).sum() + 2.0 * tail[4] * rate * turn * spread)
                works[2] += pushed - swelled
            else:
                works[0] += dt * w * (stress * l).sum()
                works[1] += w * (stress * big_l).sum()
                works[2] += area * mean_p * growth
                works[4] += area * mean_p * source[e]
        first, last = part_of(t, parts, stride, nodes)
        for i in range(first, last):
            if wall[i] != 0:
                for k in ti.static(range(dim)):
                    force = gathered(local, mesh.corners, mesh.offsets[i], mesh.offsets[i + 1], k, dim + 1)
                    works[5] += force * x[i * (dim + 1) + k]
                    holding[k] += force
        if t % stride == 0:
            for k in ti.static(range(WORKS)):
                partial[t // stride, k] = works[k]
            for k in ti.static(range(dim)):
                partial[t // stride, WORKS + k] = holding[k]
    if ti.static(shared_by_gpu(stride)):
        for t in range(folds(parts, WORKS + dim)):
            fold_parts(partial, t, WORKS + dim, parts)
    ti.loop_config(serialize=True)
    for k in range(ti.static(WORKS + dim)):
        result[k] = 0.0
        add_parts(result, partial, k, ti.min(parts, FEW_PARTS))


@kernel
def left_over(
    residual: Reals1,
    scale: Reals1,
    wall: Ints1,
    x: Reals1,
    partial: Reals2,
    result: Reals1,
    nodes: ti.i32,
    dim: Template,
    parts: ti.i32,
    stride: Template,
):
    """result (2,): the work of a scaled ``residual`` at the nodes, tested with their unknowns ``x``.

    The second is that of the momentum of those at walls, along which they slip; it is no force of the wall.
    """
    for t in range(parts * stride):
        total = ti.Vector([0.0, 0.0])
        first, last = part_of(t, parts, stride, nodes)
        for i in range(first, last):
            for k in ti.static(range(dim + 1)):
                at = i * (dim + 1) + k
                if scale[at] != 0.0:
                    work = residual[at] / scale[at] * x[at]
                    if k == dim or wall[i] == 0:
                        total[0] += work
                    else:
                        total[1] += work
        if t % stride == 0:
            partial[t // stride, 0], partial[t // stride, 1] = total[0], total[1]
    if ti.static(shared_by_gpu(stride)):
        for t in range(folds(parts, 2)):
            fold_parts(partial, t, 2, parts)
    ti.loop_config(serialize=True)
    for k in range(2):
        result[k] = 0.0
        add_parts(result, partial, k, ti.min(parts, FEW_PARTS))


@kernel
def node_forces(
    index: Ints1, offsets: Ints1, corners: Ints1, local: Reals2, force: Reals2, count: ti.i32, dim: Template
):
    """force (K, d) [N, per metre of depth in 2-D] that holds each of ``count`` nodes, see `step_work`."""
    for s in range(count):
        i = index[s]
        for k in ti.static(range(dim)):
            force[s, k] = gathered(local, corners, offsets[i], offsets[i + 1], k, dim + 1)


@kernel
def lump(cells: Ints2, measure: Reals1, density: Reals1, mass: Reals1, dim: Template):
    """Add the elements' lumped mass [kg] to that of the particles (N,), in the order of the elements."""
    ti.loop_config(serialize=True)
    for e in range(cells.shape[0]):
        m = density[e] * measure[e] / (dim + 1)
        for a in ti.static(range(dim + 1)):
            mass[cells[e, a]] = mass[cells[e, a]] + m


@ti.func
def state_of(mass: ti.template(), position: ti.template(), velocity: ti.template(), i, dim: ti.template()):
    """Contributions of particle ``i`` to the sums m v . v, m x and m v."""
    v = row(velocity, i, dim)
    return mass[i] * v.dot(v), mass[i] * row(position, i, dim), mass[i] * v


@kernel
def state_sums(
    mass: Reals1,
    position: Reals2,
    velocity: Reals2,
    partial: Reals2,
    result: Reals1,
    dim: Template,
    parts: ti.i32,
    stride: Template,
    serial: Template,
):
    """Sums over the particles, added to result (1 + 2 d,): m v . v, then m x and m v in each direction."""
    ti.loop_config(serialize=serial)
    for t in range(parts * stride):
        energy, place, momentum = 0.0, ti.Vector.zero(float, dim), ti.Vector.zero(float, dim)
        first, last = part_of(t, parts, stride, mass.shape[0])
        for i in range(first, last):
            own_energy, own_place, own_momentum = state_of(mass, position, velocity, i, dim)
            energy += own_energy
            place += own_place
            momentum += own_momentum
        if t % stride == 0:
            partial[t // stride, 0] = energy
            for k in ti.static(range(dim)):
                partial[t // stride, 1 + k], partial[t // stride, 1 + dim + k] = place[k], momentum[k]
    ti.loop_config(serialize=True)
    for k in range(ti.static(1 + 2 * dim)):
        add_parts(result, partial, k, parts)


@kernel
def step_sums(
    mass: Reals1,
    before: Start,
    after: End,
    loads: Loads,
    partial: Reals2,
    result: Reals1,
    shift: float,
    dt: float,
    dim: Template,
    parts: ti.i32,
    stride: Template,
    serial: Template,
):
    """Sums over the particles of a step with displacements ``u``, added to result (3 + 4 d,).

    With a_alpha = relative + force: m a_alpha . u and m (force - gravity) . u, then in each direction m times the
    change of velocity + shift * acceleration (of wall particles dt a_alpha) and m force; then those of `state_sums`.
    """
    ti.loop_config(serialize=serial)
    for t in range(parts * stride):
        inertia, external, energy = 0.0, 0.0, 0.0
        change, weight = ti.Vector.zero(float, dim), ti.Vector.zero(float, dim)
        place, momentum = ti.Vector.zero(float, dim), ti.Vector.zero(float, dim)
        first, last = part_of(t, parts, stride, mass.shape[0])
        for i in range(first, last):
            own_energy, own_place, own_momentum = state_of(mass, after.position, after.velocity, i, dim)
            energy += own_energy
            place += own_place
            momentum += own_momentum
            b, displacement = row(loads.force, i, dim), row(after.u, i, dim)
            a = row(loads.relative, i, dim) + b
            inertia += mass[i] * a.dot(displacement)
            weight += mass[i] * b
            for k in ti.static(range(dim)):
                external += mass[i] * (b[k] - loads.gravity[k]) * displacement[k]
            if before.wall[i] != 0:
                change += mass[i] * dt * a
            else:
                gained = row(after.acceleration, i, dim) - row(before.acceleration, i, dim)
                change += mass[i] * (row(after.velocity, i, dim) - row(before.velocity, i, dim) + shift * gained)
        if t % stride == 0:
            partial[t // stride, 0], partial[t // stride, 1] = inertia, external
            for k in ti.static(range(dim)):
                partial[t // stride, 2 + k], partial[t // stride, 2 + dim + k] = change[k], weight[k]
            partial[t // stride, 2 + 2 * dim] = energy
            for k in ti.static(range(dim)):
                partial[t // stride, 3 + 2 * dim + k] = place[k]
                partial[t // stride, 3 + 3 * dim + k] = momentum[k]
    ti.loop_config(serialize=True)
    for k in range(ti.static(3 + 4 * dim)):
        add_parts(result, partial, k, parts)
