"""A disc in a vortex that turns back: it is drawn out to a thread, and ends where it began (Rider & Kothe 1998)."""

import numpy as np
import pytest
from triangulations import delaunay

from tipfem.case.numerics import FittedRule
from tipfem.case.particles import Particles
from tipfem.mesh.mesh import Mesh
from tipfem.remesh.triangles.fitted import repair
from tipfem.remesh.volumes import with_components

CENTRE, RADIUS, PERIOD = np.array([0.5, 0.75]), 0.15, 8.0
MOST = 0.5  # spacings that a particle moves in a step


def velocity(x: np.ndarray, t: float) -> np.ndarray:
    """Of the flow at positions (N, 2), 1 at most."""
    sine, double = np.sin(np.pi * x) ** 2, np.sin(2 * np.pi * x)
    return np.cos(np.pi * t / PERIOD) * np.stack([-sine[:, 0] * double[:, 1], sine[:, 1] * double[:, 0]], axis=1)


def after(x: np.ndarray, t: float, dt: float) -> np.ndarray:
    """Where particles are after a step, by Runge and Kutta's fourth order."""
    k1 = velocity(x, t)
    k2 = velocity(x + dt / 2 * k1, t + dt / 2)
    k3 = velocity(x + dt / 2 * k2, t + dt / 2)
    return x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + velocity(x + dt * k3, t + dt))


def disc(n: int) -> tuple[Particles, Mesh]:
    """Jittered particles of a spacing of 1 / n in the unit square, and some around the disc, which is fluid 1."""
    rng, h = np.random.default_rng(1), 1 / n
    x = np.stack(np.meshgrid(*2 * [np.arange(n + 1) * h], indexing="ij"), axis=-1).reshape(-1, 2)
    wall = ((x < h / 2) | (x > 1 - h / 2)).any(axis=1)
    x += ~wall[:, None] * rng.uniform(-0.2 * h, 0.2 * h, x.shape)
    kept = np.abs(np.linalg.norm(x - CENTRE, axis=1) - RADIUS) > 0.55 * h
    angle = np.linspace(0, 2 * np.pi, round(2 * np.pi * RADIUS / h), endpoint=False)
    around = CENTRE + RADIUS * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    x, wall = np.concatenate([x[kept], around]), np.concatenate([wall[kept], np.zeros(len(around), dtype=bool)])
    cells = delaunay(x)
    inside = (np.linalg.norm(x - CENTRE, axis=1) < RADIUS * (1 + 1e-9))[cells].all(axis=1)
    particles = Particles(x, np.zeros(len(x), dtype=int), wall, spacing=h)
    return particles, with_components(Mesh(x, cells, inside.astype(np.int32)), 2)


def smallest_angle(mesh: Mesh) -> float:
    """Of all triangles [degrees]."""
    sides = [mesh.sides(mesh.cells[:, i], mesh.cells[:, (i + 1) % 3]) for i in range(3)]
    lengths = [np.linalg.norm(side, axis=1) for side in sides]
    sines = [2 * mesh.measure / (lengths[i] * lengths[i - 1]) for i in range(3)]
    return float(np.degrees(np.arcsin(np.minimum(np.stack(sines), 1.0).min())))


def shape_error(mesh: Mesh) -> float:
    """Mean distance of the interface from the circle."""
    cell, i = np.nonzero((mesh.neighbours >= 0) & (mesh.fluid[:, None] == 1) & (mesh.fluid[mesh.neighbours] == 0))
    a, b = (mesh.position[mesh.cells[cell, (i + k) % 3]] for k in (1, 2))
    along, length = (np.arange(4) + 0.5) / 4, np.linalg.norm(b - a, axis=1)
    place = a[:, None] + along[:, None] * (b - a)[:, None]
    off = np.abs(np.linalg.norm(place - CENTRE, axis=2) - RADIUS).mean(axis=1)
    return float(off @ length / length.sum())


def there_and_back(n: int) -> tuple[float, float, float]:
    """The smallest angle on the way, the relative error of the disc's area, and that of its shape at the end."""
    particles, mesh = disc(n)
    area = np.bincount(mesh.fluid, mesh.measure)
    t, angle = 0.0, 90.0
    while t < PERIOD - 1e-12:
        dt = min(MOST / n / max(abs(np.cos(np.pi * t / PERIOD)), 0.25), PERIOD - t)
        moved = particles.shallow_copy(position=after(particles.position, t, dt))
        particles, mesh, *_ = repair(
            moved, mesh, np.array([1.0, 1000.0]), particles.wall.astype(np.int32), FittedRule(), total=area
        )
        t += dt
        angle = min(angle, smallest_angle(mesh))
    return angle, float(np.abs(np.bincount(mesh.fluid, mesh.measure) / area - 1).max()), shape_error(mesh)


@pytest.mark.slow
def test_a_disc_comes_back_from_a_vortex_as_it_was():
    """No step is refused, areas stay, no triangle is a sliver, and the shape converges."""
    coarse, fine = there_and_back(25), there_and_back(50)
    assert max(coarse[1], fine[1]) < 1e-12
    assert min(coarse[0], fine[0]) > 2.0
    assert fine[2] < 4e-3
    assert fine[2] < 0.4 * coarse[2]
