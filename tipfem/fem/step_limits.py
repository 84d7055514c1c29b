"""Kernels that measure how far a step deforms elements and moves particles."""

from typing import NamedTuple

import taichi as ti

from tipfem.backend.array_types import Flags1, Ints2, Periods, Reals1, Reals2, Template
from tipfem.backend.launch import FEW_PARTS, folds, kernel, part_of, shared_by_gpu
from tipfem.fem.bundles import Sizes
from tipfem.fem.element import row, volume_ratio
from tipfem.fem.residual import displacement_of

ELEMENT, PARTICLE = 15.0, 5.0  # nanoseconds of one thread for an element in `step_limits`, a particle in `jumps`


class StepFields(NamedTuple):
    """Fields (N, d) of a step: a_alpha = inertia + force, the rates at its start, and displacements."""

    inertia: "Reals2"
    force: "Reals2"
    acceleration: "Reals2"
    velocity: "Reals2"
    u: "Reals2"


@kernel
def smallest_jacobian(
    cells: Ints2,
    position: Reals2,
    period: Periods,
    velocity: Reals2,
    partial: Reals1,
    result: Reals1,
    dt: float,
    elements: ti.i32,
    dim: Template,
    parts: ti.i32,
    stride: Template,
):
    """result[0]: the smallest J = det(I + dt grad v) of an element, or its previous value if that is smaller."""
    for t in range(parts * stride):
        smallest = 1e30
        first, last = part_of(t, parts, stride, elements)
        for e in range(first, last):
            motion = ti.Matrix.zero(float, dim + 1, dim)
            for a in ti.static(range(dim + 1)):
                v = row(velocity, cells[e, a], dim)
                for k in ti.static(range(dim)):
                    motion[a, k] = dt * v[k]
            smallest = ti.min(smallest, volume_ratio(cells, e, position, period, motion, dim))
        if t % stride == 0:
            partial[t // stride] = smallest
    ti.loop_config(serialize=True)
    for _ in range(1):
        smallest = result[0]
        for c in range(parts):
            smallest = ti.min(smallest, partial[c])
        result[0] = smallest


@kernel
def step_limits(
    cells: Ints2,
    position: Reals2,
    period: Periods,
    target: Reals1,
    x: Reals1,
    partial: Reals2,
    result: Reals1,
    sizes: Sizes,
    parts: ti.i32,
    stride: Template,
    serial: Template,
):
    """Quantities that limit a step, in ``result``.

    These are the smallest J_{n+1}, the largest |u|^2 over the square of the particle's ``target`` (N,), and how many
    entries of ``x`` are not finite.
    """
    elements, nodes, dim = ti.static(sizes)
    ti.loop_config(serialize=serial)
    for t in range(parts * stride):
        smallest = 1e30
        largest = 0.0
        bad = 0.0
        first, last = part_of(t, parts, stride, elements)
        for e in range(first, last):
            motion = ti.Matrix.zero(float, dim + 1, dim)
            for a in ti.static(range(dim + 1)):
                for k in ti.static(range(dim)):
                    motion[a, k] = x[cells[e, a] * (dim + 1) + k]
            smallest = ti.min(smallest, volume_ratio(cells, e, position, period, motion, dim))
        first, last = part_of(t, parts, stride, nodes)
        for i in range(first, last):
            u = displacement_of(x, i, dim)
            largest = ti.max(largest, u.dot(u) / target[i] ** 2)
            for k in ti.static(range(dim + 1)):
                if ti.math.isnan(x[i * (dim + 1) + k]) or ti.math.isinf(x[i * (dim + 1) + k]):
                    bad += 1.0
        if t % stride == 0:
            partial[t // stride, 0] = smallest
            partial[t // stride, 1] = largest
            partial[t // stride, 2] = bad
    if ti.static(shared_by_gpu(stride, serial)):
        for first in range(folds(parts, 1)):
            for m in range(1, (parts - first + FEW_PARTS - 1) // FEW_PARTS):
                c = first + m * FEW_PARTS
                partial[first, 0] = ti.min(partial[first, 0], partial[c, 0])
                partial[first, 1] = ti.max(partial[first, 1], partial[c, 1])
                partial[first, 2] = partial[first, 2] + partial[c, 2]
    ti.loop_config(serialize=True)
    for _ in range(1):
        smallest, largest, bad = 1e30, 0.0, 0.0
        for c in range(ti.min(parts, FEW_PARTS)):
            smallest = ti.min(smallest, partial[c, 0])
            largest = ti.max(largest, partial[c, 1])
            bad += partial[c, 2]
        result[0], result[1], result[2] = smallest, largest, bad


@kernel
def add_correction(
    correction: Reals1,
    x: Reals1,
    motion_factor: float,
    pressure_factor: float,
    size: ti.i32,
    dim: Template,
    serial: Template,
):
    """x += factor ``correction``, with one factor for the displacements and one for the pressures."""
    ti.loop_config(serialize=serial)
    for k in range(size):
        factor = motion_factor
        if k % (dim + 1) == dim:
            factor = pressure_factor
        x[k] = x[k] + factor * correction[k]


@kernel
def jumps(
    mass: Reals1,
    target: Reals1,
    wall: Flags1,
    step: StepFields,
    partial: Reals2,
    result: Reals1,
    full: float,
    dt: float,
    dim: Template,
    parts: ti.i32,
    stride: Template,
    serial: Template,
):
    """Largest change of acceleration, speed and acceleration by ``force`` of a particle, and two sums, in result (5,).

    The change is that from ``acceleration`` to inertia + force, of particles off walls. Change and speed are
    weighted by a particle's mass over that of target^d of the density ``full``, up to 1. The sums are those of
    m |u|^2 (change / target)^2, of particles off walls, and of m |u|^2.
    """
    ti.loop_config(serialize=serial)
    for t in range(parts * stride):
        change, speed, largest = 0.0, 0.0, 0.0
        changes, moved = 0.0, 0.0
        first, last = part_of(t, parts, stride, mass.shape[0])
        for i in range(first, last):
            room = full
            new, own, way, by_force = 0.0, 0.0, 0.0, 0.0
            for k in ti.static(range(dim)):
                room *= target[i]
                new += (step.inertia[i, k] + step.force[i, k] - step.acceleration[i, k]) ** 2
                own += step.velocity[i, k] ** 2
                way += step.u[i, k] ** 2
                by_force += step.force[i, k] ** 2
            weight = ti.min(1.0, mass[i] / room)
            moved += mass[i] * way
            if wall[i] == 0:
                change = ti.max(change, weight * ti.sqrt(new))
                changes += mass[i] * way * new / target[i] ** 2
            speed = ti.max(speed, weight * ti.max(ti.sqrt(own), ti.sqrt(way) / dt))
            largest = ti.max(largest, ti.sqrt(by_force))
        if t % stride == 0:
            partial[t // stride, 0], partial[t // stride, 1], partial[t // stride, 2] = change, speed, largest
            partial[t // stride, 3], partial[t // stride, 4] = changes, moved
    ti.loop_config(serialize=True)
    for c in range(parts):
        for k in range(3):
            result[k] = ti.max(result[k], partial[c, k])
        for k in range(3, 5):
            result[k] = result[k] + partial[c, k]
