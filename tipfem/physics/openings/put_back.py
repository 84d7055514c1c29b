"""Putting back: after a step, the particles of openings are brought back onto their lines, before the mesh is repaired.

So the cells behind an inlet grow and those before an outlet shrink, by the volume that has passed, and the repair
splits and collapses edges. A particle of the fluid that comes close to an outlet becomes one of its particles, and the
cell between is left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tipfem.backend.launch import launch
from tipfem.case.case import Case
from tipfem.case.open_lines import OpenLine
from tipfem.case.particles import Particles
from tipfem.errors import SimulationError
from tipfem.fem.mass import lumped_part
from tipfem.mesh.mesh import Mesh, corners_among, simplex_measure
from tipfem.physics.openings import kernels
from tipfem.physics.openings.lines import OpeningLines, edge_fluids
from tipfem.physics.openings.passed import Passed
from tipfem.physics.physics import Moved
from tipfem.typing import Array

SNAP = 0.15  # height over an edge of an outlet below which a particle becomes one of its particles [targets]
BESIDE = 0.2  # from the ends of the edge, by its length: closer ones are moved to the particle there by the repair
OFF_LINE = 0.05  # where these are left [targets]
END = 1e-3  # distance of what drifts along an outlet from its ends [spacings]
FALLEN = 2.0  # depth below an outlet to which spray that has left by it may have come in a step [targets]
FILLED = 1.0  # area of a cell of empty space at an inlet up to which it is filled [spacings of the inlet squared]
THIN = 1.02  # thickness below which films leave, before the repair breaks them [by what it breaks]
WHOLE = 1.5  # thickness up to which a film leaves together with what is thin enough to break [by that]
INSIDE = -1e-9  # least barycentric coordinate of a place in a cell


class PutBack(NamedTuple):
    """A step's particles and mesh with the openings closed again."""

    particles: Particles  # N, those of openings on their lines
    # the step's mesh at its start, without cells that have left, see `Moved`; its components are labelled only if no
    # cell has left or has another fluid
    mesh: Mesh
    passed: Passed  # through the openings
    left: Array  # mask of the step's cells that have left


