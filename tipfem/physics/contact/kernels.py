"""Kernel of the forces of contacts, see `tipfem.physics.contact.forces`."""

import taichi as ti

from tipfem.backend.array_types import Reals1, Reals2
from tipfem.backend.launch import kernel


@kernel
def sweep(
    response: Reals2, friction: Reals1, sweeps: ti.i32, least: ti.f64, force: Reals1, wrong: Reals1, moved: Reals1
):
    """Projected Gauss-Seidel on C contacts, until nothing moves by ``least`` [m] or more.

    ``response`` (2 C, 2 C) is symmetric; ``force`` and ``wrong`` (2 C,) as in `balanced`. moved[0] is by how much they
    were moved in the last of the ``sweeps``. One row depends on the one before: there is one thread.
    """
    ti.loop_config(serialize=True)
    for _ in range(1):
        count = friction.shape[0]
        for _each in range(sweeps):
            largest = ti.cast(0.0, ti.f64)
            for k in range(count):
                if response[k, k] > 0:
                    for way in range(2):
                        row = k + way * count
                        own = response[row, row]
                        if own > 0:
                            asked = force[row] - wrong[row] / own
                            limit = friction[k] * force[k]
                            asked = ti.max(asked, 0.0) if way == 0 else ti.min(ti.max(asked, -limit), limit)
                            if asked != force[row]:
                                change = asked - force[row]
                                force[row] = asked
                                for i in range(2 * count):
                                    wrong[i] = wrong[i] + change * response[row, i]
                                largest = ti.max(largest, ti.abs(change) * own)
            moved[0] = largest
            if largest < least:
                break
