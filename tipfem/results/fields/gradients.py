"""Gradients of a velocity in the cells of a mesh, and values of cells recovered at its particles, in NumPy."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial import cKDTree

from tipfem.typing import Array

SAME_PLACE = 1e-6  # of the spacing: particles that are closer, up to a period, are one


def cell_gradients(position: Array, cells: Array, velocity: Array, period: Array | None) -> tuple[Array, Array]:
    """Velocity gradients (M, d, d) of linear cells [1/s], element ij that of component i along axis j, and areas (M,).

    Gradients are zero in cells without an area; areas are volumes in 3-D. ``period`` (d,) is 0 along other axes [m].
    """
    edges = position[cells[:, 1:]] - position[cells[:, :1]]
    if period is not None:
        width = np.where(period > 0, period, 1.0)
        edges -= np.round(edges / width) * period
    changes = velocity[cells[:, 1:]] - velocity[cells[:, :1]]
    measure = np.abs(np.linalg.det(edges)) / math.factorial(position.shape[1])
    flat = measure <= 0
    edges[flat] = np.eye(position.shape[1])
    gradients = np.linalg.solve(edges, changes).transpose(0, 2, 1)
    gradients[flat] = 0.0
    return gradients, measure


def at_particles(values: Array, measure: Array, cells: Array, mine: Array, first: Array) -> Array:
    """Means (N, ...) of the values of the cells around each particle, by their areas; 0 in no cell.

    ``mine`` (M, d + 1) masks the particles of each cell whose fluid is that of the cell; cells of other fluids count
    only where a particle has no cell of its own. ``first`` (N,) is the lowest number of those that are one across
    periodic sides.
    """
    count, corner = len(first), first[cells]
    has_own = np.bincount(corner[mine], minlength=count) > 0
    weight = np.where(mine | ~has_own[corner], measure[:, None], 0.0)
    total = np.bincount(corner.ravel(), weight.ravel(), count)
    columns = [
        np.bincount(corner.ravel(), (weight * column[:, None]).ravel(), count)
        for column in values.reshape(len(cells), -1).T
    ]
    means = np.stack(columns, axis=1) / np.where(total > 0, total, 1.0)[:, None]
    return np.asarray(means[first].reshape(count, *values.shape[1:]))


def wrapped(position: Array, period: Array) -> Array:
    """Places (N, d) between 0 and the period along periodic axes [m]; the period (d,) is 0 along others."""
    axes = np.flatnonzero(period > 0)
    home = position.copy()
    home[:, axes] %= period[axes]
    home[:, axes] = np.where(home[:, axes] < period[axes], home[:, axes], 0.0)  # a remainder may round up to the width
    return np.asarray(home)


def first_of_each(home: Array, period: Array, tolerance: float) -> Array:
    """The lowest number (N,) of the particles at the same place as each, of those that are `wrapped`."""
    first = np.arange(len(home))
    pairs = cKDTree(home, boxsize=period).query_pairs(tolerance, output_type="ndarray")
    np.minimum.at(first, pairs.max(axis=1), pairs.min(axis=1))
    return np.asarray(first)
