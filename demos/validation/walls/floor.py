"""The boundary layer on the floor of a dam break, solved for by itself: what the friction of the law "layer" is held
against.

Prandtl's equations (H. Schlichting & K. Gersten, Boundary-Layer Theory, 9th ed., 2017, chapters 6 and 13),

    u_t + u u_x + v u_y = U_t + U U_x + nu u_yy,   u_x + v_y = 0,   u = 0 on the floor, u = U far from it,

with the velocity U(x, t) of the water next to the floor, as a run has it. The layer begins with no thickness where the
front arrives, and at x = 0 the flow stagnates. Upwind in x and in y, diffusion implicit.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_banded

import tipfem as tp

Array = NDArray[np.float64]

# Resolution of the layer. With half of both spacings its friction is 1 % larger.
COLUMNS, ROWS = 292, 80
HEIGHT = 4e-3  # of the region that is solved for, 6 times the largest thickness [m]
STRETCH = 3.0  # the rows' heights grow by exp(STRETCH) from the floor up
COURANT = 0.5
WINDOW = 5  # faces over which the run's velocity is averaged; it is that of single particles


class Outer(NamedTuple):
    """The water along the floor at a time.

    Attributes:
        time: [s].
        x: (F,) middles of the mesh's faces there, ascending [m].
        speed: (F,) along the floor, of the particles next to it [m/s].
        front: where the water ends [m].
    """

    time: float
    x: Array
    speed: Array
    front: float


def outer(simulation: tp.Simulation) -> Outer:
    """The water along the floor, y = 0, at the present time."""
    mesh, v = simulation.mesh, simulation.particles.velocity
    cells = mesh.cells[np.asarray(mesh.fluid) == 0]
    below = mesh.position[cells][:, :, 1] < 1e-9
    cells, below = cells[below.sum(axis=1) == 2], below[below.sum(axis=1) == 2]
    ends = mesh.position[cells[below].reshape(-1, 2), 0]
    order = np.argsort(ends.mean(axis=1))
    return Outer(simulation.time, ends.mean(axis=1)[order], v[cells[~below], 0][order], float(ends.max()))


def friction(course: Sequence[Outer], length: float, viscosity: float, density: float) -> tuple[float, float]:
    """What the layer takes of the water's momentum [N s/m] and energy [J/m].

    Args:
        course: of the water along the floor.
        length: of the floor [m].
        viscosity: of the water [Pa s].
        density: [kg/m^3].
    """
    dx, nu = length / COLUMNS, viscosity / density
    x = (np.arange(COLUMNS) + 0.5) * dx
    y = HEIGHT * np.expm1(STRETCH * np.linspace(0, 1, ROWS + 1)) / np.expm1(STRETCH)
    dy = np.diff(y)
    speed, wet = _along(course[0], x), x < course[0].front
    u = np.tile(np.where(wet, speed, 0.0)[:, None], ROWS + 1)
    momentum = energy = 0.0
    for before, now in pairwise(course):
        later, new = _along(now, x), (x < now.front) & ~wet
        u[new], speed[new], wet = later[new, None], later[new], x < now.front
        later = np.where(wet, later, 0.0)
        count = max(1, int(np.ceil(np.abs(later).max() * (now.time - before.time) / (COURANT * dx))))
        dt, slope = (now.time - before.time) / count, (later - speed) / (now.time - before.time)
        for _ in range(count):
            speed = speed + dt * slope
            u = np.where(wet[:, None], _stepped(u, speed, slope, dt, dx, dy, nu), 0.0)
            traction = density * nu * u[:, 1] / dy[0]
            momentum += dt * dx * float(traction.sum())
            energy += dt * dx * float(traction @ speed)
    return momentum, energy


def _along(at: Outer, x: Array) -> Array:
    """The run's velocity at places x (C,) of the floor, smoothed [m/s]."""
    padded = np.pad(at.speed, WINDOW // 2, mode="edge")
    return np.interp(x, np.append(0.0, at.x), np.append(0.0, np.convolve(padded, np.full(WINDOW, 1 / WINDOW), "valid")))


def _stepped(u: Array, speed: Array, slope: Array, dt: float, dx: float, dy: Array, nu: float) -> Array:
    """u (C, R + 1) after a step, with the velocity ``speed`` (C,) outside and its rate ``slope``."""
    first = np.full((1, u.shape[1]), 2.0)  # the end of the floor, u = 0, is half a column away
    back = np.diff(u, axis=0, prepend=0.0 * u[:1]) / dx * np.concatenate([first, np.ones_like(u[1:])])
    ahead = np.diff(u, axis=0, append=u[-1:]) / dx
    v = np.zeros_like(u)
    v[:, 1:] = -np.cumsum(0.5 * (back[:, 1:] + back[:, :-1]) * dy, axis=1)
    along = np.diff(u, axis=1) / dy
    across = np.where(v[:, 1:-1] > 0, along[:, :-1], along[:, 1:])
    outside = slope + speed * np.diff(speed, prepend=0.0) / dx
    outside[0] = slope[0] + 2 * speed[0] ** 2 / dx
    new = u + dt * (outside[:, None] - u * np.where(u < 0, ahead, back))
    new[:, 1:-1] -= dt * v[:, 1:-1] * across
    new[:, 0], new[:, -1] = 0.0, speed
    share = nu * dt / (0.5 * (dy[:-1] + dy[1:]))
    low, high = share / dy[:-1], share / dy[1:]
    bands = np.zeros((3, u.shape[1]))
    bands[1] = 1.0
    bands[1, 1:-1] += low + high
    bands[2, :-2], bands[0, 2:] = -low, -high
    return np.asarray(solve_banded((1, 1), bands, new.T).T)
