"""Fluid in closed gaps: the pressures of the fluid at the mouths, which seeps in, and the law of what moves there.

p - rho g . x is linear along a gap between its mouths. A gap that is open to empty space at one end is empty. A closed
cell exerts p dA / dx on each of its particles, and a third of its weight, as a cell of the fluid would: what
stands in a fluid at rest is at rest to round-off.

What moves in a straight gap between two solids obeys, with the gap g along it, the flow Q and the speed u = Q / g,

    Q_s = -g_t ,    p_s = -rho (u_t + u u_s) - 12 mu Q / g^3 ,

and p is that of the mouth where fluid leaves, and rho u^2 / 2 less where it enters. For a gap that is g all along its
length L the force is -rho L^3 / 12 (g'' / g - c g'^2 / g^2) - mu L^3 g' / g^3, c = 1/2 where it opens, 2 where it
closes. The part by g'' is an added mass, that by g' a damper; in wedges each is found as if it were alone, without a
flow from mouth to mouth. They are implicit in the motion of the solids.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import solveh_banded

from tipfem.geometry.plane.touching import SKIN
from tipfem.geometry.plane.vectors import turned
from tipfem.linalg.parts import parts_of_cells
from tipfem.mesh.mesh import Mesh
from tipfem.physics.contact.gaps import WIDE, closed_cells
from tipfem.physics.contact.mouths import Mouths, by_pose, slopes_of_areas
from tipfem.typing import Array

MOUTH = 1.01  # as far from the end of a gap a fluid is there [spacings]
POINTS = 33  # along a gap
LEAST = 0.5  # gap below which a film is not thinner still [skins]


@dataclass(frozen=True)
class Film:
    """A gap with fluid at both mouths between two of B solids and the tank, in a step."""

    width: Array  # (P,) at points from mouth to mouth, at the step's start [m]
    along: float  # their distance [m]
    rows: Array  # (P, 3 B) derivatives of the width by the poses of the solids but the tank
    density: float  # [kg/m^3]
    viscosity: float  # [Pa s]
    least: float  # width below which it is not thinner still [m]

    def _solve(self, flow: Array, source: Array) -> Array:
        """Pressures (P, ...) that vanish at the mouths, with (flow p_s)_s = source / length; flow (P - 1,)."""
        c = flow / self.along
        band = np.stack([np.append(0.0, -c[1:-1]), c[:-1] + c[1:]])
        result = np.zeros_like(source)
        result[1:-1] = -solveh_banded(band, source[1:-1])
        return result

    def law(self, increment: Array, rate: Array, acceleration: Array, cv: Array, cm: Array) -> tuple[Array, Array]:
        """Force (3 B,) of the film's motion on B solids, and minus its derivative (3 B, 3 B) by their increments.

        ``rate`` and ``acceleration`` are v_alpha and a_alpha, with the derivatives ``cv`` [1/s] and ``cm`` [1/s^2] (3
        B,).
        """
        g = self._widths(increment)
        weight = np.full(len(g), self.along)
        weight[[0, -1]] *= 0.5
        swept, half = weight[:, None] * self.rows, between(g)
        inertia = self._solve(half / self.density, swept)
        stiff = -cm * (swept.T @ inertia)
        q = self._flow(half, inertia @ rate)
        pressure = inertia @ acceleration
        if self.viscosity:
            drag = self._solve(half**3 / (12 * self.viscosity), swept)
            stiff -= cv * (swept.T @ drag)
            pressure = pressure + drag @ rate
        # Bernoulli's pressure: (g / rho P_s)_s = g_tt + (Q g_t / g)_s with P = p + rho u^2 / 2.
        source = np.zeros(len(g))
        opens = self.rows @ rate
        source[1:-1] = np.diff(q * between(opens) / half)
        speed = self._flows(q, opens) / g
        head = 0.5 * self.density * speed**2
        first, last = np.where([speed[0] < 0, speed[-1] > 0], head[[0, -1]], 0.0)
        part = np.append(0.0, np.cumsum(1 / half)) / (1 / half).sum()
        pressure = pressure + self._solve(half / self.density, source) + first + (last - first) * part - head
        return swept.T @ pressure, stiff

    def _widths(self, increment: Array) -> Array:
        """(P,) at the middle of a step with increments (3 B,)."""
        return np.maximum(self.width + 0.5 * self.rows @ increment, self.least)

    def _flow(self, half: Array, impulse: Array) -> Array:
        """(P - 1,) flows between the points, by the pressure (P,) that would start them at once: Q_s = -g_t."""
        return np.asarray(-half / self.density * np.diff(impulse) / self.along)

    def _flows(self, flow: Array, opens: Array) -> Array:
        """(P,) flows at the points, by those between them and the rates (P,) of the widths."""
        first, last = flow[0] + 0.5 * self.along * opens[0], flow[-1] - 0.5 * self.along * opens[-1]
        return np.concatenate([[first], between(flow), [last]])

    def speeds(self, rate: Array) -> Array:
        """(P,) along it, with rates (3 B,) of the solids [m/s]."""
        g = self._widths(np.zeros_like(rate))
        half, weight = between(g), np.full(len(g), self.along)
        opens = self.rows @ rate
        return self._flows(self._flow(half, self._solve(half / self.density, weight * opens)), opens) / g


def between(of: Array) -> Array:
    """Means of neighbours."""
    return np.asarray(0.5 * (of[1:] + of[:-1]))


class Stretch(NamedTuple):
    """A gap with fluid at both mouths."""

    cells: Array  # (K, 3)
    nodes: Array  # their particles
    mouths: Array  # those of them in a fluid
    axis: Array  # (2,) unit vector along it
    fluid: int  # beside it, the last one


def stretches(mesh: Mesh, empty: Array | None, owner: Array, seals: Array, spacing: float) -> list[Stretch]:
    """The closed gaps, of empty cells (E, 3), in which fluid seeps; nothing does at solids of the mask ``seals``."""
    if empty is None or not len(empty):
        return []
    x = mesh.position
    shut = empty[closed_cells(x, empty, owner, spacing)]
    shut = shut[~seals[owner[shut]].any(axis=1)]
    if not len(shut):
        return []
    of, inside, result = np.full(len(x), -1), np.zeros(len(x), dtype=bool), []  # the last fluid there
    inside[shut] = True
    around = np.flatnonzero(inside[mesh.cells[:, 0]] | inside[mesh.cells[:, 1]] | inside[mesh.cells[:, 2]])
    np.maximum.at(of, mesh.cells[around], np.asarray(mesh.fluid)[around, None])
    count, number = parts_of_cells(shut)
    for c in range(count):
        nodes = np.unique(shut[number == c])
        axis = np.linalg.svd(x[nodes] - x[nodes].mean(axis=0), full_matrices=False)[2][0]
        along, mouths = x[nodes] @ axis, nodes[of[nodes] >= 0]
        off = [np.abs(end - x[mouths] @ axis).min(initial=np.inf) for end in (along.min(), along.max())]
        if max(off) <= MOUTH * spacing:
            result.append(Stretch(shut[number == c], nodes, mouths, axis, int(of[mouths].max())))
    return result


def films(
    found: list[Stretch],
    mesh: Mesh,
    pressure: Array,
    owner: Array,
    pose: Array,
    gravity: Array,
    fluids: Array,
    spacing: float,
    mouths: Mouths | None = None,
) -> tuple[Array, list[Film]]:
    """Force and moment (B, 3) of the pressures of mouths on B solids [N/m, N/m, N], and the gaps that have a law.

    In a full tank, which has ``mouths``, these pressures act with the step, see `mouths`; what is left is that of the
    weight. ``pose`` (B + 1, 3) is of the solids, the tank first, ``fluids`` (F, 2) have densities and viscosities.
    """
    x, moving, weight = mesh.position, list[Film](), fluids[:, :1] * gravity
    shut = np.concatenate([np.zeros((0, 3), dtype=int), *(each.cells for each in found)])
    of, values = np.repeat([each.fluid for each in found], [len(each.cells) for each in found]), np.zeros(len(x))
    for nodes, ends, axis, fluid in (each[1:] for each in found):
        level = x @ weight[fluid]
        at, head = x[ends] @ axis, pressure[ends] - level[ends]
        order = np.argsort(at)
        values[nodes] = np.interp(x[nodes] @ axis, at[order], head[order]) + level[nodes]
        values[ends] = pressure[ends]
        film = _film(x[nodes], owner[nodes], axis, pose, spacing, *fluids[fluid])
        moving += [] if film is None else [film[1]]
    mean = values[shut].mean(axis=1)
    if mouths is not None:
        shut, of, mean = mouths.cells, np.maximum(mouths.fluid, 0), mouths.levels(weight)
    slope, area = slopes_of_areas(x, shut)
    force = mean[:, None, None] * slope + (area[:, None] / 3 * weight[of.astype(int)])[:, None]
    result = by_pose(force, x, shut, owner - 1, pose[1:, :2]).sum(axis=0).reshape(-1, 3)
    return result, moving


def streams(found: list[Stretch], x: Array, owner: Array, pose: Array, rate: Array, spacing: float) -> Array:
    """(N, 2) velocities along the gaps at the particles x (N, 2) of some of them, nan for others [m/s].

    ``pose`` (B + 1, 3) is of the solids, the tank first, ``rate`` (3 B,) of those but the tank; see `gaps.owners`.
    """
    result = np.full_like(x, np.nan)
    for _, nodes, _, axis, _ in found:
        film = _film(x[nodes], owner[nodes], axis, pose, spacing, 1.0, 0.0)
        if film is not None:
            result[nodes] = np.interp(x[nodes] @ axis, film[0], film[1].speeds(rate))[:, None] * axis
    return result


def _film(
    x: Array, owner: Array, axis: Array, pose: Array, spacing: float, density: float, viscosity: float
) -> tuple[Array, Film] | None:
    """Points along an ``axis`` and the gap with particles at x (K, 2); None if it is not between two, and straight."""
    solids, across = np.unique(owner), np.array([-axis[1], axis[0]])
    if len(solids) != 2:
        return None
    s, height = x @ axis, x @ across
    chains = []
    for solid in solids.tolist():
        mine = np.flatnonzero(owner == solid)
        mine = mine[np.argsort(s[mine])]
        chains.append((s[mine], height[mine]))
    first, last = max(of[0][0] for of in chains), min(of[0][-1] for of in chains)
    if last - first < spacing:
        return None
    at = np.linspace(first, last, POINTS)
    low, high = (np.interp(at, *of) for of in chains)
    width = high - low
    if (width < 0).all():
        across, width = -across, -width
    elif (width < 0).any() or width.max() > 2 * WIDE * spacing:
        return None
    rows = np.zeros((len(at), len(pose), 3))
    for solid, level, sign in zip(solids.tolist(), (low, high), (-1.0, 1.0), strict=True):
        place = at[:, None] * axis + level[:, None] * np.array([-axis[1], axis[0]])
        arm = turned(place - pose[solid, :2])
        rows[:, solid, :2], rows[:, solid, 2] = sign * across, sign * arm @ across
    flat = rows[:, 1:].reshape(len(at), -1)
    return at, Film(width, (last - first) / (POINTS - 1), flat, density, viscosity, LEAST * SKIN * spacing)
