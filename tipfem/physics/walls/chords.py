"""ChordPressures: the pressure of curves along which fluids slip, on the polyline of their particles.

A particle that slides on a curve moves along the line from the particle before it to that after it: at right angles to
the mean of the normals of its two faces, not to each of them. So a pressure that varies along the wall has a part
along the slip, t . int p n phi, which is no force on the fluid: it is added to momentum. With it, what is left of the
row of a fluid at rest is int phi (grad p - rho b), which vanishes. The volumes that slip moves through the faces by the
same coefficients, t . int q n phi, are those between chords and curve: they are no growth of the fluid, and are taken
from continuity. So neither term does work together, and walls at rest give no energy.

Directions and volumes are of the faces predicted for the middle of the step, to whose normals directions are at right
angles, so that volumes sum to zero. Forces act at the intermediate time, on the faces as the iterate has them: to a
pressure p the faces have a stiffness of p times their curvature, which those of a prediction would leave to momentum.
In light air, the level of the pressure would decide how it moves along the curve. What both differ by is a part of the
work of pressure between intermediate and last positions.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from tipfem.backend.launch import launch
from tipfem.geometry.period import Period
from tipfem.geometry.plane.vectors import cross, turned
from tipfem.linalg.sparsity import Csr, run_starts, sums_of_runs
from tipfem.physics import linear_rows
from tipfem.physics.term import Equations, TermWork
from tipfem.typing import Array

# Part that passes the edge of a thin plate of what the slip along it opens. With it the added mass of plates 0.1 to 0.5
# spacings thick in a flow that oscillates is right to 4 %, with 3 to 12 spacings in half of them; without, 18 to 67 %.
PASSES = 0.85
ALONG = 1e-9  # sine of the largest angle between a face and a slip along it


class Slip(NamedTuple):
    """K unknown parts of the slips of particles, of which one has as many as name it; a slip is their sum."""

    number: Array  # (K,) of the slip
    node: Array  # (K,) whose displacement it is a part of
    column: Array  # (K, 3) by which the node's unknowns are multiplied in the slip,
    row: Array  # (K, 3) and a force along the slip in the node's rows


class ChordPressures:
    """See the module.

    An end is a face and a particle of it that slides: an entry of a list (M,), of the first particle and of the second.

    Particles in corners are put back after the step: their volumes are what that takes from the iterate. The Jacobian
    has its derivatives by the slips of corners and of straight sides: did its rows not sum to zero, what they sum to
    would determine the level of pressure in a closed tank. Of what opens beside a thin plate's edge `PASSES` is not
    taken: it passes from one side to the other, driven by the difference of their pressures.

    Args:
        faces: (E, 2) particles along curves, with the fluid on their left, at most one of them off the curve.
        nodes: (E, 2) of the mesh that is solved on, with the pressures of that fluid.
        middle: (N, 2) positions predicted for the middle of the step [m], of the volumes.
        index: (K,) the particles that slide.
        along: (K, 2) unit vectors along which they do, at the positions ``middle``,
        row_along: (K, 2) and at the intermediate time, of the rows of momentum.
        weight: (E, 2) of the fluid at the faces [N/m^3].
        corners: masks (2, N) of the particles in corners, and of those that slide along straight sides; or None.
    """

    def __init__(
        self,
        name: str,
        faces: Array,
        nodes: Array,
        middle: Array,
        index: Array,
        along: Array,
        row_along: Array,
        period: Period,
        weight: Array,
        corners: Array | None = None,
    ) -> None:
        self._name, self._faces, self._period = name, faces, period
        number = np.full(len(middle), -1)
        number[index] = np.arange(len(index))
        one, face = np.divmod(np.flatnonzero(number[faces.T].ravel() >= 0), len(faces))
        self._slip, self._face, self._pressures = number[faces[face, one]], face, nodes[face]
        self._along = row_along[self._slip]
        self._own = np.arange(2) == one[:, None]
        edge = middle[faces[face, 1]] - middle[faces[face, 0]]
        self._volume = cross(along[self._slip], edge)[:, None] * self._shares(middle)
        self._force = np.zeros_like(self._volume)
        self._derivative = self._volume
        self._corners = None if corners is None else [np.flatnonzero(mask[faces[face, one]]) for mask in corners]
        self._kept, self._lifts = len(face), np.zeros(len(index))
        if corners is not None and (edges := corners[0][faces].all(axis=1)).any():
            self._pass(np.flatnonzero(edges), middle, number, along, row_along, nodes, weight)

    def _pass(
        self, edges: Array, x: Array, number: Array, along: Array, row_along: Array, nodes: Array, weight: Array
    ) -> None:
        """Passage of a part of what opens beside thin plates' edges (T,), along which both corners slide."""
        faces, way = self._faces, self._period.shortest
        sides = [np.full(len(x), -1) for _ in range(2)]
        sides[0][faces[:, 1]] = sides[1][faces[:, 0]] = np.arange(len(faces))
        pair = faces[edges]
        slip, beside = number[pair], np.stack([sides[0][pair[:, 0]], sides[1][pair[:, 1]]], axis=1)
        t = along[slip]
        edge, side = (way(x[faces[f, 1]] - x[faces[f, 0]]) for f in (edges, beside))
        off = np.abs(cross(t, edge[:, None])).max(axis=1) / np.linalg.norm(edge, axis=1)
        opens = cross(t[:, :1], side)
        here = (off < ALONG) & (beside >= 0).all(axis=1) & (opens.prod(axis=1) < 0)
        pair, slip, beside, t, opens = (each[here] for each in (pair, slip, beside, t, opens))
        least = np.abs(opens).min(axis=1) * self._period.radius(x[pair]).mean(axis=1)
        passes = -0.5 * PASSES * np.sign(opens) * least[:, None]  # by each of the two slips, from one side to the other
        same = np.sign((t * t[:, :1]).sum(axis=2))
        share = np.array([[1.0, 2.0], [2.0, 1.0]]) / 6  # of a side's particles
        volume = same[:, :, None, None] * (passes[:, :, None] * share)[:, None]  # by slips, sides and their particles
        slips, face, volume = np.repeat(slip, 2), np.repeat(beside[:, None], 2, axis=1).ravel(), volume.reshape(-1, 2)
        heights = (way(x[faces[face]] - x[np.repeat(pair[:, 0], 4)][:, None]) * weight[face][:, None]).sum(axis=2)
        np.add.at(self._lifts, slips, -(volume * heights).sum(axis=1))
        self._slip, self._face = np.append(self._slip, slips), np.append(self._face, face)
        self._pressures, self._along = np.append(self._pressures, nodes[face], axis=0), row_along[self._slip]
        self._own = np.append(self._own, np.zeros_like(volume, dtype=bool), axis=0)
        self._volume = self._derivative = np.append(self._volume, volume, axis=0)
        self._force = np.zeros_like(self._volume)

    def _shares(self, x: Array, ends: Array | slice = slice(None), *, other: bool = False) -> Array:
        """Parts (M, 2) of the ends' faces by the pressures there, at positions (N, 2), in rings times 2 pi r."""
        own = self._own[ends] != other
        if not self._period.axial:
            return np.where(own, 1.0 / 3.0, 1.0 / 6.0)
        r = self._period.radius(x[self._faces[self._face[ends]]])
        return np.asarray((r.sum(axis=1)[:, None] + np.where(own, 2 * r, 0.0)) / 12)

    def take(self, halfway: Array, end: Array, along: Array) -> None:
        """Set the volumes of corners.

        ``end`` (N, 2) are positions at the end of the step [m], put back in corners, ``halfway`` those halfway there;
        particles slide ``along`` (K, 2) unit vectors.
        """
        assert self._corners is not None
        here, sides = self._corners
        volume = self._swept(here, halfway, along)
        if self._period.axial:  # by Simpson's rule: the volume is cubic in the slips
            ends = self._swept(here, 2 * halfway - end, along) + self._swept(here, end, along)
            volume = (ends + 4 * volume) / 6
        self._volume[here] = volume
        self._derivative = self._volume.copy()
        self._derivative[here] = self._swept(here, end, along)
        self._derivative[sides] = self._swept(sides, end, along, other=True)  # of the corner at the face's other end

    def _swept(self, ends: Array, x: Array, along: Array, *, other: bool = False) -> Array:
        """Volumes (M, 2) by slips of some ends at positions (N, 2), over these and along vectors (K, 2)."""
        t, (a, b) = along[self._slip[ends]], self._faces[self._face[ends]].T
        part = cross(t, x[b] - x[a]) / (t * self._along[ends]).sum(axis=1)
        return np.asarray(part[:, None] * self._shares(x, ends, other=other))

    def taken(self, slip: Array) -> float:
        """Volume taken from continuity by slips (K,) [m]."""
        return float(self._volume.sum(axis=1) @ slip[self._slip])

    def couplings(self, slips: Slip) -> tuple[Array, Array]:
        """Rows and columns of the nodes that are coupled."""
        rows, columns = self._couplings(slips)
        return np.concatenate(rows), np.concatenate(columns)

    def _couplings(self, slips: Slip) -> tuple[list[Array], list[Array]]:
        """The same by forces on slips at one pressure and the other, volumes there, friction, and faces' ends."""
        end, part = _pairs(self._slip, slips.number)
        one, other = (slips.node[k] for k in _pairs(slips.number, slips.number))
        own, pressures, ends = slips.node[part], self._pressures[end].T, self._faces[self._face[end]].T
        return [own, own, *pressures, one, own, own], [*pressures, own, own, other, *ends]

    def put(
        self, equations: Equations, slips: Slip, given: Array, rate: Array | float = 0.0, force: Array | float = 0.0
    ) -> None:
        """Set the matrix.

        ``given`` (K,) are slips that are prescribed [m], ``rate`` is friction over slip [N/m, per metre of depth],
        ``force`` that without slip in the step [N, per metre of depth].
        """
        self._end, part = end, part = _pairs(self._slip, slips.number)
        one, other = _pairs(slips.number, slips.number)
        friction, count = np.broadcast_to(rate, len(given)), len(end)
        self._row, self._column = slips.row[part], slips.column[part]
        self._blocks = blocks = np.zeros((6 * count + len(one), 3, 3))
        drag = friction[slips.number[one]]
        blocks[4 * count : 4 * count + len(one)] = (
            drag[:, None, None] * slips.row[one][:, :, None] * slips.column[other][:, None, :]
        )
        row, column = self.couplings(slips)
        size = equations.rows
        key = row.astype(np.int64) * size + column
        self._order = order = np.argsort(key, kind="stable")
        self._first = first = run_starts(key[order])
        row, column = np.divmod(key[order][first], size)
        rows, starts = np.unique(row, return_index=True)
        self._rows, self._fixed, self._given = rows, np.zeros((size, 3)), given
        drags = friction * given + force + self._lifts
        np.add.at(self._fixed, slips.node, slips.row * drags[slips.number, None])
        up, self._count, self._equations = equations.buffers.upload, len(rows), equations
        self._pattern = (
            up(f"{self._name}.chords.rows", rows.astype(np.int32)),
            up(f"{self._name}.chords.offsets", np.append(starts, len(row)).astype(np.int32)),
            up(f"{self._name}.chords.columns", column.astype(np.int32)),
        )
        self._put_volumes(self._volume)
        self._put_given()

    def _put_given(self) -> None:
        """Set what does not depend on the unknowns."""
        constant = self._fixed.copy()
        np.add.at(constant[:, 2], self._pressures, -self._volume * self._given[self._slip][:, None])
        self._constant = self._equations.buffers.upload(f"{self._name}.chords.constant", constant[self._rows].ravel())

    def _put_volumes(self, volume: Array) -> None:
        count = len(self._end)
        for k in range(2):
            self._blocks[(2 + k) * count : (3 + k) * count, 2, :] = -self._column * volume[self._end, k, None]

    def _summed(self) -> Array:
        """The blocks of the same place together, as the device has them."""
        return sums_of_runs(self._blocks.reshape(-1, 9), self._order, self._first).ravel()

    def _put_forces(self, x: Any) -> None:
        """Set the forces, and their derivatives, on the faces as ``x`` has them."""
        e, count, blocks = self._equations, len(self._end), self._blocks
        values, cf, (a, b) = e.values(x), e.scheme.cf, self._faces[self._face].T
        u, position = values[:, :2], e.mesh.position
        across = cross(self._along, position[b] - position[a] + cf * (u[b] - u[a]))
        across[self._kept :] = 0.0
        share = self._shares(position + cf * u[: len(position)])
        self._force = across[:, None] * share
        self._force[self._kept :] = self._volume[self._kept :]
        for k in range(2):
            blocks[k * count : (k + 1) * count, :, 2] = self._row * self._force[self._end, k, None]
        ends = len(blocks) - 2 * count  # counted from here: straight sides have friction, and count = 0
        blocks[ends:] = 0.0
        up = e.buffers.upload
        if self._corners is not None:
            self._put_volumes(self._volume)
            self._put_given()
        self._values = up(f"{self._name}.chords.values", self._summed())
        of = values[self._pressures, 2]
        pressure = (share * of).sum(axis=1)
        slope = self._row[:, :, None] * (cf * pressure[:, None] * turned(self._along))[self._end][:, None, :]
        blocks[ends : ends + count, :, :2], blocks[ends + count :, :, :2] = -slope, slope
        if self._period.axial:  # by the radii of the face's ends
            own = (of * self._own).sum(axis=1)
            for k in range(2):
                by_radius = across * (of.sum(axis=1) + np.where(self._own[:, k], 2 * own, 0.0)) / 12
                more = (cf * self._period.turn * by_radius)[self._end]
                blocks[ends + k * count : ends + (k + 1) * count, :, 0] += self._row * more[:, None]
        if self._corners is not None:
            self._put_volumes(self._derivative)
        self._slopes = up(f"{self._name}.chords.slopes", self._summed())

    def residual(self, x: Any, out: Any) -> None:
        """See `Term.residual`."""
        if self._count:
            self._put_forces(x)
            arrays = *self._pattern, self._values, self._constant, self._equations.scale, x, out, self._count, 2
            launch(linear_rows.add_product, *arrays, work=(self._count, linear_rows.ROW))

    def gather(self, matrix: Csr) -> None:
        """See `Term.gather`."""
        if self._count:
            e, work = self._equations, (self._count, linear_rows.ROW)
            launch(
                linear_rows.add_blocks, *self._pattern, self._slopes, e.scale, matrix, e.rows, self._count, 2, work=work
            )

    def work(self, pressure: Array, slip: Array, solved: Array) -> TermWork:
        """Work that is not the walls', at the last residual: that of the part of their reactions along the slip.

        ``slip`` (K,) is of the particles, ``solved`` that of the equations, whose volumes are taken from continuity
        [m].
        """
        of = pressure[self._pressures]
        forces, volumes = (
            float((v * of).sum(axis=1) @ s[self._slip]) for v, s in ((self._force, slip), (self._volume, solved))
        )
        lifts = float(self._lifts @ slip)
        return TermWork(walls=forces + lifts, geometry=volumes - forces - lifts, weight=-lifts, passed=-lifts)


def _pairs(slip: Array, number: Array) -> tuple[Array, Array]:
    """All pairs of entries of two lists (E,), (K,) of the same slip; the second ascends."""
    first, last = np.searchsorted(number, slip), np.searchsorted(number, slip, side="right")
    length = last - first
    of = np.repeat(np.arange(len(slip)), length)
    ahead = np.cumsum(length) - length
    return of, np.arange(len(of)) + np.repeat(first - ahead, length)
