"""Whether the particles of a tank fit into the memory, before any time is spent on them."""

from __future__ import annotations

import math
import os
from pathlib import Path

# Measured, see docs/performance.md: of a run, and of the lattice alone that a grading thins out.
BYTES_A_PARTICLE = {2: 4.5e3, 3: 16e3}
BYTES_OF_LATTICE = 300.0
MOST = 5e7  # particles, where the memory is not known


def available_memory() -> float:
    """Memory that this process may still take [bytes]; infinite where the system does not tell."""
    free = math.inf
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        free = next(1024.0 * float(line.split()[1]) for line in lines if line.startswith("MemAvailable:"))
    except (OSError, ValueError, StopIteration):
        try:
            free = float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
        except (AttributeError, ValueError, OSError):
            pass
    try:
        group = Path("/sys/fs/cgroup")
        limit = float((group / "memory.max").read_text(encoding="ascii"))
        free = min(free, limit - float((group / "memory.current").read_text(encoding="ascii")))
    except (OSError, ValueError):  # no limit: "max"
        pass
    return free


def too_many(content: float, spacing: float, dimension: int, *, graded: bool = False) -> str:
    """Objection to a spacing [m] in an area or volume, because of the memory; "" for none, and for gradings."""
    count = content
    for _ in range(dimension):  # one by one: the power of a tiny spacing is 0
        count /= spacing
    each = BYTES_OF_LATTICE if graded else BYTES_A_PARTICLE[dimension]
    most = min(available_memory() / each, MOST)
    if count <= most:
        return ""
    if not math.isfinite(count):
        return f"is {spacing:g} m, far too small for this tank: no memory holds that many particles"
    least = (content / most) ** (1 / dimension)
    return (
        f"is {spacing:g} m, which makes about {count:.2g} particles. They take about {count * each / 1e9:.3g} GB of "
        f"memory, and there is room for {most:.2g}: it must be {float(f'{1.05 * least:.2g}'):g} m or more here"
    )
