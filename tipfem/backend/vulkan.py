"""Abilities of a Vulkan driver, found by small kernels when Taichi is started on it.

Mesa's software driver llvmpipe, on which the kernels are tested where there is no GPU, has three defects (found in
version 22.3.6) that a GPU's driver is not expected to have:

- It takes the memory barrier that Taichi puts before every atomic operation for one that threads wait at. Where
  threads of a group go through a loop a different number of times, operations of the last rounds are lost. So one
  thread counts and lists (``one_counts`` of `tipfem.backend.launch`).
- Where a group has a single thread, as for Taichi's serial loops, the idle lanes of the processor's vectors take part
  in ``while`` loops, and may never leave them. So serial loops are given groups of two threads, see
  `tipfem.backend.taichi_patches`.
- It ends all loops of a thread after 65535 iterations in sum, in silence. So sums are split into as few parts as on the
  processor, and large meshes are refused.
"""

from dataclasses import dataclass

import numpy as np
import taichi as ti

from tipfem.backend import taichi_patches
from tipfem.backend.array_types import Ints1, Reals1

TRIED = 1 << 17  # iterations after which a loop is taken to have no limit
# Iterations for a cell of the kernels that loop over the mesh on one thread. All results are right for 38 (1700 cells,
# limit 65535), and the first are wrong for 9.
ITERATIONS_OF_CELL = 32


@dataclass(frozen=True)
class Driver:
    """Abilities of a driver."""

    counts_in_loops: bool  # whether all atomic operations take place in loops whose lengths differ between threads
    ends_serial_loops: bool  # whether a loop in a loop on one thread ends when its condition says so
    longest_loop: int | None  # number of iterations after which loops are ended anyway; None for no limit

    @property
    def most_cells(self) -> int | None:
        """Largest number of cells of a mesh; None for no limit."""
        return None if self.longest_loop is None else self.longest_loop // ITERATIONS_OF_CELL


@ti.kernel
def _thirds(values: Reals1):  # type: ignore[no-untyped-def]
    """Divide by three."""
    for i in range(values.shape[0]):
        values[i] = values[i] / 3


@ti.kernel
def _count(counts: Ints1, threads: ti.i32, length: ti.i32):  # type: ignore[no-untyped-def]
    """Add one to each of ``threads * length`` counts by atomic operations, ``length`` by each thread."""
    for i in range(threads):
        for k in range(length):
            ti.atomic_add(counts[i * length + k], 1)


@ti.kernel
def _follow(following: Ints1, visits: Ints1, first: ti.i32, second: ti.i32):  # type: ignore[no-untyped-def]
    """Count visits on the paths from ``first`` and from ``second`` to the end, -1."""
    ti.loop_config(serialize=True)
    for k in range(2):
        i = first if k == 0 else second
        while i >= 0:
            visits[i] = visits[i] + 1
            i = following[i]


@ti.kernel
def _loop(reached: Ints1, length: ti.i32):  # type: ignore[no-untyped-def]
    """reached[0]: how many of ``length`` iterations there were."""
    ti.loop_config(serialize=True)
    for k in range(length):
        reached[0] = k + 1


def examine() -> Driver:
    """Examine Taichi's driver, and set up what its defects require; `RuntimeError` if they cannot be avoided."""
    _require_doubles()
    threads, length = 5, 6
    counts = ti.ndarray(ti.i32, (threads * length,))
    _count(counts, threads, length)
    following, visits = ti.ndarray(ti.i32, (4,)), ti.ndarray(ti.i32, (4,))
    following.from_numpy(np.array([1, -1, 3, -1], dtype=np.int32))
    _follow(following, visits, 0, 2)
    reached = ti.ndarray(ti.i32, (1,))
    _loop(reached, TRIED)
    longest = int(reached.to_numpy()[0])
    driver = Driver(
        bool((counts.to_numpy() == 1).all()),
        bool((visits.to_numpy() == 1).all()),
        None if longest == TRIED else longest,
    )
    if not driver.ends_serial_loops and not taichi_patches.ENABLED:
        raise RuntimeError(
            "init: this Vulkan driver needs changes in Taichi, which are switched off by the environment variable "
            f"{taichi_patches.SWITCH}, or are not made for this version of Taichi"
        )
    taichi_patches.group_serial_loops[0] = not driver.ends_serial_loops
    return driver


def _require_doubles() -> None:
    values = ti.ndarray(ti.f64, (2,))
    values.from_numpy(np.array([1.0, 2.0]))
    ti.set_logging_level(ti.CRITICAL)  # Taichi would print its own message before ours
    try:
        _thirds(values)
    except RuntimeError as error:
        raise RuntimeError("init: the Vulkan driver has no 64-bit floats, which the kernels need") from error
    finally:
        ti.set_logging_level(ti.ERROR)
    if not np.allclose(values.to_numpy(), [1 / 3, 2 / 3], rtol=1e-15, atol=0.0):
        raise RuntimeError("init: the Vulkan driver does not compute in 64-bit floats, which the kernels need")
