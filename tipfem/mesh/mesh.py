"""Mesh: linear simplices on the particles, with the connectivity that the solver needs."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from tipfem.case.particles import Particles
from tipfem.geometry.period import Period, no_period
from tipfem.geometry.plane.vectors import turned
from tipfem.mesh.components import Components
from tipfem.typing import Array


@dataclass(frozen=True)
class Surface:
    """The free surface of a mesh on N particles."""

    front: Array  # (N,) mask of the particles on the surface, including wall particles at its contacts
    # (N,) mask of the particles in no simplex; their pressure is zero. On the surface pressure is an unknown, and
    # no traction the natural condition of the momentum equation, so that continuity holds there too.
    pinned: Array
    loose: Array  # (N,) mask of the particles off the walls that are in no simplex; they move in free flight
    volume: Array  # (N,) volume of fluid that each loose particle carries, zero for all others [m^2, or m^3 in 3-D]
    # (N,) volume by which the cells are smaller than the fluid in them, the same part of all cells of a connected
    # component; restored as soon as that is possible [m^2, or m^3 in 3-D]. Where it is positive, particles that
    # have just landed carry it, beside their cells, as spray does.
    deficit: Array
    # (V, d + 1) cells of the empty space beyond the surface, where they are kept from step to step, else None
    empty: Array | None = None
    # (K, d) places of those corners of empty cells that are no particles, with numbers from N on; in 3-D [m]
    nodes: Array | None = None
    # (V, d + 1) the cell across each face of an empty cell: those of the mesh, and behind them the empty ones; -1 for
    # none
    beside: Array | None = None

    @property
    def exists(self) -> bool:
        """Whether any particle is on the surface or in no simplex."""
        return bool(self.front.any() or self.pinned.any())

    @property
    def used(self) -> Array:
        """(N,) mask of the particles in simplices."""
        return np.asarray(~self.pinned | self.front)

    @property
    def spray(self) -> Array:
        """(N,) volume of fluid that each particle carries outside the cells [m^2, or m^3 in 3-D].

        That of the loose particles, and what the cells of particles that have just landed have no room for yet.
        """
        return np.asarray(self.volume + np.maximum(self.deficit, 0.0))

    def longer(self, count: int) -> Surface:
        """The surface with particles in its fluids behind the others, ``count`` in all."""
        per_particle = {name: getattr(self, name) for name in ("front", "pinned", "loose", "volume", "deficit")}
        more = count - len(self.front)
        return replace(self, beside=None, **{name: np.pad(each, (0, more)) for name, each in per_particle.items()})

    def dry(self, wall: Array) -> Array:
        """(N,) mask of the wall particles, given by the mask ``wall`` (N,), that are in no simplex."""
        return np.asarray(wall & ~self.used)

    def constrain(self, u: Array, pressure: Array, flight: Array) -> tuple[Array, Array]:
        """Displacements (N, d), of loose particles those of ``flight``, and pressures (N,), zero where pinned."""
        return np.where(self.loose[:, None], flight, u), np.where(self.pinned, 0.0, pressure)

    def landed(self, before: Particles, moved: Particles, force: Array, dt: float) -> Particles:
        """The state ``moved`` by a step, with loose particles in free flight by ``force`` (N, d) [m/s^2]."""
        i = self.loose
        if not i.any():
            return moved
        done = moved.copy()
        done.position[i] = before.position[i] + parabola(before.velocity[i], force[i], dt)
        done.velocity[i] = before.velocity[i] + dt * force[i]
        done.acceleration[i] = force[i]
        return done


@lru_cache(maxsize=4)
def no_surface(count: int) -> Surface:
    """The surface of a mesh of ``count`` particles inside walls: no particle is on it. Its arrays cannot be changed."""
    none, zero = np.zeros(count, dtype=bool), np.zeros(count)
    none.flags.writeable = zero.flags.writeable = False
    return Surface(none, none, none, zero, zero)


def parabola(velocity: Array, force: Array, dt: float) -> Array:
    """Displacements (K, d) of free flight for ``dt`` [s] by velocity and force per mass (K, d) [m]."""
    return dt * velocity + 0.5 * dt**2 * force


LEFT = 0.2  # of its area that a cell keeps where particles are put on a curve
HALVINGS = 6  # of the way there
# Cached properties of `Mesh` that do not depend on positions.
_OF_CONNECTIVITY = ("edges", "used", "incidence", "neighbours", "hull")


@dataclass(frozen=True)
class Mesh:
    """Simplices on N particles."""

    position: Array  # (N, d) [m]
    cells: Array  # (M, d + 1) particles of each simplex, positively oriented, int32
    # (M,) fluid of each simplex where interfaces run along facets, int32; None where they cut through simplices
    fluid: Array | None = None
    # its free surface; that of `no_surface` where walls surround the fluids, which is the default
    surface: Surface = field(default=None)  # type: ignore[assignment]  # see __post_init__
    # the connected components of the fluids, where cells have a fluid; None where they are not labelled
    components: Components | None = None
    # of the positions. Where a side is periodic, a cell may have corners on both ends of the domain: its geometry is
    # that of the images closest to each other, see `corners`.
    period: Period = field(default=None)  # type: ignore[assignment]  # see __post_init__

    def __post_init__(self) -> None:
        if self.period is None:
            object.__setattr__(self, "period", no_period(self.dimension))
        if self.surface is None:
            object.__setattr__(self, "surface", no_surface(len(self.position)))

    @property
    def dimension(self) -> int:
        """Number of space dimensions d."""
        return int(self.position.shape[1])

    @cached_property
    def measure(self) -> Array:
        """(M,) signed area [m^2] or volume [m^3] of each simplex."""
        return simplex_measure(self.position, self.cells, self.period)

    def centres(self, cells: Any = slice(None)) -> Array:
        """(K, d) centres of simplices; in an axisymmetric flow the mean places in the rings' cross-sections [m]."""
        corners = self.corners(cells)
        if not self.period.axial:
            return np.asarray(corners.mean(axis=1))
        return np.asarray(np.einsum("ka,kai->ki", self._shares(corners), corners))

    def side_measure(self, one: Array, other: Array) -> Array:
        """(K,) lengths [m] of edges between particles; in an axisymmetric flow areas [m^2] of their cones."""
        length, radius = np.linalg.norm(self.sides(one, other), axis=1), self.period.radius
        if not self.period.axial:
            return np.asarray(length)
        return np.asarray(0.5 * length * (radius(self.position[one]) + radius(self.position[other])))

    def parts_of(self, whole: Array) -> Array:
        """(M, d + 1) part of ``whole`` (M,) that belongs to each corner: by the mean of its shape function."""
        if not self.period.axial:
            return np.repeat(whole[:, None] / (self.dimension + 1), self.dimension + 1, axis=1)
        return np.asarray(whole[:, None] * self._shares(self.corners()))

    def _shares(self, corners: Array) -> Array:
        """(K, 3) means of the shape functions of the rings of triangles with ``corners`` (K, 3, 2)."""
        radii = self.period.radius(corners)
        total = radii.sum(axis=1, keepdims=True)
        return np.asarray((radii + total) / (4 * total))

    @property
    def all_cells(self) -> Array:
        """(M', d + 1) the simplices, and those of the empty space beyond the surface, where these are kept."""
        return self.cells if self.surface.empty is None else np.concatenate([self.cells, self.surface.empty])

    def corners(self, cells: Array | slice = slice(None)) -> Array:
        """(K, d + 1, d) positions of the corners of cells, numbers or a mask; those of a cell beside each other [m]."""
        return self.period.unwrapped(self.position[self.cells[cells]])

    def sides(self, one: Array, other: Array) -> Array:
        """(K, d) vectors from the particles ``one`` (K,) to the particles ``other`` (K,) beside them [m]."""
        return self.period.shortest(self.position[other] - self.position[one])

    @cached_property
    def unrolled(self) -> tuple[Mesh, Array]:
        """A mesh that is not periodic with the same cells, for pictures and probes; and the particle of each node.

        Cells that reach across a periodic side have copies of the particles there, behind all others. The middle of
        every cell is inside the domain.
        """
        if not self.period:
            return self, np.arange(len(self.position))
        corner = self.corners()
        middle = corner.mean(axis=1)
        corner = corner + (self.period.wrapped(middle) - middle)[:, None]
        away = np.abs(corner - self.position[self.cells]).max(axis=2) > 1e-6 * self.period.width.max()
        cell, k = np.nonzero(away)
        # One copy of a particle on either side at most.
        place = np.round((corner[cell, k] - self.position[self.cells[cell, k]]) @ _signs(self.period)).astype(np.int64)
        _, first, number = np.unique(
            np.stack([self.cells[cell, k], place], axis=1), axis=0, return_index=True, return_inverse=True
        )
        cells, count = self.cells.copy(), len(self.position)
        cells[cell, k] = count + number.ravel()
        position = np.concatenate([self.position, corner[cell, k][first]])
        owner = np.concatenate([np.arange(count), self.cells[cell, k][first]])
        return Mesh(position, cells, self.fluid), owner

    def with_(
        self, *, measure: Array | None = None, neighbours: Array | None = None, components: Components | None = None
    ) -> Mesh:
        """This mesh with properties that the caller has computed already, so that they are not computed again."""
        mesh = replace(self, components=self.components if components is None else components)
        mesh.__dict__.update(self._computed("measure", *_OF_CONNECTIVITY))
        given = {"measure": measure, "neighbours": neighbours}
        mesh.__dict__.update({name: value for name, value in given.items() if value is not None})
        return mesh

    def relabelled(self, fluid: Array) -> Mesh:
        """The same simplices with other fluids (M,); their components are no longer labelled."""
        mesh = replace(self, fluid=fluid, components=None)
        mesh.__dict__.update(self._computed("measure", *_OF_CONNECTIVITY))
        return mesh

    def only(self, cells: Array) -> Mesh:
        """The mesh of some of its cells, given by a mask (M,), with their fluids."""
        fluid, surface = None if self.fluid is None else self.fluid[cells], self.surface
        number = np.full(len(cells) + 1, -1, dtype=np.int32)  # the last one is for -1, beyond the hull
        number[:-1][cells] = left = np.arange(np.count_nonzero(cells))
        if (beside := surface.beside) is not None:
            among = np.where(
                beside < len(cells), number[np.minimum(beside, len(cells))], beside - len(cells) + len(left)
            )
            surface = replace(surface, beside=among.astype(np.int32))
        mesh = Mesh(self.position, np.ascontiguousarray(self.cells[cells]), fluid, surface, period=self.period)
        return mesh.with_(neighbours=number[self.neighbours[cells]])

    def dry(self, wall: Array) -> Array:
        """(N,) mask of the wall particles, given by the mask ``wall`` (N,), that are in no simplex."""
        return self.surface.dry(wall)

    @property
    def flies(self) -> Array:
        """(N,) mask of the particles in free flight."""
        return self.surface.loose

    @property
    def front(self) -> Array:
        """(N,) mask of the particles on the free surface."""
        return self.surface.front

    @property
    def flying(self) -> Array:
        """(N,) volume of fluid that particles in no simplex carry in free flight [m^2, or m^3 in 3-D]."""
        return self.surface.volume

    def with_flying(self, volume: Array) -> Mesh:
        """The same simplices, with other volumes (N,) in free flight."""
        return replace(self, surface=replace(self.surface, volume=volume)).with_(measure=self.measure)

    def moved(self, position: Array, measure: Array | None = None) -> Mesh:
        """The same simplices at other positions (N, d) [m]; shares what depends on the connectivity only.

        The last result is kept and returned again for the same array, which must not be changed in between.
        ``measure`` (M,) are the simplices' areas or volumes there, if the caller has them.
        """
        last: Mesh | None = self.__dict__.get("_moved")
        if last is None or last.position is not position:
            last = replace(self, position=position)
            last.__dict__.update(self._computed(*_OF_CONNECTIVITY))
        if measure is not None:
            last = last.with_(measure=measure)
        self.__dict__["_moved"] = last
        return last

    def _computed(self, *names: str) -> dict[str, Any]:
        """Cached properties among ``names`` that have been computed."""
        return {name: self.__dict__[name] for name in names if name in self.__dict__}

    @cached_property
    def edges(self) -> Array:
        """(E, 2) particles at the ends of each edge, lower index first; in no particular order."""
        if self.dimension == 2 and "neighbours" in self.__dict__:  # each edge once, from the cell of the higher number
            cell, i = np.nonzero(self.neighbours < np.arange(len(self.cells))[:, None])
            one, other = self.cells[cell, (i + 1) % 3], self.cells[cell, (i + 2) % 3]
            return np.stack([np.minimum(one, other), np.maximum(one, other)], axis=1)
        n, corner = len(self.position), np.ascontiguousarray(self.cells.T)
        one, other = np.array(list(itertools.combinations(range(len(corner)), 2))).T
        one, other = corner[one].ravel(), corner[other].ravel()
        ends = np.minimum(one, other), np.maximum(one, other)
        # By SciPy, which sorts by counting, where NumPy would compare.
        graph = sparse.coo_matrix((np.ones(len(one), dtype=np.int8), ends), shape=(n, n)).tocsr()
        graph.sort_indices()
        rows = np.repeat(np.arange(n, dtype=np.int32), np.diff(graph.indptr))
        return np.stack([rows, graph.indices.astype(np.int32, copy=False)], axis=1)

    @cached_property
    def connected(self) -> tuple[int, Array]:
        """Number of connected components, and that of each particle (N,); -1 for those in no simplex."""
        # Those of the fluids, or cells, as nodes of a graph: they are joined where they share particles.
        own = np.arange(len(self.cells), dtype=np.int32) if self.components is None else self.components.label
        of, count = np.full(len(self.position), -1, dtype=np.int32), int(own.max(initial=-1)) + 1
        for column in self.cells.T:
            of[column] = own
        number = np.zeros(count, dtype=np.int32)
        if count > 1:
            joined = of.take(self.cells)
            differ = np.flatnonzero((joined != own[:, None]).any(axis=1))
            ends = joined[differ].ravel(), np.repeat(own[differ], joined.shape[1])
            graph = sparse.coo_array((np.ones(len(ends[0]), dtype=np.int8), ends), shape=(count, count))
            number = connected_components(graph, directed=False)[1]
        used = np.flatnonzero(of >= 0)
        label = number[of[used]]
        # By their first particles.
        first = np.full(count, len(used))
        first[label[::-1]] = np.arange(len(used) - 1, -1, -1)
        found = np.argsort(first, kind="stable")[: np.count_nonzero(first < len(used))]
        rank = np.empty(count, dtype=np.int32)
        rank[found] = np.arange(len(found))
        of[used] = rank[label]
        return len(found), of

    @property
    def at_empty_space(self) -> Array:
        """(N,) mask of the particles on a free surface or in free flight."""
        return np.asarray(self.surface.front | self.surface.loose)

    @cached_property
    def used(self) -> Array:
        """(N,) mask of the particles in simplices."""
        mask = np.zeros(len(self.position), dtype=bool)
        mask[self.cells] = True
        return mask

    @cached_property
    def neighbours(self) -> Array:
        """(M, d + 1) the cell across the face opposite each corner, -1 at the boundary, int32."""
        count, corners = len(self.position), self.dimension + 1
        if corners > 3:
            return beyond_faces(self.cells, np.full(self.cells.shape, -1), count)
        start, end = self.cells[:, [1, 2, 0]].ravel().astype(np.int64), self.cells[:, [2, 0, 1]].ravel()
        one, other = start * count + end, end * np.int64(count) + start
        order = np.argsort(one)
        found = order[np.minimum(np.searchsorted(one, other, sorter=order), len(order) - 1)]
        return np.where(one[found] == other, found // 3, -1).astype(np.int32).reshape(self.cells.shape)

    def neighbours_with(self, empty: Array) -> Array | None:
        """(M + V, 3) neighbours of the cells, and behind them of the ``empty`` ones (V, 3); None where not known."""
        beside, count = self.surface.beside, len(self.cells)
        if beside is None or empty is not self.surface.empty:
            return None
        cell, i = np.nonzero((beside >= 0) & (beside < count))
        others, result = beside[cell, i], np.concatenate([self.neighbours, beside])
        corner = self.cells[others]
        opposite = (corner != empty[cell, (i + 1) % 3, None]) & (corner != empty[cell, (i + 2) % 3, None])
        result[others, opposite.argmax(axis=1)] = count + cell
        return result

    @cached_property
    def hull(self) -> tuple[Array, Array, Array, Array]:
        """Faces (E,) without a neighbour, in 2-D: cells, particles opposite, and two ends, the mesh on their left."""
        cell, k = np.divmod(np.flatnonzero(self.neighbours < 0), 3)
        opposite, one, other = (self.cells[cell, (k + j) % 3] for j in range(3))
        return cell, opposite, one, other

    @cached_property
    def incidence(self) -> tuple[Array, Array]:
        """Corners at each particle, in CSR: offsets (N + 1,) and corner numbers ``cell * (d + 1) + local``."""
        n, (m, corners) = len(self.position), self.cells.shape
        number, starts = np.arange(m * corners, dtype=np.int32), np.arange(0, m * corners + 1, corners, dtype=np.int32)
        columns = sparse.csr_matrix((number, self.cells.ravel(), starts), shape=(m, n)).tocsc()
        return columns.indptr.astype(np.int32, copy=False), columns.data


def beyond_faces(cells: Array, known: Array, count: int) -> Array:
    """(M, 4) the tetrahedron across the face opposite each corner, -1 for none, int32; of ``count`` particles.

    What is ``known`` (M, 4) of it is kept; -1 where it is not.
    """
    beyond = known.ravel().astype(np.int32)
    at = np.flatnonzero(beyond < 0)
    cell, i = np.divmod(at, 4)
    face = np.sort(np.stack([cells[cell, (i + k) % 4] for k in (1, 2, 3)], axis=1), axis=1).astype(np.int64)
    key = (face[:, 0] * count + face[:, 1]) * count + face[:, 2]
    order = np.argsort(key)
    first = np.flatnonzero(key[order[1:]] == key[order[:-1]])
    one, other = at[order[first]], at[order[first + 1]]
    beyond[one], beyond[other] = other // 4, one // 4
    return np.asarray(beyond.reshape(cells.shape))


def corners_among(mask: Array, cells: Array) -> Array:
    """Number (M,) of the corners of each of the ``cells`` (M, d + 1) that are among the particles of a ``mask`` (N,).

    Corner by corner: NumPy's reductions over a short axis take several times as long.
    """
    corner = mask.view(np.uint8).take(cells).T
    count = corner[0] + corner[1]
    for other in corner[2:]:
        count += other
    return np.asarray(count)


def simplex_measure(position: Array, cells: Array, period: Period | None = None) -> Array:
    """Signed areas or volumes (M,) of simplices ``cells`` (M, d + 1) at ``position`` (N, d), with a period or none."""
    if position.shape[1] == 2:  # complex numbers: both coordinates at once, and corner by corner
        corner = np.ascontiguousarray(position, dtype=np.float64).view(np.complex128).ravel().take(cells.T)
        a, b = corner[1:] - corner[0]
        if period:
            a, b = (period.shortest(edge.real, 0) + 1j * period.shortest(edge.imag, 1) for edge in (a, b))
        area = np.asarray(0.5 * (a.real * b.imag - b.real * a.imag))
        if period is not None and period.axial:
            area = area * (2 * np.pi / 3 * (corner[0].real + corner[1].real + corner[2].real))
        return area
    # Coordinate by coordinate: gathering rows takes several times as long.
    coordinates = [np.ascontiguousarray(axis) for axis in position.T]
    sides = [[axis[corner] - axis[cells[:, 0]] for axis in coordinates] for corner in cells.T[1:]]
    if period:
        sides = [[period.shortest(side, k) for k, side in enumerate(of_corner)] for of_corner in sides]
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = sides
    return np.asarray((ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)) / 6.0)


