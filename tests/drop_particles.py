"""Particles of a drop whose outline is a ring of even spacing, as a drop at rest needs it."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

import tipfem as tp
from tipfem.case.fluid import ranks

RADIUS = 0.4


def drop_case(fluids, radius=4, box=5, excess=0.0, walls=(), **options):
    """A drop of the second fluid, of radius `RADIUS`, in the middle of a box of the first; no gravity.

    Args:
        fluids: outside and inside.
        radius: of the drop, in spacings.
        box: its side, in radii.
        excess: relative amplitude of cos(2 phi) in the outline's radius.
        walls: of the case.
        options: further ones of the case.
    """
    h, size, rng = RADIUS / radius, box * RADIUS, np.random.default_rng(0)
    count = round(size / h) + 1
    line = np.linspace(0.0, size, count)
    lattice = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    wall = (lattice == line[0]).any(axis=1) | (lattice == line[-1]).any(axis=1)
    lattice += np.where(wall[:, None], 0.0, 0.15 * h * rng.uniform(-1, 1, lattice.shape))
    phi = 2 * np.pi * np.arange(round(2 * np.pi * radius)) / round(2 * np.pi * radius) + 0.1
    distance = RADIUS * (1 + excess * np.cos(2 * phi)) / np.sqrt(1 + excess**2 / 2)
    ring = distance[:, None] * np.stack([np.cos(phi), np.sin(phi)], axis=1)
    dense = np.concatenate([ring + part * (np.roll(ring, -1, axis=0) - ring) for part in np.linspace(0, 1, 8)[:-1]])
    far = cKDTree(dense + size / 2).query(lattice)[0] > 0.62 * h
    lattice, wall = lattice[far | wall], wall[far | wall]
    away = lattice - size / 2
    angle = np.arctan2(away[:, 1], away[:, 0])
    edge = RADIUS * (1 + excess * np.cos(2 * angle)) / np.sqrt(1 + excess**2 / 2)
    inside = (np.hypot(*away.T) < edge).astype(int)
    position = np.concatenate([lattice, ring + size / 2])
    fluid, wall = (
        np.append(inside, np.full(len(ring), np.argmax(ranks(fluids)))),
        np.append(wall, np.zeros(len(ring), bool)),
    )
    particles = tp.Particles(position, fluid, wall, spacing=h)
    return tp.Case(particles, fluids, (0, 0), walls=walls, **options)