class Gate:
    """Puts back the particles of openings."""

    def __init__(self, openings: OpeningLines, case: Case) -> None:
        self.openings = openings
        self._fluids, self._gravity, self._mass = len(case.fluids), case.potential_gravity, case.numerics.mass
        self._period = case.period
        self._film = THIN * case.numerics.fitting.thin_film
        # Pressures are asked for by pumps that have a head.
        self._heads = any(getattr(line.opening, "head", None) is not None for line in openings.lines)

    def flooded(
        self,
        mesh: Mesh,
        nodes: list[Array],
        position: Array,
        time: float,
        speeds: Sequence[Array | None],
        among: Array | None = None,
    ) -> tuple[Array, Array]:
        """Fluids (M,) of cells, with those that enter at the particles of inlets; and of what enters into each cell.

        The cells at the inner particles are of the entering fluid. Else another one that touches an inlet would grow;
        and a gas beside a reservoir would be driven in by the pressure of its liquid. Where an inlet draws off, or does
        nothing, they stay what they are. ``speeds`` (K,) are into the tank [m/s], or a multiple, None for an opening
        that fills no cells; ``among`` numbers all cells at openings, by default all. `SimulationError` if an inlet is
        dry, and the empty cells there are too large to be filled.
        """
        assert mesh.fluid is not None
        fluid, source = np.array(mesh.fluid), np.array(mesh.fluid)
        near = among
        if near is None:
            near = _touching(mesh, [on for on, speed in zip(nodes, speeds, strict=True) if speed is not None])
        cells = mesh.cells[near]
        for line, on, speed in zip(self.openings.lines, nodes, speeds, strict=True):
            if speed is not None:
                mask = np.zeros(len(position), dtype=bool)
                mask[on] = True
                at = near[corners_among(mask, cells) > 0]
                source[at], mixed = self._entering(line, on, mesh.cells[at], position, time, speed)
                kept = (fluid[at] == mixed).any(axis=0) | (source[at] < 0)
                source[at[kept]] = fluid[at[kept]]
                mask[on[[0, -1]]] = False
                inner = at[corners_among(mask, mesh.cells[at]) > 0]
                empty = fluid[inner] >= self._fluids
                if empty.any():
                    area = simplex_measure(position, mesh.cells[inner], mesh.period.planar)
                    inner = inner[~empty | (area < FILLED * (line.length / (len(on) - 1)) ** 2)]
                    if line.opening.velocities and not len(inner):
                        text = "nothing can enter; fill a strip two spacings wide in front of it"
                        raise SimulationError(f"at t = {time:.6g} s {line.opening.name} is dry: {text}")
                fluid[inner] = source[inner]
        return fluid, source

    def _entering(
        self, line: OpenLine, on: Array, cells: Array, position: Array, time: float, speed: Array
    ) -> tuple[Array, Array]:
        """Fluids (C,) that enter into cells (C, 3) at an inlet; and (2, C) the two that a cell between them may have.

        Fluids enter by edges of the line. A cell that has but one corner on it, between edges of two fluids, is on one
        side of the interface that begins there: it stays what it is, also where nothing enters by one of the edges.
        """
        middle = 0.5 * (position[on[1:]] + position[on[:-1]])
        here = self.openings.fluids_in(line, middle, time, 0.5 * (speed[1:] + speed[:-1]))
        place = np.full(len(position), -1)
        place[on] = np.arange(len(on))
        number = place[cells]
        first, last = np.where(number < 0, len(on), number).min(axis=1), number.max(axis=1)
        below, above = here[np.maximum(first - 1, 0)], here[np.minimum(first, len(here) - 1)]
        alone = first == last
        return np.where(alone & (above >= 0), below, above), np.where(alone & (below != above), [below, above], -1)

    def put_back(self, end: Moved, nodes: list[Array], passed: Passed) -> PutBack:
        """Put back the particles of openings at the ``end`` of a step."""
        before, mesh, moved, time = end.start, end.mesh, end.particles, end.time
        x, wall, goal, lines = moved.position, moved.wall.copy(), moved.position.copy(), self.openings.lines
        touches, gone = np.full(len(x), -1), np.zeros(len(mesh.cells), dtype=bool)
        # What changes is in the cells at openings, and beside these.
        near = _near(mesh, nodes)
        cells = mesh.cells[near]
        for k, (line, on) in enumerate(zip(lines, nodes, strict=True)):
            touches[on], goal[on] = k, before.position[on]
            if not line.opening.velocities and not passed.closed[k]:
                least = END * before.spacing
                s = np.clip(line.coordinates(x[on[1:-1]]), least, line.length - least)
                goal[on[1:-1]] = line.a + s[:, None] * line.along
                self._taken_in(k, on, mesh, near, cells, moved, goal, wall, touches, gone)
        changed = np.flatnonzero(touches >= 0)
        changed = changed[(goal[changed] != x[changed]).any(axis=1)]
        mask = np.zeros(len(x), dtype=bool)
        mask[changed] = True
        beside, gain = near[corners_among(mask, cells) > 0], np.zeros(len(mesh.cells))
        done = _interpolated(moved, goal, changed, mesh, beside, wall)
        after, area = (simplex_measure(place, mesh.cells[beside], self._period) for place in (x, goal))
        gain[beside] = np.where(gone[beside], 0.0, area) - after
        # The measure of all cells by that within the hull.
        one, other = mesh.hull[2:]
        faces = np.stack([np.zeros_like(one), one, other], axis=1)
        surplus = float(simplex_measure(x, faces, self._period).sum()) - mesh.measure.sum() - end.kept
        speeds: list[Array | None] = [
            (x[on] - before.position[on]) @ line.inwards if line.opening.velocities else None
            for line, on in zip(lines, nodes, strict=True)
        ]
        if any(getattr(line.opening, "level", None) is not None for line in lines):
            setting = self.openings.setting(passed, time)
            for k, (line, on) in enumerate(zip(lines, nodes, strict=True)):
                if setting.reservoir(k):
                    speeds[k] = moved.velocity[on] @ line.inwards
        was = np.asarray(mesh.fluid)
        fluid, source = self.flooded(mesh, nodes, goal, time, speeds, near)
        left = near[gone[near]]
        fluid[left] = source[left] = was[left]
        followed = self._followed(nodes, passed.closed, mesh, near, fluid, (before.position, x, goal), moved.target)
        source[followed] = fluid[followed]
        at = beside[gain[beside] != 0]
        of = touches[mesh.cells[at]].max(axis=1)
        for k, (line, on) in enumerate(zip(lines, nodes, strict=True)):
            mine = at[of == k]
            several = line.opening.velocities and len(np.unique(source[mine])) > 1
            if several or any(line.beside):
                # This cuts the surface at the foot of a jet, or an interface that begins at an inlet: the cells of each
                # fluid get what has passed of it, and remeshing restores it.
                moves = (x[on] - before.position[on]) @ line.inwards
                swept = self.openings.swept(line, before.position[on], moves, edge_fluids(mesh, on), time)
                _add_up(gain, mine, source[mine], swept, whole=not any(line.beside))
        volume = self._balanced(of, source[at], gain[at], surplus, passed.closed)
        # What a reservoir has flooded is full of its fluid, which has come in for what stood there; and the last film
        # of a fluid has left, for what comes after it.
        other = near[fluid[near] != was[near]]
        at = touches[mesh.cells[other]].max(axis=1)
        own = np.array([not line.opening.velocities for line in lines])[at] | np.isin(other, followed)
        for sign, of in ((1, fluid), (-1, was)):
            np.add.at(volume, (at[own], of[other[own]]), sign * mesh.measure[other[own]])
        measure = mesh.measure + gain
        if len(left) or len(other):
            new = mesh.relabelled(fluid).only(~gone).with_(measure=measure[~gone])
        else:
            new = mesh.with_(measure=measure)
        # Only cells that have changed have other totals, but for the mass matrix that depends on their neighbours.
        every = self._mass == "interfaces"
        differs = np.arange(len(gone)) if every else beside
        if len(left) or len(other):
            differs = np.union1d(differs, np.concatenate([other, left]))
        kept = differs[~gone[differs]]
        total = self._totals(done, mesh.cells, kept, fluid, measure)
        total -= self._totals(moved, mesh.cells, differs, was, mesh.measure)
        energy, momentum = float(total[0]), total[1:]
        if mesh.flying.any():
            new, lost = self._without_spray(end, new, passed.closed)
            volume, energy, momentum = volume - lost[0], energy - lost[1], momentum - lost[2]
        pressure = passed.pressure
        if self._heads:
            of = zip(lines, nodes, strict=True)
            pressure = np.array([line.mean(done.position[on], done.pressure[on]) for line, on in of])
        passed = passed.and_then(volume, energy, momentum, pressure, end.dt)
        return PutBack(done, new, passed, gone)

    def _followed(
        self,
        nodes: list[Array],
        closed: Array,
        mesh: Mesh,
        near: Array,
        fluid: Array,
        places: tuple[Array, Array, Array],
        target: Array,
    ) -> Array:
        """Relabel cells of films that leave by an opening as the next fluid: sets ``fluid``; their numbers (C,).

        The repair breaks films that are as thin, and what is left of them would become the other fluid in the tank.
        ``near``: cells at openings; ``places``: of particles at the step's start and end, and where they are put back
        [m].
        """
        found, (before, after, goal), cells = [np.zeros(0, dtype=np.int64)], places, mesh.cells[near]
        for k, (line, on) in enumerate(zip(self.openings.lines, nodes, strict=True)):
            if closed[k] or getattr(line.opening, "level", None) is not None:
                continue
            there, height = np.zeros(len(goal), dtype=bool), (goal - line.a) @ line.inwards / target
            there[on] = True
            beside = near[corners_among(there, cells) > 0]
            corners = mesh.cells[beside]
            leaves = there & ((after - before) @ line.inwards < 0)
            free = leaves.copy()
            free[on[[0, -1]]] = True  # where the fluid may be at rest
            thick = np.where(there, 0.0, height)[corners].max(axis=1)
            thin = (thick < WHOLE * self._film) & (free | ~there)[corners].all(axis=1) & leaves[corners].any(axis=1)
            # A film goes as a whole: what the repair left of it would be spread over the tank.
            for f in np.unique(fluid[beside[thin & (thick < self._film)]]):
                follows = np.full(len(goal), -1)
                others = near[(fluid[near] != f) & (fluid[near] < self._fluids)]
                np.maximum.at(follows, mesh.cells[others].ravel(), np.repeat(fluid[others], 3))
                # The interface with what follows is off the line; where it meets the line it bounds what stands beside.
                off, between = ~there[corners], follows[corners] >= 0
                mine = thin & (fluid[beside] == f) & (between | ~off).all(axis=1)
                film = mine & ~(between & ~off).any(axis=1)
                if (film & (thick < self._film)).any():
                    whole = np.zeros(len(goal), dtype=bool)
                    whole[corners[film]] = True
                    mine &= (whole[corners] | ~off).all(axis=1)
                    fluid[beside[mine]] = np.where(off, follows[corners], -1).max(axis=1)[mine]
                    found.append(beside[mine])
        return np.concatenate(found)

    def _without_spray(self, end: Moved, mesh: Mesh, closed: Array) -> tuple[Mesh, tuple[Array, float, Array]]:
        """A mesh without the fluid of loose particles that have come to an open outlet, and what these have taken away.

        That is volumes (K, F) through the openings, energy and momentum (2,).
        """
        particles, own, lines = end.particles, mesh.flying.copy(), self.openings.lines
        i = np.flatnonzero(own > 0)
        x, near, volume = particles.position[i], particles.target[i], np.zeros((len(lines), self._fluids))
        mass, left = self.openings.density[particles.fluid[i]] * own[i], np.zeros(len(i), dtype=bool)
        for k, line in enumerate(lines):
            if line.opening.velocities or closed[k]:
                continue
            s, height = line.coordinates(x), (x - line.a) @ line.inwards
            out = (s > 0) & (s < line.length) & (height < SNAP * near) & (height > -FALLEN * near) & ~left
            np.add.at(volume[k], particles.fluid[i[out]], own[i[out]])
            left |= out
        own[i[left]] = 0.0
        v, mass = particles.velocity[i[left]], mass[left]
        energy = float(mass @ (0.5 * (v**2).sum(axis=1) - x[left] @ self._gravity))
        return mesh.with_flying(own), (volume, energy, mass @ v)

    def _taken_in(
        self,
        k: int,
        on: Array,
        mesh: Mesh,
        near: Array,
        cells: Array,
        moved: Particles,
        goal: Array,
        wall: Array,
        touches: Array,
        gone: Array,
    ) -> None:
        """Assign particles that come close to an outlet to it: sets ``goal``, ``wall``, ``touches`` and ``gone``."""
        line, x, target = self.openings.lines[k], moved.position, moved.target
        mask = np.zeros(len(x), dtype=bool)
        mask[on] = True
        is_beside = np.zeros(len(x), dtype=bool)
        is_beside[cells[corners_among(mask, cells) > 0]] = True
        beside = np.flatnonzero(is_beside)
        # Those on walls that end at the opening stay on them.
        slid = beside[wall[beside] & ~mask[beside]]
        if ((x[slid] - line.a) @ line.inwards >= OFF_LINE * target[slid]).all():
            slid = slid[:0]
        for end in on[[0, -1]] if len(slid) else ():
            way = mesh.position[slid] - mesh.position[end]
            rise, least = way @ line.inwards, OFF_LINE * target[slid]
            past = (rise > least) & (np.linalg.norm(way, axis=1) < 2 * target[slid])
            past &= (x[slid] - line.a) @ line.inwards < least
            goal[slid[past]] = mesh.position[end] + way[past] * (least / np.where(past, rise, 1.0))[past, None]
            touches[slid[past]] = k
        beside = beside[~wall[beside]]
        height, s = (x[beside] - line.a) @ line.inwards, line.coordinates(x[beside])
        low = (height < SNAP * target[beside]) & (s > 0) & (s < line.length)
        if not low.any():
            return
        beside, height, s = beside[low], height[low], s[low]
        # By default they are left just off the line, where the repair moves them into the particle next to them.
        up = np.maximum(height, OFF_LINE * target[beside])
        goal[beside], touches[beside] = line.a + s[:, None] * line.along + up[:, None] * line.inwards, k
        lies_low = np.zeros(len(x), dtype=bool)
        lies_low[beside] = True
        cell, apex, one, other = mesh.hull
        face = np.flatnonzero(mask[one] & mask[other] & lies_low[apex])
        cell, apex, one, other = cell[face], apex[face], one[face], other[face]
        s, start, end = (line.coordinates(place) for place in (x[apex], goal[one], goal[other]))
        part = (s - start) / (end - start)
        over = np.flatnonzero((part > BESIDE) & (part < 1 - BESIDE))
        # Not those that would leave another cell without area: one of two at a particle of the opening, or one that is
        # over two edges. They stay just off the line.
        taken = np.zeros(len(x), dtype=bool)
        taken[apex[over]] = True
        around = np.setdiff1d(_touching(mesh, [apex[over]], near), cell[over])
        flat = mesh.cells[around]
        flat = flat[corners_among(mask | taken, flat) == 3]
        taken[np.where(taken[flat], flat, -1).max(axis=1)] = False
        over = over[taken[apex[over]]]
        apex = apex[over]
        goal[apex] = line.a + s[over, None] * line.along
        wall[apex], gone[cell[over]] = True, True

    def _balanced(self, of: Array, fluid: Array, gain: Array, surplus: float, closed: Array) -> Array:
        """Volumes (K, F) that have passed each opening, from the gains (C,) of cells at openings ``of``.

        The ``surplus``, by which the solve has changed the total volume, is what putting back takes away in addition.
        Where walls do not move it is what Newton's method has left; that of a piston was pushed out. It is counted at
        the outlets that are not ``closed``, so that what has passed is the change of the tank's volume.
        """
        count = len(self.openings.lines)
        volume = np.bincount(of * self._fluids + fluid, gain, count * self._fluids).reshape(count, self._fluids)
        outlets = np.array([not line.opening.velocities for line in self.openings.lines]) & ~closed
        if not outlets.any():
            return volume
        share = np.abs(volume) * outlets[:, None]
        if not share.any():
            share = np.outer(outlets, np.eye(self._fluids)[0])
        return np.asarray(volume + surplus * share / share.sum())

    def _totals(self, particles: Particles, cells: Array, among: Array, fluid: Array, measure: Array) -> Array:
        """Kinetic and potential energy, and momentum, (3,) of cells (C,) among those (M, 3), with fluids and areas."""
        fluid = fluid[among]
        mass, result = self.openings.density[fluid] * measure[among], np.zeros(3)
        fluids = np.eye(self._fluids)[fluid] if self._mass == "interfaces" else np.zeros((0, 0))
        lumping = lumped_part(self._mass, cells[among], fluids, len(particles))
        state = particles.position, particles.velocity, self._gravity, result
        launch(kernels.add_totals, cells, among.astype(np.int32), len(among), mass, lumping, self._period.array, *state)
        return result


