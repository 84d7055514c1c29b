"""A long interface edge with particles of one fluid a hair beside it: the repair must take them into the interface.

So it was in glycerin that falls through water, particles 2.5 mm apart (`demos/layer_inversion.py --interface sharp`):
the triangles between got flatter, down to 1e-9 of the spacing squared, until no time step was short enough for them.
"""

from __future__ import annotations

import numpy as np
import pytest

import tipfem as tp
from tipfem.case.numerics import FittedRule
from tipfem.mesh.delaunay import triangulate
from tipfem.mesh.mesh import Mesh, simplex_measure
from tipfem.remesh.triangles.fitted import hull_corners, repair

NX, NY = 10, 9  # a lattice of spacing 1; the interface along its fifth row, the heavy fluid below


def at(i: int, j: int) -> int:
    """Number of a lattice point."""
    return i * NY + j


def beside(above: float):
    """Particles and mesh: an interface edge of three spacings, and two particles ``above`` it that belong on it."""
    x = np.array([(i, j) for i in range(NX) for j in range(NY)], dtype=float)
    wall = ((x == 0) | (x == (NX - 1, NY - 1))).any(axis=1)
    inner = ~wall & (x[:, 1] != 4)
    x[inner] += np.random.default_rng(0).uniform(-0.1, 0.1, (int(inner.sum()), 2))
    cells = triangulate(x, wall, 1.0).cells
    # What is below the chain 3-4-5-6 of the interface is meshed anew, with one edge from 3 to 6.
    a, b, c, d = at(3, 4), at(6, 4), at(4, 4), at(5, 4)
    below = [at(i, 3) for i in (3, 4, 5, 6)]
    inside = np.array([set(cell.tolist()) <= {a, b, c, d, *below} for cell in cells])
    water = [[a, b, d], [a, d, c]]
    glycerin = [[a, below[0], below[1]], [a, below[1], b], [below[1], below[2], b], [below[2], below[3], b]]
    middle = x[cells[~inside]].mean(axis=1)[:, 1]
    cells = np.concatenate([cells[~inside], np.array(water + glycerin, dtype=np.int32)]).astype(np.int32)
    fluid = np.concatenate([(middle > 4).astype(np.int32), [1] * 2, [0] * 4]).astype(np.int32)
    x[[c, d], 1] += above
    assert simplex_measure(x, cells).min() > 0
    assert simplex_measure(x, cells).sum() == pytest.approx((NX - 1) * (NY - 1))
    label = np.ones(len(x), dtype=np.int32)
    label[cells[fluid == 0]] = 0
    return tp.Particles(x, label, wall, spacing=1.0), Mesh(x, cells, fluid)


@pytest.mark.parametrize(
    "above",
    [0.3, 0.1, 0.01, 1e-3, 1e-6],
)
def test_particles_on_a_long_edge_are_taken_into_it(above):
    """After two repairs no triangle is lower than a tenth of a spacing, and the interface's edges are short."""
    particles, mesh = beside(above)
    density = np.array([1261.0, 998.2])
    for _ in range(2):
        particles, mesh = repair(particles, mesh, density, hull_corners(mesh), FittedRule())[:2]
    corner = particles.position[mesh.cells]
    length = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2)
    assert (2 * mesh.measure / length.max(axis=1)).min() > 0.1
    cell, i = np.nonzero(mesh.neighbours >= 0)
    between = mesh.fluid[cell] != mesh.fluid[mesh.neighbours[cell, i]]
    ends = [particles.position[mesh.cells[cell, (i + k) % 3]][between] for k in (1, 2)]
    assert np.linalg.norm(ends[1] - ends[0], axis=1).max() <= 2.0
