"""PressureJump: the pressures on the sides of interfaces between two steps, carried through remeshing.

Each fluid at a particle has a pressure of its own. The solve of a step finds all of them, so that these values are its
first guess, and what is stored. A light fluid needs a good one: in air, ten pascals over a spacing of 5 mm accelerate
by 1 700 m/s^2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tipfem.backend.launch import launch
from tipfem.mesh.mesh import Mesh
from tipfem.physics.carried import Carried
from tipfem.physics.side_pressures import kernels
from tipfem.scratch import copied, owned, scratch
from tipfem.typing import Array

SWEEPS = 3  # a particle that has no neighbour with a pressure in its fluid takes one in the next sweep


@dataclass(frozen=True)
class PressureJump(Carried):
    """The pressures of the fluids at the particles; the next solve starts from them."""

    # (F, N) pressure of each fluid at each particle less that of the particle [Pa], 0 where the fluid is not
    values: Array


def pressures_on_sides(
    pressure: Array, jump: Array, known: Array, mesh: Mesh, fluid: Array, density: Array, acceleration: Array
) -> tuple[Array, Array]:
    """Pressures (N,) of the heaviest fluids after remeshing, and (F, N) of each fluid there less that one, 0 elsewhere.

    Where a fluid had none at a particle it is the mean of p_j + rho (b - a_j) . (x - x_j) at the other corners j of the
    fluid's cells there: the pressure of a fluid that goes on with its acceleration a under the body force b. Before,
    ``jump`` (F, N) is that of each fluid less ``pressure`` (N,) [Pa] where ``known``; ``fluid`` (N,) is the heaviest,
    ``acceleration`` (N, d) b - a [m/s^2].
    """
    assert mesh.components is not None
    at, side, carried = mesh.components.at_particle, np.add(pressure, jump, out=owned(jump.shape)), copied(pressure)
    given = np.ascontiguousarray(mesh.cells), np.ascontiguousarray(mesh.fluid), mesh.position, mesh.period.array
    flags, sums = np.ascontiguousarray(known).view(np.int8).ravel(), scratch("side_pressures.sums", (2, at.size))
    launch(
        kernels.extend_pressures,
        *given,
        kernels.Sides(at, fluid, density),
        acceleration,
        SWEEPS,
        kernels.Found(sums[0], sums[1], copied(flags, "side_pressures.flags")),
        side,
        carried,
        mesh.dimension,
    )
    return carried, side


def of_renumbered(values: Array, renumbered: Array | None, relocated: Array, name: str) -> Array:
    """Values (F, N) of particles as (F, N') of those after a repair, see `Repaired`; 0 for those ``relocated`` (N').

    They are in memory of that ``name``, see `scratch`.
    """
    result = scratch(name, (len(values), len(relocated)), values.dtype.type)
    result.fill(0)
    if renumbered is None:
        result[:] = values
    else:
        kept = renumbered >= 0
        result[:, renumbered[kept]] = values[:, kept]
    result[:, relocated] = 0
    return result