def _add_up(gain: Array, cells: Array, fluid: Array, wanted: Array, *, whole: bool) -> None:
    """Scale the gains (M,) of some cells (C,) with fluids (C,) to the sums wanted of each fluid (F,) [m^2].

    What is wanted of a fluid that has no cell goes to the others. ``whole``: whether the sum of all gains stays.
    """
    amount = np.abs(gain[cells])
    has = np.bincount(fluid, amount, len(wanted))
    if not has.any():
        return
    share = np.where(has > 0, np.abs(wanted), 0.0)
    share = share / share.sum() if share.any() else has / has.sum()
    total = gain[cells].sum() if whole else wanted.sum()
    wanted = np.where(has > 0, wanted, 0.0)
    wanted = wanted + (total - wanted.sum()) * share
    cut = wanted - np.bincount(fluid, gain[cells], len(wanted))
    gain[cells] += cut[fluid] * amount / np.where(has > 0, has, 1.0)[fluid]


def _near(mesh: Mesh, particles: Sequence[Array]) -> Array:
    """Numbers of the cells that have a corner in common with the cells at particles (K,) of a list."""
    chosen, near = np.zeros((2, len(mesh.position)), dtype=np.int8)
    for on in particles:
        chosen[on] = 1
    found = np.empty(len(mesh.cells), dtype=np.int32)
    return found[: launch(kernels.list_near, mesh.cells, len(mesh.cells), chosen, near, found)]


