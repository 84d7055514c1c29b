"""How the threads of a processor share one kernel: each member of a team does its part, then all meet.

A loop of Taichi's own wakes its threads and waits for them, 20 to 100 microseconds each time: as long as the loops of a
multigrid cycle take. Inside one kernel, to meet takes a fifth of a microsecond, because who waits stays awake. A kernel
made so runs on processors only, with no more members than Taichi has threads:

    for t in range(members * spread):  # see `device.spread`
        if t % spread == 0:
            first, last = share(t // spread, members, n)
            ...
            meet(meeting, members)
"""

import taichi as ti

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