def as_far_as_cells_bear(mesh: Mesh, position: Array, goal: Array, moves: Array) -> Array:
    """Positions (N, 2) on the way from ``position`` to ``goal`` that leave each cell `LEFT` of its area.

    The cells are those of empty space, too; particles of the mask ``moves`` (N,) move.
    """
    cells = mesh.all_cells
    cells = cells[corners_among(moves, cells) > 0]
    least, part = LEFT * simplex_measure(position, cells, mesh.period), moves.astype(float)
    for _ in range(HALVINGS):
        reached = position + part[:, None] * (goal - position)
        spoilt = simplex_measure(reached, cells, mesh.period) < least
        if not spoilt.any():
            return np.asarray(reached)
        part[cells[spoilt]] *= 0.5
    part[cells[spoilt]] = 0.0
    return np.asarray(position + part[:, None] * (goal - position))


def _signs(period: Period) -> Array:
    """(d,) factors by which a shift of one period along an axis becomes a number of its own."""
    result = np.zeros(len(period.width))
    for n, k in enumerate(period.axes):
        result[k] = 4.0**n / period.width[k]
    return result


def volume_gradient(mesh: Mesh, near: Array) -> Array:
    """Derivatives (N, d) of a mesh's volume by the positions of particles ``near`` (N,); 0 for others and inside."""
    d = mesh.dimension
    cells = mesh.cells[corners_among(near, mesh.cells) > 0]
    corner = mesh.period.unwrapped(mesh.position[cells])
    result = np.zeros_like(mesh.position)
    for k in range(d + 1):
        one = corner[:, (k + 1) % (d + 1)]
        side = [corner[:, (k + 1 + j) % (d + 1)] - one for j in range(1, d)]
        if d == 2:  # half the opposite edge, turned by a right angle
            part = 0.5 * turned(side[0])
            if mesh.period.axial:
                area = simplex_measure(mesh.position, cells)
                part = part * mesh.period.radius(corner).mean(axis=1)[:, None]
                part[:, 0] += mesh.period.turn * area / 3
        else:
            # A third of the opposite face; an even permutation of the corners has k first where k is even.
            part = np.cross(side[0], side[1]) / (-6.0 if k % 2 == 0 else 6.0)
        for axis in range(d):
            result[:, axis] += np.bincount(cells[:, k], part[:, axis], minlength=len(result))
    result[~near] = 0.0
    return np.asarray(result)
