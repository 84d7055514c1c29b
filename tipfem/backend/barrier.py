"""How the threads of a processor share one kernel: each member of a team does its part, then all meet.

A loop of Taichi's own wakes its threads and waits for them, 20 to 100 microseconds each time: as long as the loops of a
multigrid cycle take. Inside one kernel, to meet takes a fifth of a microsecond, because who waits stays awake. A kernel
made so runs on processors only, with no more members than Taichi has threads:

    for t in range(members * spread):  # see `runtime.spread`
        if t % spread == 0:
            first, last = share(t // spread, members, n)
            ...
            meet(meeting, members)
"""

import time
from typing import Any

import taichi as ti

from tipfem.backend.launch import Launcher
from tipfem.backend.runtime import chunks, spread, threads

# Entries of the array that a team meets in: how many members have come, and how often all had, a cache line apart.
MEETING = 64
_PASSED = 32


@ti.func
def share(member, members, n):
    """First and last + 1 of 0 ... n that are a member's to do."""
    size = (n + members - 1) // members
    first = ti.min(member * size, n)
    return first, ti.min(first + size, n)


@ti.func
def meet(meeting: ti.template(), members):
    """Wait until all members have come here; what they have written before, all see behind.

    ``meeting`` (MEETING,) integers, zero before the first meeting.
    """
    if members > 1:
        before = ti.atomic_add(meeting[_PASSED], 0)
        if ti.atomic_add(meeting[0], 1) == members - 1:
            meeting[0] = 0
            ti.atomic_add(meeting[_PASSED], 1)
        else:
            while ti.atomic_add(meeting[_PASSED], 0) == before:
                pass


class Team:
    """How many threads share a kernel in which they meet: all, unless others want the processor too.

    Who waits there for a thread that is not running waits for milliseconds. So a team whose threads have run for less
    than `RUNNING` of the time is one thread for a while. Results do not depend on it.
    A team of more than Taichi has threads would wait for ever.
    """

    RUNNING = 0.65
    LOOK, REST = 0.01, 0.5  # seconds: of work between two looks, and how long to go on with one thread

    def __init__(self) -> None:
        self._worked = self._ran = self._rest_until = 0.0

    def launch(self, launcher: Launcher, kernel: Any, arguments: tuple[Any, ...], alone: bool, dim: int) -> None:
        """Start ``kernel`` with ``arguments``, then members, spread, whether one thread does it, and ``dim``."""
        begin = time.perf_counter()
        members = min(threads(), chunks())
        if alone or begin < self._rest_until:
            members = 1
        ran = time.process_time()
        launcher(kernel, *arguments, members, spread(alone), alone, dim)
        if members > 1:
            end = time.perf_counter()
            self._worked += members * (end - begin)
            self._ran += time.process_time() - ran
            if self._worked > members * self.LOOK:
                if self._ran < self.RUNNING * self._worked:
                    self._rest_until = end + self.REST
                self._worked = self._ran = 0.0


team = Team()