def _touching(mesh: Mesh, particles: Sequence[Array], among: Array | None = None) -> Array:
    """Numbers of the cells that have particles (K,) of a list, of all cells or of those with numbers (C,)."""
    mask = np.zeros(len(mesh.position), dtype=bool)
    for on in particles:
        mask[on] = True
    found = np.flatnonzero(corners_among(mask, mesh.cells if among is None else mesh.cells[among]))
    return found if among is None else np.asarray(among[found])


def _interpolated(moved: Particles, goal: Array, changed: Array, mesh: Mesh, beside: Array, wall: Array) -> Particles:
    """The particles, those ``changed`` (K,) put at their goals (N, 2) [m] with the state of the cells ``beside`` there.

    A place in none of a particle's cells has the velocity of the particle: nothing is known of the fluid that comes. A
    particle without cells, at a dry end of an opening, keeps its whole state.
    """
    velocity, acceleration, pressure = moved.velocity.copy(), moved.acceleration.copy(), moved.pressure.copy()
    if len(changed):
        row = np.full(len(moved), -1, dtype=np.int32)
        row[changed] = np.arange(len(changed), dtype=np.int32)
        least, weight = np.full(len(changed), -np.inf), np.full((len(changed), 3), [1.0, 0.0, 0.0])
        node = np.repeat(changed[:, None], 3, axis=1).astype(np.int32)
        places = moved.position, goal, least, node, weight
        launch(kernels.find_places, mesh.cells, beside, len(beside), row, *places)
        pressure[changed] = np.einsum("ka,ka->k", weight, moved.pressure[node])
        known = least > INSIDE
        for values, old in ((velocity, moved.velocity), (acceleration, moved.acceleration)):
            values[changed[known]] = np.einsum("ka,kai->ki", weight[known], old[node[known]])
    return moved.shallow_copy(position=goal, velocity=velocity, acceleration=acceleration, pressure=pressure, wall=wall)
