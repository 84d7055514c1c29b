"""Spray: particles that carry fluid through empty space, while a triangulation is repaired."""

from __future__ import annotations

import copy

import numpy as np

from tipfem.backend.launch import launch
from tipfem.case.particles import Particles
from tipfem.mesh.mesh import Surface, simplex_measure
from tipfem.remesh.carry_kernels import find_fallen
from tipfem.remesh.triangles.edge_operations import ACCELERATION, HELD, MASS, VELOCITY
from tipfem.remesh.triangles.triangulation import Triangulation
from tipfem.remesh.volumes import label_components
from tipfem.typing import Array


class Spray:
    """The particles in no cell of a fluid, and what the repair of a triangulation makes of them.

    A particle that a repair has left in no cell of a fluid carries what its last cells had, and flies freely. Where it
    meets a fluid, its volume and momentum go to the cell there, and it is inserted again where edges are long.

    Args:
        surface: of the step's mesh.
        fluids: F.
        full: whether the tank is, but for closed gaps: pieces of fluids stay, however small.

    Attributes:
        volume: (N,) that each carries [m^2].
        fluid: (N,) of the particles.
        landed: (F,) volume that has come back to the fluids, less what has left them [m^2].
        places: (P, 2) where it has [m].
    """

    SMALL = 0.9  # area of a component that becomes spray, in spacings squared
    LEAST = 0.02  # volume that a particle may carry, in spacings squared; less is given back to the fluid

    def __init__(self, particles: Particles, surface: Surface, fluids: int, *, full: bool = False) -> None:
        self.fluid, self.fluids = particles.fluid, fluids
        self.volume, self.loose = surface.volume.copy(), surface.loose.copy()
        self.landed, self.places = np.zeros(fluids), np.zeros((0, 2))
        self._spacing, self._small = particles.spacing, 0.0 if full else self.SMALL

    def settle(self, t: Triangulation, before: Array) -> int:
        """Move particles out of the fluids and back into them; returns the number of changes.

        Args:
            t: the triangulation, whose films have broken.
            before: (M,) fluids of its cells before that.
        """
        f, h2 = self.fluids, self._spacing**2
        place = np.ascontiguousarray(t.state[:, :2])
        found, _, size = label_components(place, t.cells, t.neighbours, t.fluid, f + 1, t.period)
        if t.period.axial:
            there = found.label >= 0
            size = np.bincount(found.label[there], np.abs(simplex_measure(place, t.cells[there])), len(size))
        small = (size < self._small * h2) & (found.fluid < f)
        here = np.flatnonzero((t.fluid >= 0) & (t.fluid < f))
        gone = here[small[found.label[here]]]
        if len(gone):
            t.relabel(gone, f)
        self._land(t)
        used = np.zeros(len(t.state), dtype=bool)
        used[t.cells[(t.fluid >= 0) & (t.fluid < f)]] = True
        lonely = ~used & (t.wall == 0) & (t.corner >= 0)
        torn = lonely & ~self.loose
        if torn.any():
            lost = np.flatnonzero((before >= 0) & (before < f) & (t.fluid == f))
            at = torn[t.cells[lost]]
            lost, at = lost[at.any(axis=1)], at[at.any(axis=1)]
            area = simplex_measure(place, t.cells[lost], t.period)
            share = np.where(at, (area / at.sum(axis=1))[:, None], 0.0)
            np.add.at(self.volume, t.cells[lost], share)
            self.fluid = self.fluid.copy()
            self.fluid[t.cells[lost][at]] = np.repeat(before[lost], at.sum(axis=1))
            self.volume[~torn & ~self.loose] = 0.0
            self.loose |= torn
            i = np.flatnonzero(torn)
            np.subtract.at(self.landed, self.fluid[i], self.volume[i])
            self.places = np.concatenate([self.places, place[i]])
        i = np.flatnonzero(lonely)
        if len(i):
            t.take_out(i)
        section = t.period.section(self.volume, place[: len(self.volume)], self._spacing)
        i = np.flatnonzero(self.loose & (t.corner < 0) & (section < self.LEAST * h2))
        self._remove(t, i)
        return len(gone) + int(lonely.sum()) + len(t.removed)

    def rejoin(self, t: Triangulation) -> None:
        """Return what particles carry that a repair has put into cells of a fluid again, or removed, after `settle`.

        One that could not be taken out of empty space stays in its cells, and a neighbour may be moved into it.
        """
        gone = np.zeros(len(t.state), dtype=bool)
        gone[t.cells[(t.fluid >= 0) & (t.fluid < self.fluids)]] = True
        gone[t.removed] = True
        self._give_back(np.flatnonzero(self.loose & gone[: len(self.loose)]))

    def renumbered(self, numbers: Array | None, count: int) -> Spray:
        """The same with new numbers (N,) of the particles, -1 for those gone; ``count`` there are then."""
        if numbers is None:
            return self
        new, kept = copy.copy(self), numbers >= 0
        for name in ("volume", "fluid", "loose"):
            values = getattr(self, name)
            setattr(new, name, np.zeros(count, dtype=values.dtype))
            getattr(new, name)[numbers[kept]] = values[kept]
        return new

    def _remove(self, t: Triangulation, i: Array) -> None:
        """Return what particles carry, and release them for insertion elsewhere."""
        if len(i):
            self._give_back(i)
            t.removed = np.concatenate([t.removed, i.astype(np.int32)])

    def _give_back(self, i: Array) -> None:
        """Add the volumes of particles to their fluids."""
        np.add.at(self.landed, self.fluid[i], self.volume[i])
        self.loose[i], self.volume[i] = False, 0.0

    def _land(self, t: Triangulation) -> None:
        """Add volume and momentum of particles that are in a cell of a fluid to its particles."""
        i = np.flatnonzero(self.loose & (t.corner < 0))
        if not len(i):
            return
        i, found = i[np.argsort(t.state[i, 0], kind="stable")].astype(np.int32), np.full(len(i), -1, dtype=np.int32)
        launch(find_fallen, t.state, t.cells, t.fluid, t.period.array, self.fluids, i, found)
        i, around = i[found >= 0], t.cells[found[found >= 0]]
        if not len(i):
            return
        weight = t.state[around, MASS] * (t.wall[around] != HELD)
        rates = slice(VELOCITY, ACCELERATION)
        total, own = weight.sum(axis=1)[:, None], (t.density[self.fluid[i]] * self.volume[i])[:, None]
        mean = np.einsum("pk,pki->pi", weight, t.state[around, rates]) / np.maximum(total, 1e-300)
        change = own / np.maximum(total + own, 1e-300) * (t.state[i, rates] - mean)
        row, k = np.nonzero(weight)
        np.add.at(t.state[:, rates], around[row, k], change[row])
        self.places = np.concatenate([self.places, t.state[i, :VELOCITY]])
        self._remove(t, i)
