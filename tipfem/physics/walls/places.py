"""Particles that slide along walls in 3-D go back to their places before they crowd."""

from __future__ import annotations

import numpy as np

from tipfem.case.particles import Particles
from tipfem.mesh.mesh import Mesh, simplex_measure
from tipfem.typing import Array

FAR = 0.35  # distance from its place beyond which a particle goes back to it [spacings]
LEAST = 1e-3  # measure of cells that have gradients [h^3]


def back_to_places(particles: Particles, mesh: Mesh, index: Array, home: Array) -> int:
    """Put particles that have slid too far along walls back, in place; returns how many.

    What they carry is that of the fluid there: f(home) = f + grad f . (home - x), with the mean gradient of their
    cells, and between the values of these. ``index`` (K,) slide; ``home`` (K, 3) are their places [m].
    """
    shift = home - particles.position[index]
    far = np.linalg.norm(shift, axis=1) > FAR * particles.spacing
    index, shift, home = index[far], shift[far], home[far]
    if not len(index):
        return 0
    row = np.full(len(particles), -1)
    row[index] = np.arange(len(index))
    near = mesh.cells[(row[mesh.cells] >= 0).any(axis=1)]
    measure = simplex_measure(particles.position, near)
    good = measure > LEAST * particles.spacing**3
    near, measure = near[good], measure[good]
    corner = particles.position[near]
    inverse = np.linalg.inv(corner[:, 1:] - corner[:, :1])
    cell, k = np.nonzero(row[near] >= 0)
    to = row[near[cell, k]]
    weight = np.bincount(to, measure[cell], len(index))
    wet = weight > 0
    for name in ("velocity", "acceleration", "pressure"):
        values = getattr(particles, name)
        columns = values.reshape(len(particles), -1)
        for column in columns.T:
            of_cell = column[near]
            gradient = np.einsum("mij,mj->mi", inverse, of_cell[:, 1:] - of_cell[:, :1])
            part = measure[cell] * np.einsum("ei,ei->e", gradient[cell], shift[to])
            change = np.divide(np.bincount(to, part, len(index)), weight, out=np.zeros(len(index)), where=wet)
            low, high = np.full(len(index), np.inf), np.full(len(index), -np.inf)
            np.minimum.at(low, to, of_cell.min(axis=1)[cell])
            np.maximum.at(high, to, of_cell.max(axis=1)[cell])
            column[index[wet]] = np.clip(column[index] + change, low, high)[wet]
    particles.position[index] = home
    return len(index)
