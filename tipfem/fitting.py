"""What a triangulation with interfaces along edges starts from, and the rule by which it is changed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tipfem.mesh import Mesh
from tipfem.particles import Array, Particles
from tipfem.validation import is_number


@dataclass(frozen=True)
class FittedRule:
    """When the triangulation is changed; all lengths in particle spacings.

    Attributes:
        close: particles inside a fluid closer than this to another crowd it, and one goes.
        edge: the same for the distance to an edge of an interface or a wall.
        chain: the same along interfaces and walls.
        long: edges of interfaces and walls longer than this are split before any others.
        spare: particles inside a fluid closer than this to another are taken where such edges are too many
            for the particles that crowd others.
        film: a film thinner than this breaks.
        reach: how far an interface's end on a wall may be from the foot of the next particle on it.
        slack: how far a particle may be inside a circumcircle before an edge is flipped; relative, see
            `surgery.in_circle`. Not zero: a flip that gains nothing disturbs fluids at rest.

    Raises:
        ValueError: a number is out of range or none.
    """

    close: float = 0.6
    edge: float = 0.4
    chain: float = 0.55
    long: float = 1.5
    spare: float = 0.75
    film: float = 0.3
    reach: float = 0.8
    slack: float = 1e-3

    def __post_init__(self) -> None:
        for name, low, high in (
            ("close", 0.1, 0.95),
            ("edge", 0.05, 0.8),
            ("chain", 0.1, 0.95),
            ("long", 1.2, 5.0),
            ("spare", 0.1, 0.95),
            ("film", 0.0, 0.8),
            ("reach", 0.0, 3.0),
            ("slack", 0.0, 0.2),
        ):
            value = getattr(self, name)
            if not (is_number(value) and low <= value <= high):
                raise ValueError(f"FittedRule: {name} is {value!r}; it must lie between {low:g} and {high:g}")


def with_fluids(mesh: Mesh, particles: Particles, density: Array) -> Mesh:
    """Give each triangle of a first mesh its fluid: the lightest of its particles' fluids.

    So interfaces run along edges through the outermost particles of the heavier fluid.

    Args:
        mesh: Delaunay triangles.
        particles: their particles, walls with a fluid too.
        density: (F,) of the fluids [kg/m^3].
    """
    lightest_first = np.argsort(density, kind="stable")
    rank = np.empty(len(density), dtype=np.int32)
    rank[lightest_first] = np.arange(len(density))
    fluid = lightest_first[rank[particles.fluid[mesh.cells]].min(axis=1)].astype(np.int32)
    return Mesh(mesh.position, mesh.cells, fluid)


def particle_fluid(mesh: Mesh, count: int, density: Array) -> Array:
    """(N,) the heaviest fluid at each of ``count`` particles."""
    fluid, at = np.zeros(count, dtype=np.int32), mesh.__dict__.get("bodies_at")
    for f in np.argsort(density, kind="stable"):
        if at is not None:  # see `conservation`
            if f < len(at):
                fluid[at[f] >= 0] = f
            continue
        fluid[mesh.cells[mesh.fluid == f].ravel()] = f
    return fluid


def hull_corners(mesh: Mesh) -> Array:
    """(N,) mask of the particles at which the hull turns."""
    cell, i = np.nonzero(mesh.across < 0)
    a, b = mesh.cells[cell, (i + 1) % 3], mesh.cells[cell, (i + 2) % 3]
    direction = mesh.position[b] - mesh.position[a]
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    total = np.zeros_like(mesh.position)
    np.add.at(total, a, direction)
    np.add.at(total, b, direction)
    on = np.zeros(len(mesh.position), dtype=bool)
    on[a] = True
    return on & (np.linalg.norm(total, axis=1) < 2 - 1e-9)
