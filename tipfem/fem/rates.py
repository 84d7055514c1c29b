"""Kernels of the time integration: velocities and accelerations that are linear in others."""

import numpy as np
import taichi as ti

from tipfem.backend.array_types import Reals1, Template
from tipfem.backend.launch import kernel, launch
from tipfem.scratch import owned, scratch
from tipfem.typing import Array

ENTRY = 2.0  # nanoseconds of one thread for an entry


@kernel
def add_two(one: Reals1, other: Reals1, result: Reals1, of_one: ti.f64, of_other: ti.f64, serial: Template):
    """Set result (K,) to a linear combination of two vectors (K,)."""
    ti.loop_config(serialize=serial)
    for i in range(result.shape[0]):
        result[i] = of_one * one[i] + of_other * other[i]


@kernel
def end_rates(
    u: Reals1,
    v: Reals1,
    a: Reals1,
    velocity: Reals1,
    acceleration: Reals1,
    of_u: ti.f64,
    of_v: ti.f64,
    of_a: ti.f64,
    before: ti.f64,
    after: ti.f64,
    dt: ti.f64,
    serial: Template,
):
    """Set acceleration (K,) to of_u u - of_v v - of_a a, and velocity to v + dt (before a + after acceleration)."""
    ti.loop_config(serialize=serial)
    for i in range(u.shape[0]):
        acceleration[i] = of_u * u[i] - of_v * v[i] - of_a * a[i]
        velocity[i] = v[i] + dt * (before * a[i] + after * acceleration[i])


def combination(of_one: float, one: Array, of_other: float, other: Array, name: str = "") -> Array:
    """Linear combination of two arrays of one shape, in memory of a ``name`` or new; see `scratch`."""
    result = scratch(name, one.shape)
    fields = (np.ascontiguousarray(values).reshape(-1) for values in (one, other))
    launch(add_two, *fields, result.reshape(-1), of_one, of_other, work=(result.size, ENTRY))
    return result


def rates_at_end(u: Array, velocity: Array, acceleration: Array, *factors: float) -> tuple[Array, Array]:
    """Velocities and accelerations, arrays of one shape, see `end_rates`."""
    results = owned(u.shape), owned(u.shape)
    fields = (np.ascontiguousarray(values).reshape(-1) for values in (u, velocity, acceleration))
    launch(end_rates, *fields, *(each.reshape(-1) for each in results), *factors, work=(u.size, ENTRY))
    return results
