"""Barriers inside a kernel: each thread does its share of a loop, then waits for all others.

A parallel loop of Taichi's wakes its threads and waits for them, 20 to 100 microseconds each time: as long as the loops
of a multigrid cycle take. A barrier inside a kernel takes 0.2 microseconds, because waiting threads spin. Such
a kernel runs on CPUs only, with no more threads than Taichi has. `tipfem.backend.launch.launch` fills in
its last parameters:

    @kernel
    def smooth(x: Reals1, n: ti.i32, barrier: Ints1, threads: ti.i32, stride: Template, serial: Template):
        ti.loop_config(serialize=serial)
        for t in range(threads * stride):
            if t % stride == 0:
                first, last = share(t // stride, threads, n)
                ...
                synchronise(barrier, threads)

A GPU's threads wait for each other within a group only, with ``ti.simt.block.sync()``. A loop of `GROUP` iterations
after ``ti.loop_config(block_dim=GROUP)`` is one group, whose threads share loops by `rounds`.
"""

import time
from typing import Any

import taichi as ti

from tipfem.backend import runtime

GROUP = 512  # threads of a GPU that can wait for each other, see `rounds`
# Entries of a barrier's array: how many threads have arrived, and how often all had, a cache line apart.
ENTRIES = 64
_PASSED = 32


@ti.func
def share(thread, threads, n):  # type: ignore[no-untyped-def]
    """The range of a thread in 0 ... n: its first number, and its last + 1."""
    size = (n + threads - 1) // threads
    first = ti.min(thread * size, n)
    return first, ti.min(first + size, n)


@ti.func
def rounds(count, thread):  # type: ignore[no-untyped-def]
    """Number of ``count`` iterations that a thread of a GPU's group takes: that of its number, each `GROUP` further."""
    return (count - thread + GROUP - 1) // GROUP


@ti.func
def synchronise(barrier: ti.template(), threads):  # type: ignore[no-untyped-def]
    """Wait until all threads have arrived, whose writes all then see; ``barrier`` (ENTRIES,) is zero at first."""
    if threads > 1:
        before = ti.atomic_add(barrier[_PASSED], 0)
        if ti.atomic_add(barrier[0], 1) == threads - 1:
            barrier[0] = 0
            ti.atomic_add(barrier[_PASSED], 1)
        else:
            while ti.atomic_add(barrier[_PASSED], 0) == before:
                pass


def available() -> bool:
    """Whether threads can wait for each other inside a kernel; they can on CPUs."""
    return runtime.on_cpu()


_array: list[Any] = []


def array() -> Any:
    """The device array of the barrier; one serves all kernels, because they run one at a time."""
    if not _array:
        _array.append(ti.ndarray(ti.i32, (ENTRIES,)))  # zeros
    return _array[0]


class Sharing:
    """Choice of the threads that share a kernel with barriers: all, unless other programs use the CPU too.

    Waiting at a barrier for a thread that the system has suspended takes milliseconds. So where the threads have run
    for less than the fraction `RUNNING` of the time, kernels run on one thread for a while: briefly at first, as
    sixteen threads are suspended now and then also where little else runs, and longer each time that they still are.
    Results do not depend on it. With more threads than Taichi has, a barrier would never be passed.
    """

    RUNNING = 0.65
    CHECK = 0.01  # [s] of work between two checks
    FIRST_REST, REST = 0.03, 0.5  # [s] how long to continue with one thread, at first and at most

    def __init__(self) -> None:
        self._worked = self._ran = self._rest_until = 0.0
        self._rest = self.FIRST_REST
        self._count, self._begin, self._ran_before = 1, 0.0, 0.0

    def __call__(self, most: int) -> "Sharing":
        """For a kernel of at most ``most`` threads; ``with`` returns how many it gets, and measures them."""
        self._count = most
        return self

    def __enter__(self) -> int:
        self._begin = time.perf_counter()
        if self._begin < self._rest_until:
            self._count = 1
        if self._count > 1:
            self._ran_before = time.process_time()
        return self._count

    def __exit__(self, *_: object) -> None:
        if self._count == 1:
            return
        end = time.perf_counter()
        self._worked += self._count * (end - self._begin)
        self._ran += time.process_time() - self._ran_before
        if self._worked > self._count * self.CHECK:
            if self._ran < self.RUNNING * self._worked:
                self._rest_until = end + self._rest
                self._rest = min(2 * self._rest, self.REST)
            else:
                self._rest = self.FIRST_REST
            self._worked = self._ran = 0.0


sharing = Sharing()
