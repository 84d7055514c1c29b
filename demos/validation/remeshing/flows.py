"""Flows in the unit square or cube that are free of divergence and at rest at its walls, and bodies that they carry."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay

from tipfem.mesh.mesh import Mesh, simplex_measure

Array = NDArray[np.float64]
Velocity = Callable[[Array, float], Array]
JITTER = 0.2  # of the lattice, in spacings
SNAP = 0.75  # particles nearer to a surface than this are moved onto it, in spacings
FLAT = 1e-9  # a cell of less than this volume, in spacings to the power d, lies in a wall


def _double(x: Array) -> Array:
    return np.asarray(np.sin(2 * math.pi * x))


def _square(x: Array) -> Array:
    return np.asarray(np.sin(math.pi * x) ** 2)


def vortex(x: Array, t: float) -> Array:
    """The single vortex of Rider and Kothe, back at t = 8."""
    s, d = _square(x), _double(x)
    return math.cos(math.pi * t / 8) * np.stack([-s[:, 0] * d[:, 1], s[:, 1] * d[:, 0]], axis=1)


def deformation(x: Array, t: float) -> Array:
    """LeVeque's deformation of the cube, back at t = 3."""
    (sx, sy, sz), (dx, dy, dz) = _square(x).T, _double(x).T
    return math.cos(math.pi * t / 3) * np.stack([2 * sx * dy * dz, -dx * sy * dz, -dx * dy * sz], axis=1)


def rotation(x: Array, t: float) -> Array:
    """One turn in t = 2 about the axis x = y = 1/2, rigid around the middle and at rest at the walls."""
    r = x[:, :2] - 0.5
    near = np.stack([(0.48 - np.linalg.norm(r, axis=1)) / 0.07, (0.46 - np.abs(x[:, 2] - 0.5)) / 0.26])
    part = np.clip(near, 0.0, 1.0)
    rate = math.pi * (part**2 * (3 - 2 * part)).prod(axis=0)
    return np.stack([-rate * r[:, 1], rate * r[:, 0], 0 * rate], axis=1)


def strain(sign: float) -> Velocity:
    """A flow that stretches the fluid in the middle of the cube along x (sign 1), or flattens it (-1)."""

    def velocity(x: Array, t: float) -> Array:
        s, m = _square(x) * _double(x), _square(x)
        slope = 2 * math.pi * (_double(x) ** 2 / 2 + _square(x) * np.cos(2 * math.pi * x))  # ds/dx
        out = s[:, 0] * (slope[:, 1] * m[:, 2] + m[:, 1] * slope[:, 2])
        down, side = -slope[:, 0] * s[:, 1] * m[:, 2], -slope[:, 0] * m[:, 1] * s[:, 2]
        return 0.1 * sign * np.stack([out, down, side], axis=1)

    return velocity


def balls(radius: float, *centres: tuple[float, ...]) -> Callable[[Array], Array]:
    """Signed distances of points from the surface of balls, negative inside."""
    return lambda x: np.min([np.linalg.norm(x - np.array(c), axis=1) for c in centres], axis=0) - radius


def slotted(x: Array) -> Array:
    """Signed distances of points from Zalesak's sphere: radius 0.15, a slot 0.1 wide, 0.125 deep."""
    ball = balls(0.15, (0.5, 0.75, 0.5))(x)
    slot = np.maximum(np.abs(x[:, 0] - 0.5) - 0.05, x[:, 1] - (0.75 - 0.15 + 0.125))
    return np.asarray(np.maximum(ball, -slot))


@dataclass(frozen=True)
class Flow:
    """A body in a flow.

    Attributes:
        dimension: of space.
        velocity: of points (N, d) at a time (N, d).
        distance: signed distances of points from the body's surface at the start.
        end: time of the run.
        angle: smallest that the check lets pass [degrees].
        step: how far a particle moves in a step, in spacings.
        returns: whether the body is then where it began.
        film: height in spacings below which films break, 0 for never.
        pieces: how many there must be at the end, at least and at most.
        half: whether the part x > 0.35 of the body is of a fluid of its own.
    """

    dimension: int
    velocity: Velocity
    distance: Callable[[Array], Array]
    end: float
    angle: float
    step: float = 0.5
    returns: bool = True
    film: float = 0.0
    pieces: tuple[int, float] = (1, 1)
    half: bool = False


_BALL = balls(0.15, (0.35, 0.35, 0.35))
FLOWS = {
    "vortex": Flow(2, vortex, balls(0.15, (0.5, 0.75)), 8.0, 7.0, film=0.3, pieces=(1, math.inf)),
    "deformation": Flow(3, deformation, _BALL, 3.0, 4.0),
    "halves": Flow(3, deformation, _BALL, 3.0, 0.3, pieces=(2, 2), half=True),
    "zalesak": Flow(3, rotation, slotted, 2.0, 4.0, step=0.3),
    "meeting": Flow(
        3, strain(-1.0), balls(0.11, (0.34, 0.5, 0.5), (0.66, 0.5, 0.5)), 0.8, 0.1, returns=False, film=0.3
    ),
    "thread": Flow(
        3, strain(1.0), balls(0.14, (0.5, 0.5, 0.5)), 0.8, 3.0, returns=False, film=0.3, pieces=(2, math.inf)
    ),
}


def start(flow: Flow, spacing: float) -> tuple[Mesh, NDArray[np.bool_]]:
    """The mesh at the start, with particles on the body's surface, and the mask of those on walls."""
    rng, d, n = np.random.default_rng(1), flow.dimension, round(1 / spacing)
    x = np.stack(np.meshgrid(*d * [np.linspace(0.0, 1.0, n + 1)], indexing="ij"), axis=-1).reshape(-1, d)
    wall = ((x < spacing / 2) | (x > 1 - spacing / 2)).any(axis=1)
    x += ~wall[:, None] * rng.uniform(-JITTER * spacing, JITTER * spacing, x.shape)
    for _ in range(3):  # the distance of a body with edges is not linear near them
        off, step = flow.distance(x), 1e-6
        normal = np.stack([flow.distance(x + step * e) - off for e in np.eye(d)], axis=1) / step
        near = np.abs(off) < SNAP * spacing
        x[near] -= off[near, None] * normal[near]
    cells = Delaunay(x, qhull_options="Qbb Qc Q12").simplices.astype(np.int32)
    measure = simplex_measure(x, cells)
    cells[measure < 0, :2] = cells[measure < 0, 1::-1]
    cells = cells[np.abs(measure) > FLAT * spacing**d]
    middle = x[cells].mean(axis=1)
    inside = (flow.distance(x) < 1e-6)[cells].all(axis=1) & (flow.distance(middle) < 0)
    fluid = inside.astype(np.int32)
    if flow.half:
        fluid[inside & (middle[:, 0] > 0.35)] = 2
    return Mesh(x, cells, fluid), wall
