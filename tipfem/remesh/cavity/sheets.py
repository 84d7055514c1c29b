"""Cells in 3-D that would be flat within a step, where fluids meet walls and each other; see `stop_flattening`."""

import numpy as np

from tipfem.remesh.cavity.arrays import FIXED
from tipfem.remesh.cavity.balance import masses
from tipfem.remesh.cavity.cavities import Cavities, measures, touching
from tipfem.typing import Array

FLAT, STOPPED = 0.4, 0.9  # part of its volume that a cell would keep in a step where it is stopped, and then keeps
CLOSE_TO = 1e-3  # these parts
HELD = 1e-6  # part of what a cell yields to an impulse, without walls, below which walls hold it
ROUNDS = 100  # at most, for cells side by side


def stop_flattening(cavities: Cavities, density: Array, dt: float) -> None:
    """Stop particles that would flatten cells of fluids, or turn them over, in a step of length ``dt`` [s]; in place.

    As in an impact: by an impulse along the gradient of the cell's volume, which keeps momentum but for that of walls,
    and takes energy. Pressure cannot do it within the step, for it keeps the volume of the cells around a particle.
    """
    x, v = cavities.x, cavities.fields[:, : cavities.dim]
    cells = cavities.cells[cavities.label > 0]
    whole, end = measures(x, cells), measures(x + dt * v, cells)
    flat = end < FLAT * whole
    if not flat.any():
        return
    near = np.zeros(len(x), dtype=bool)
    near[cells[flat]] = True
    here = touching(near, cells)
    whole, least = whole[here], (np.where(flat, STOPPED, FLAT) * whole)[here]
    rows, number = np.unique(cells[here], return_inverse=True)
    cells = number.reshape(-1, cavities.dim + 1).astype(np.int32)
    near[rows] = True
    mass = masses(cavities, measures(x, cavities.cells), density, near)[rows]
    which, along = cavities.along_walls()
    light = np.where(cavities.marks[rows] & FIXED != 0, 0.0, 1 / mass)[:, None, None]
    moves = light * along[which[rows]]
    x, speed = x[rows], v[rows]
    for _ in range(ROUNDS):
        lack = least - measures(x + dt * speed, cells)
        short = np.flatnonzero(lack > CLOSE_TO * whole)
        if not len(short):
            break
        at = cells[short]
        gradient = _gradients((x + 0.5 * dt * speed)[at])
        way = np.einsum("tcij,tcj->tci", moves[at], gradient)
        yields, freely = (way * gradient).sum(axis=(1, 2)), (light[at][..., 0] * gradient**2).sum(axis=(1, 2))
        each = np.bincount(at.ravel(), minlength=len(rows))[at].max(axis=1)
        # Nothing helps where all corners slide past each other along walls.
        helps = yields > HELD * freely
        if not helps.any():
            break
        size = np.divide(lack[short], each * dt * yields, out=np.zeros(len(short)), where=helps)
        np.add.at(speed, at, size[:, None, None] * way)
    v[rows] = speed


def _gradients(corner: Array) -> Array:
    """(T, 4, 3) derivatives of the volumes of tetrahedra by the places of their corners (T, 4, 3)."""
    one, two, three = (corner[:, k] - corner[:, 0] for k in (1, 2, 3))
    sides = np.stack([np.cross(two, three), np.cross(three, one), np.cross(one, two)], axis=1) / 6
    return np.concatenate([-sides.sum(axis=1, keepdims=True), sides], axis=1)
