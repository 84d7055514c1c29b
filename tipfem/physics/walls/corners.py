"""Convex corners of solids along which fluids slide round: their particles slide, too, and are put back after the step.

Held, a corner's particle would stop the flow that is fastest there. In the step it slides along the bisector of the
sides' directions; the volume beside the corner that this opens is taken from continuity, see
`tipfem.physics.walls.chords`. So nothing passes the corner in the mesh, and the fluid does.

A brink, where the fluid leaves the solid into empty space, is a corner with one side: its particle slides on as if this
side went on, or, where the surface beyond turns off by more than 37 degrees, along the bisector of both. Were it held,
the lowest spacing of the flow would stand still there, and the jet would leave too high.

Solids are what lies in the fluids, and the walls of a tank, which do not move in it.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from tipfem.case.boundary.boundary import Boundary
from tipfem.case.particles import Particles
from tipfem.geometry.plane.domain import Domain
from tipfem.geometry.plane.vectors import cross
from tipfem.mesh.mesh import Mesh
from tipfem.typing import Array

# Cosine of the angle between a brink's side and the surface beyond it: from STRAIGHT on the particle slides along the
# side, and down to BENT, where the jet bends within a spacing as over a sharp crest, along the bisector of both. Along
# the side, what is put back there would be no small part of the jet, and the depth before it would come out worse.
STRAIGHT, BENT = 0.8, -0.5
BEFORE = 0.05  # distance from the corner of a particle beside it that has slid over it [targets]
THIN = 0.5  # length of a plate's edge below which its two corners slide alike [targets]
TURNS = -1e-6  # angle by which the boundary turns at a corner of walls that points into the fluid, at most [rad]


class Corners(NamedTuple):
    """K corners whose particles slide."""

    particles: Array  # (K,) in the corners
    # before, after: (K,) the next ones along the solid, which is on the left; -1 where that side is dry
    before: Array
    after: Array
    along: Array  # (K, 2) unit vectors along which they slide
    bent: Array  # (K,) mask of brinks beyond which the surface turns off, towards the solid

    @property
    def turns(self) -> Array:
        """(K,) mask of those round which the fluid slides, which are no brinks."""
        return np.asarray((self.before >= 0) & (self.after >= 0))

    @property
    def pressed(self) -> Array:
        """(K,) mask of those that do not slide along their sides, on which these press."""
        return self.turns | self.bent

    @property
    def over(self) -> Array:
        """The particles over brinks, and those before them."""
        found = np.stack([self.particles, self.before, self.after])[:, ~self.turns]
        return np.asarray(found[found >= 0])


def corners_among(
    index: Array, on: Array, slips: Array, brinks: Array, mesh: Mesh, thin: Array, *, bends: bool = False
) -> Corners | None:
    """Corners that slide; None for none. Those at contacts with interfaces and surfaces, or beside them, do not.

    Both corners of a thin plate's edge slide along that. By bisectors they would turn the edge over in a stream that
    passes it by several times its length in a step. Particles ``index`` (K,) of solids do not slide along their sides,
    of the faces ``on`` (E,) of the hull. Along their solid fluids slide (``slips``) and may run into empty space
    (``brinks``), where the surface ``bends`` or not; edges shorter than ``thin`` (K,) are those of a thin plate [m].
    """
    cell, _, after_of, before_of = mesh.hull
    before, after, arrives, leaves = np.full((4, len(mesh.position)), -1)
    face = np.arange(len(cell))
    before[after_of], after[before_of], arrives[after_of], leaves[before_of] = before_of, after_of, face, face
    passes = np.bincount(before_of, minlength=len(before))[index]
    known = np.flatnonzero((before[index] >= 0) & (after[index] >= 0) & (passes == 1))
    i, slips, brinks = index[known], slips[known], brinks[known]
    thin = thin[known]
    beside = np.stack([before[i], after[i]])
    x = mesh.position
    one, other = (mesh.period.shortest(way) for way in (x[i] - x[beside[0]], x[beside[1]] - x[i]))
    length = np.stack([np.linalg.norm(way, axis=1) for way in (one, other)])
    one, other = one / length[0, :, None], other / length[1, :, None]
    wet = np.stack([on[arrives[i]], on[leaves[i]]])
    fluid = np.zeros(len(mesh.cells)) if mesh.fluid is None else np.asarray(mesh.fluid)
    inside = on[arrives] & on[leaves] & (fluid[cell[arrives]] == fluid[cell[leaves]])
    both = slips & inside[i] & inside[beside].all(axis=0)
    into, cosine = cross(one, other) > 0, (one * other).sum(axis=1)
    both &= into
    lone = brinks & (wet[0] != wet[1]) & ((cosine > STRAIGHT) | (into & bends & (cosine > BENT)))
    turns = np.zeros(len(before), dtype=bool)
    turns[i[both]] = True
    edge = turns[beside] & (length < thin)  # where the fluid goes over it as a whole
    along = one * ~(edge[1] & ~edge[0])[:, None] + other * ~(edge[0] & ~edge[1])[:, None]
    straight = ~both & (cosine > STRAIGHT)
    along = np.where(straight[:, None], np.where(wet[0][:, None], one, other), along)
    here = both | lone
    if not here.any():
        return None
    along, ends = along[here], np.where(wet, beside, -1)[:, here]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    return Corners(i[here], ends[0], ends[1], along, (lone & ~straight)[here])


def put_back(
    corners: Corners, place: Array, directions: Array, rates: Callable[[Array], tuple[Array, Array]], given: Particles
) -> Particles:
    """The particles at the end of a step, those of corners in these again, with the velocity that is there.

    That relative to the solid is linear between the corner's particle and the one that it has slid away from; which
    keeps off the corner. ``rates`` gives velocity and acceleration (K, 2) of the corners' solids at positions.
    """
    corner, back = corners.particles, given.copy()
    slid = ((given.position[corner] - place) * directions[corner]).sum(axis=1)
    beside = np.where(slid > 0, corners.before, corners.after)
    moves = (slid != 0) & (beside >= 0)
    beside = np.where(moves, beside, corner)
    slides = np.asarray(directions[beside].any(axis=1))
    ways = np.where(slides[:, None], directions[beside], directions[corner])
    towards = np.where(slid > 0, 1.0, -1.0)[:, None] * ways
    off = ((place - given.position[beside]) * towards).sum(axis=1)
    reach = np.maximum(off, 0.0)
    part = np.where(moves, reach / np.where(moves, reach + np.abs(slid), 1.0), 1.0)
    here, there, at_place = (rates(x) for x in (given.position[corner], given.position[beside], place))
    for name, *own in zip(("velocity", "acceleration"), here, there, at_place, strict=True):
        old, values = getattr(given, name), getattr(back, name)
        one = ((old[corner] - own[0]) * directions[corner]).sum(axis=1)
        other = ((old[beside] - own[1]) * ways).sum(axis=1)
        values[corner] = own[2] + (part * one + (1 - part) * other)[:, None] * directions[corner]
    back.position[corner] = place
    least = BEFORE * given.target[beside]
    near = np.flatnonzero(moves & slides & (off < least) & ~np.isin(beside, corner))
    back.position[beside[near]] = place[near] - least[near, None] * towards[near]
    return back


def corners_of_walls(boundary: Boundary, target: Array, mesh: Mesh, closed: Array | None) -> Corners | None:
    """The corners of fixed walls that slide, but for particles of closed gaps (N,); None for none."""
    tank, domain = boundary.tank, boundary.domain
    if not isinstance(tank, Domain) or not isinstance(domain, Domain) or (tank.turn >= TURNS).all():
        return None
    fixed = [wall.slips and wall.velocity is None and wall.motion is None for wall in boundary.walls]
    if not any(fixed):
        return None
    rows = np.flatnonzero(boundary.normal[:, 1].any(axis=1) & (boundary.on_side.sum(axis=1) == 2))
    one, other = boundary.side[rows].T
    arrives = np.where(domain.following[one] == other, one, other)
    into = (domain.following[arrives] == one + other - arrives) & (domain.turn[arrives] < TURNS)
    index, sides = boundary.index[rows[into]], boundary.side[rows[into]]
    stays = np.isin(index, boundary.entries)
    if closed is not None:
        stays |= closed[index]
    index, sides = index[~stays], sides[~stays]
    if not len(index):
        return None
    pairs, count = np.stack(mesh.hull[2:]), len(mesh.position)
    on, slippery = np.zeros(pairs.shape[1], dtype=bool), np.zeros(len(domain), dtype=bool)
    for number, side, member in boundary.members:
        if fixed[number]:
            slippery[side] = True
            is_on = np.zeros(count, dtype=bool)
            is_on[boundary.index[member]] = True
            on |= is_on[pairs].all(axis=0)
    for number, curve in enumerate(boundary.curves):
        if fixed[curve.wall]:
            slippery[curve.edges] = True
            is_on = np.zeros(count, dtype=bool)
            is_on[boundary.index[(boundary.on_curve == number) | boundary.on_side[:, curve.edges].any(axis=1)]] = True
            on |= is_on[pairs].all(axis=0)
    over = slippery[sides].all(axis=1) if boundary.room else np.zeros(len(index), dtype=bool)
    return corners_among(index, on, np.ones(len(index), dtype=bool), over, mesh, THIN * target[index], bends=True)


def loosened(boundary: Boundary, corners: Corners, rotation: Array) -> Boundary:
    """A boundary on which the particles of corners slide, with the rotation (2, 2) of the tank."""
    new, row = copy.copy(boundary), np.searchsorted(boundary.index, corners.particles)
    along, new.free = corners.along @ rotation, boundary.free.copy()
    new.free[row] = along[:, :, None] * along[:, None, :]
    new.slides = np.union1d(boundary.slides, row)
    return new
