"""Remeshing with interfaces along edges: the triangulation moves with the particles and is repaired in place.

Every triangle belongs to one fluid for good; flips, collapses and splits of edges hand that on. So a
remeshing moves no volume from one fluid to another but where an interface is made coarser, slides
along a wall, or a film breaks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tipfem import interface_kernels, remeshing_kernels
from tipfem.conservation import bodies, inherit, move_interfaces, share_out
from tipfem.fitting import FittedRule
from tipfem.mesh import Mesh, simplex_measure
from tipfem.particles import Array, Particles
from tipfem.probes import nodal_mass
from tipfem.surgery import STAR
from tipfem.triangulation import TriangulationError


@dataclass
class Triangulation:
    """A triangulation that can be changed in place; the arrays are those of `surgery`."""

    state: Array
    cells: Array
    across: Array
    fluid: Array
    corner: Array
    wall: Array
    density: Array

    @classmethod
    def of(cls, particles: Particles, mesh: Mesh, density: Array) -> Triangulation:
        """A copy of ``mesh``, which must know its fluids of ``density`` (F,), moved to where ``particles`` are."""
        assert mesh.fluid is not None
        # The mass of the step's solution: volumes change in a step by round-off and errors of volume only.
        mass = nodal_mass(mesh, density[mesh.fluid])
        state = np.column_stack(
            [particles.position, particles.velocity, particles.acceleration, particles.pressure, mass]
        )
        corner = np.full(len(state), -1, dtype=np.int32)
        corner[mesh.cells.ravel()] = np.arange(mesh.cells.size, dtype=np.int32) // 3
        wall = particles.wall.astype(np.int32)
        return cls(state, mesh.cells.copy(), mesh.across.copy(), mesh.fluid.copy(), corner, wall, density)

    def make_delaunay(self, slack: float) -> int:
        """Flip what is not Delaunay; how many flips it took.

        Raises:
            TriangulationError: the flips did not come to an end.
        """
        count = np.zeros(3, dtype=np.int32)
        stack = np.empty(max(8 * len(self.cells), 64), dtype=np.int32)
        while True:
            count[2] = 0
            remeshing_kernels.make_delaunay(
                self.state, self.cells, self.across, self.fluid, self.corner, self.wall, self.density, stack,
                np.empty(len(self.cells), dtype=np.int32), np.empty(4, dtype=np.int32), count, len(self.cells), slack,
            )  # fmt: skip
            if count[1]:
                raise TriangulationError(f"flipping edges does not come to an end ({count[0]} flips)")
            if not count[2]:
                return int(count[0])

    def marks(self) -> Array:
        """(N,) 1 for particles on an interface, 2 for those on the hull, 3 for both, 0 for others."""
        mark = np.zeros(len(self.state), dtype=np.int32)
        interface_kernels.mark_particles(self.cells, self.across, self.fluid, mark, len(self.cells))
        return mark

    def compact(self) -> None:
        """Drop the cells that are gone."""
        alive = self.fluid >= 0
        if alive.all():
            return
        number = np.cumsum(alive, dtype=np.int32) - 1
        self.cells, self.fluid = self.cells[alive], self.fluid[alive]
        across = self.across[alive]
        self.across = np.where(across >= 0, number[across], -1).astype(np.int32)
        self.corner = np.where(self.corner >= 0, number[self.corner], -1).astype(np.int32)

    def longest_edges(self, long: float) -> tuple[Array, int]:
        """Edges as 3 * cell + opposite corner, longest first, but those of interfaces and walls longer than ``long``
        [m] before all others; and how many are longer, of those inside a fluid than 1.4 times that."""
        x, cells, across = self.state[:, :2], self.cells, self.across
        number = np.arange(len(cells))[:, None]
        length = np.linalg.norm(x[cells[:, [1, 2, 0]]] - x[cells[:, [2, 0, 1]]], axis=2)
        border = (across < 0) | (self.fluid[across] != self.fluid[:, None])
        first = border & (length > long)
        length[first] += 1e3 * long
        once = (self.fluid[:, None] >= 0) & ((across < 0) | (across > number))
        edges = np.flatnonzero(once.ravel())
        length = length.ravel()[edges]
        order = np.argsort(-length, kind="stable")
        return edges[order].astype(np.int32), int((length > 1.4 * long).sum())


def repair(
    particles: Particles, mesh: Mesh, density: Array, fixed: Array, rule: FittedRule,
    *, slippery: Array | None = None, total: Array | None = None,
) -> tuple[Particles, Mesh, Array]:
    """Remesh particles that have moved.

    Args:
        particles: the moved state on N particles; which are walls may change, see Returns.
        mesh: the triangles they moved with, none inverted.
        density: (F,) of the fluids [kg/m^3].
        fixed: (N,) particles that must keep their place, as the corners of the tank.
        rule: when to change what.
        slippery: (N,) wall particles that slide with the fluid; where interfaces meet walls there, they do so, too.
        total: (F,) volume that each fluid is to have afterwards [m^2]; by default the solve's changes of volume
            stay, and only those of the remeshing are undone.

    Returns:
        The state, where some particles have a new place (N stays the same); the mesh; and (N,) a mask of
        those particles.

    Raises:
        TriangulationError: the repair did not come to an end, or left a triangle without area.
    """
    h = particles.spacing
    t = Triangulation.of(particles, mesh, density)
    if (simplex_measure(particles.position, mesh.cells) <= 0).any():
        raise TriangulationError("a triangle was inverted before it could be repaired")
    held = fixed.astype(np.int32)
    star = np.empty(4 * (STAR + 1), dtype=np.int32)
    least = 0.02 * h * h
    flips = t.make_delaunay(rule.slack)
    mark = t.marks()
    count = np.zeros(2, dtype=np.int32)
    flag = np.empty(max(len(t.cells), len(t.state)), dtype=np.int32)
    interface_kernels.slide_contacts(
        t.state, t.cells, t.across, t.fluid, t.corner, held if slippery is None else held | slippery, t.wall, density,
        mark, particles.position - mesh.position, star, len(t.state),
        rule.reach * h, 0.35 * h, least,
    )  # fmt: skip
    interface_kernels.break_films(
        t.state, t.cells, t.across, t.fluid, mark, density, flag, count, len(t.cells), rule.film * h,
    )  # fmt: skip
    broken = int(count[0])
    freed = np.empty(len(t.state), dtype=np.int32)
    gone = _coarsen(t, held, star, flag, freed, 0, rule.close * h, rule, h, len(freed))
    changed = np.zeros(len(t.state), dtype=bool)
    placed = 0
    for attempt in range(6):
        edges, needed = t.longest_edges(rule.long * h)
        if needed > gone - placed and attempt == 0:
            # Nothing that crowds is left to take: take from where particles stand closest.
            gone = _coarsen(t, held, star, flag, freed, gone, rule.spare * h, rule, h, needed + placed)
            edges, needed = t.longest_edges(rule.long * h)
        if placed == gone:
            break
        placed = _refine(t, edges, freed, placed, gone, (0.6, 0.5, 0.4, 0.3, 0.2, 0.1)[attempt] * h)
        flips += t.make_delaunay(rule.slack)
    if placed < gone:
        raise TriangulationError(f"{gone - placed} particles that crowded others find no room elsewhere")
    changed[freed[:gone]] = True
    t.compact()
    t.state[:, :2] = restored(t, particles, mesh, changed, total, 0.05 * h)
    if not (flips or gone or broken or (t.state[:, :2] != particles.position).any()):
        return particles, mesh.moved(particles.position), changed
    position = np.ascontiguousarray(t.state[:, :2])
    if (simplex_measure(position, t.cells) <= 0).any():
        cell = int(np.argmin(simplex_measure(position, t.cells)))
        raise TriangulationError(f"the triangle at {position[t.cells[cell, 0]].tolist()} has no area after the repair")
    state = particles.copy(
        position=position, velocity=t.state[:, 2:4], acceleration=t.state[:, 4:6], pressure=t.state[:, 6],
        wall=t.wall.astype(bool),
    )  # fmt: skip
    repaired = Mesh(position, t.cells, t.fluid)
    repaired.__dict__["across"] = t.across
    return state, repaired, changed


def restored(
    t: Triangulation, particles: Particles, mesh: Mesh, relocated: Array, total: Array | None, limit: float
) -> Array:
    """Positions (N, 2) at which the volumes are right, see `conservation`.

    Args:
        t: the new triangulation.
        particles: the state before it was made.
        mesh: the mesh of the step, at its start.
        relocated: (N,) mask of the particles that were set elsewhere.
        total: as in `repair`.
        limit: of a particle's shift [m].
    """
    assert mesh.fluid is not None
    before, after = bodies(mesh.across, mesh.fluid), bodies(t.across, t.fluid)
    moved = np.bincount(before, weights=simplex_measure(particles.position, mesh.cells))
    loss = np.zeros_like(moved)
    if total is None:
        fluid_before = np.zeros(len(moved), dtype=np.int32)
        fluid_before[before] = mesh.fluid
        total = np.bincount(fluid_before, weights=moved)
    else:
        loss = np.bincount(before, weights=mesh.measure) - moved
    loss = inherit((mesh.cells, mesh.fluid, before), (t.cells, t.fluid, after), loss, relocated)
    position = np.ascontiguousarray(t.state[:, :2])
    volume = np.bincount(after, weights=simplex_measure(position, t.cells))
    fluid = np.zeros(len(volume), dtype=np.int32)
    fluid[after] = t.fluid
    movable = t.marks() == 1
    free = np.bincount(after, weights=movable[t.cells].any(axis=1)) > 0
    wanted = share_out(volume, loss, fluid, np.pad(total, (0, max(0, fluid.max() + 1 - len(total)))), free)
    return move_interfaces(position, t.cells, after, movable, wanted, limit)


def _coarsen(
    t: Triangulation, held: Array, star: Array, flag: Array, freed: Array, gone: int, close: float,
    rule: FittedRule, h: float, most: int,
) -> int:  # fmt: skip
    count = np.array([gone, 0], dtype=np.int32)
    remeshing_kernels.coarsen(
        t.state, t.cells, t.across, t.fluid, t.corner, held, t.wall, t.density, star, flag, freed, count,
        len(t.cells), len(t.state), close, rule.chain * h, rule.edge * h, rule.film * h,
        0.02 * h * h, most,
    )  # fmt: skip
    return int(count[0])


def _refine(
    t: Triangulation, edges: Array, freed: Array, placed: int, gone: int, room: float
) -> int:
    """Put the particles freed[placed:gone] on the longest edges; how many are placed now."""
    free = np.flatnonzero(t.fluid < 0).astype(np.int32)
    short = 2 * (gone - placed) + 1 - len(free)
    if short > 0:  # hull edges have one cell, others two: collapses may have left too few
        first = len(t.cells)
        t.cells = np.concatenate([t.cells, np.zeros((short, 3), dtype=np.int32)])
        t.across = np.concatenate([t.across, np.full((short, 3), -1, dtype=np.int32)])
        t.fluid = np.concatenate([t.fluid, np.full(short, -1, dtype=np.int32)])
        free = np.concatenate([free, np.arange(first, first + short, dtype=np.int32)])
    count = np.array([placed, 0], dtype=np.int32)
    candidates = edges[: 8 * (gone - placed) + 32]
    remeshing_kernels.refine(
        t.state, t.cells, t.across, t.fluid, t.corner, t.wall, t.density,
        np.zeros(len(t.cells), dtype=np.int32), candidates, len(candidates), free, freed, count, room, gone,
    )  # fmt: skip
    return int(count[0])
