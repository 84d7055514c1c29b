"""Runs in memory that has garbage wherever values are undefined. ``python garbage.py SEED`` prints their digests."""

from __future__ import annotations

import hashlib
import json
import sys

import numpy as np

import tipfem.scratch

WATER, AIR = ("water", 998.2, 1.002e-3), ("air", 1.204, 1.825e-5)


def fill_memory(seed: int) -> None:
    """Have `numpy.empty` and `tipfem.scratch` return arrays that are full of some values; before others are imported.

    Without a seed they have what was there.
    """
    if not seed:
        return
    real, whole = [np.nan, 1e300, -3.7][seed % 3], [-7, 1, 123456][seed % 3]

    def filling(function):
        def filled(*arguments, **options):
            result = function(*arguments, **options)
            result.fill(real if result.dtype.kind == "f" else np.array(whole).astype(result.dtype))
            return result

        return filled

    np.empty, np.empty_like = filling(np.empty), filling(np.empty_like)
    for name in ("owned", "scratch"):
        setattr(tipfem.scratch, name, filling(getattr(tipfem.scratch, name)))


def runs():
    """Simulations by their names, and how many steps each takes."""
    import tipfem as tp

    tp.init("cpu", threads=2)
    water, air = tp.Fluid(*WATER), tp.Fluid(*AIR)
    narrow = tp.tank((1.0, 0.3, 0.6), 0.05, jitter=0.2).fill(water, box=((0, 0, 0), (0.4, 0.3, 0.4)))
    yield "dam in space", tp.Simulation(tp.Case(narrow, [water], (0, 0, -9.81), free_surface=True)), 65
    box = tp.tank((0.5, 0.5, 0.5), 0.1, jitter=0.15).fill(air).fill(water, box=((0, 0, 0), (0.2, 0.5, 0.3)))
    yield "two in space", tp.Simulation(tp.Case(box, [water, air], (0, 0, -9.81))), 20
    plane = tp.tank((0.4, 0.4), 0.02).fill(air).fill(water, box=((0, 0), (0.14, 0.28)))
    yield "two in the plane", tp.Simulation(tp.Case(plane, [water, air], (0, -9.81))), 40
    alone = tp.tank((0.8, 0.4), 0.02).fill(water, box=((0, 0), (0.2, 0.3)))
    yield "dam in the plane", tp.Simulation(tp.Case(alone, [water], (0, -9.81), free_surface=True)), 80


def main(seed: int) -> None:
    """Print the digest of each run's last state in JSON."""
    fill_memory(seed)
    found = {}
    for name, simulation, steps in runs():
        for _ in range(steps):
            simulation.step()
        particles = simulation.particles
        values = particles.position, particles.velocity, particles.pressure, simulation.mesh.cells
        digest = hashlib.sha256(b"".join(each.tobytes() for each in values)).hexdigest()[:12]
        found[name] = f"{digest}, {len(particles)} particles at {simulation.time:.4f} s"
    print(json.dumps(found))


if __name__ == "__main__":
    main(int(sys.argv[1]))
