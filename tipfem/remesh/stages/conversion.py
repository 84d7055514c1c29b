"""Cavities of a state's cells and particles, and particles and mesh of a repair, in 3-D."""

from __future__ import annotations

import copy

import numpy as np

from tipfem.case.boundary.boundary import Boundary
from tipfem.case.particles import Particles
from tipfem.geometry.period import no_period
from tipfem.geometry.place import along_curve
from tipfem.geometry.polyhedron import Polyhedron
from tipfem.mesh.mesh import Mesh, Surface, beyond_faces
from tipfem.physics.state import State
from tipfem.physics.walls.step import WallsInStep
from tipfem.remesh import drops
from tipfem.remesh.cavity.arrays import ON, WALL
from tipfem.remesh.cavity.cavities import Cavities, highest, measures
from tipfem.remesh.cavity.empty_cells import NEXT, Slipping, extended, followed
from tipfem.remesh.cavity.flight import Flight
from tipfem.remesh.stages.remeshing import Labels, Rules
from tipfem.remesh.target_spacing import film_targets, limited
from tipfem.remesh.volumes import with_components
from tipfem.typing import Array


def whole(rules: Rules, state: State, particles: Particles, walls: WallsInStep | None = None) -> tuple[Particles, Mesh]:
    """The cells of fluids, and behind them those of empty space, labelled, where particles have moved to.

    And the particles, of which those of dry walls have slid along these before what comes.
    """
    mesh, surface = state.mesh, state.mesh.surface
    label = rules.labels.of[np.asarray(mesh.fluid)].astype(np.int32)
    if surface.empty is None or surface.nodes is None:
        moved = mesh.moved(particles.position, measures(particles.position, mesh.cells))
        return particles, moved.relabelled(label)
    count, fluids, beside = len(particles), len(mesh.cells), surface.beside
    empty = Mesh(np.concatenate([state.particles.position, surface.nodes]), surface.empty)
    if beside is not None:
        empty = empty.with_(neighbours=np.maximum(beside - fluids, -1))
    empty = followed(empty, particles.position, particles.spacing, slipping(state, walls))
    x, among = empty.position, empty.neighbours
    particles = particles.shallow_copy(position=x[:count].copy())
    cells, label = np.concatenate([mesh.cells, empty.cells]), np.pad(label, (0, len(empty.cells)))
    among = np.concatenate([mesh.neighbours, np.where(among < 0, among, among + fluids)])
    mesh = Mesh(x, cells, label).with_(measure=measures(x, cells))
    return particles, mesh.with_(neighbours=beyond_faces(cells, among, len(x)))


def cavities_of(
    rules: Rules,
    mesh: Mesh,
    particles: Particles,
    boundary: Boundary,
    fixed: Array,
    moves: Array | None = None,
    *,
    free: bool = False,
) -> Cavities:
    """A labelled mesh as cavities; see `Cavities`. Nodes of empty space are behind the particles.

    Particles of walls along which fluids slide, or of all if they are ``free``, are held in corners alone.
    """
    count, wall, planes = len(mesh.position), particles.wall, boundary.planes
    held = fixed | (wall & (not free))
    held[boundary.index[boundary.slides]] = False
    held |= fixed
    fields = rates_of(particles)
    if count > len(particles):
        nothing = np.zeros((count - len(particles), fields.shape[1]))
        nodes = np.arange(len(particles), count, dtype=np.int32)
        around = Mesh(mesh.position, mesh.cells[np.asarray(mesh.fluid) == 0])  # all cells that have nodes
        fields = extended(around, np.concatenate([fields, nothing]), nodes, NEXT)
        fields[len(particles) :, -1] = 0.0
        held, wall = drops.longer(held, count), drops.longer(wall, count)
        moves = None if moves is None else drops.longer(moves, count)
        planes = None if planes is None else np.pad(planes, ((0, len(nothing)), (0, 0)))
    kinds = boundary.domain.kinds if isinstance(boundary.domain, Polyhedron) else None
    cavities = Cavities(mesh, held, particles.spacing, fields, moves, wall, planes, kinds)
    if rules.grading is not None:
        widen(rules, cavities, particles)
    elif rules.open:
        # Contact lines at rest on sloping walls would move as these coarsen.
        cavities.coarsen_empty(walls=not slopes(boundary))
    return cavities


def widen(rules: Rules, cavities: Cavities, particles: Particles) -> None:
    """Set how far apart particles and nodes are to be by the grading; on dry walls as in the widest fluid."""
    if (grading := rules.grading) is None:
        return
    rows, spacing = np.flatnonzero(cavities.marks), particles.spacing
    fine, cells = cavities.marks & ON > 0, cavities.cells[cavities.label >= 0]
    largest = grading.of_fluids(rules.names, spacing)
    fluid = np.full(len(cavities.x), -1)
    for label in np.flatnonzero(rules.labels.density > 0):
        fluid[cavities.cells[cavities.label == label]] = rules.labels.fluid[label]
    size = grading.sizing(cavities.x[rows], fluid[rows], fine[rows], largest, spacing)
    cavities.wide[rows] = size
    if grading.film_resolution is not None:
        given = cavities.x, cavities.cells, cavities.across, cavities.label, rules.labels.density > 0, fine
        cavities.wide = film_targets(*given, cavities.wide, grading.film_resolution)
    cavities.wide = limited(cavities.x, cells, no_period(3), cavities.wide, grading.growth) / spacing


def taken(
    rules: Rules,
    cavities: Cavities,
    particles: Particles,
    flight: Flight,
    *,
    sort: bool = False,
    sort_cells: bool = False,
) -> tuple[Particles, Mesh, Array, Array]:
    """Particles and mesh of a repair: the old ones in their order, then new ones. Corners of empty cells are nodes.

    With ``sort``, particles are in the order of their places, so that those of a cell are near in memory; with
    ``sort_cells``, cells are.

    Returns:
        The particles (N'), the mesh, the new number (N,) of each old particle, -1 for those removed, and the mask
        (N',) of those that are new.
    """
    before, raw = len(particles), cavities.mesh(empty=rules.open, sort=sort_cells)
    wall, label = (cavities.marks & WALL) != 0, np.asarray(raw.fluid)
    count = np.count_nonzero(label) if rules.open else len(label)  # of the cells of fluids, the first ones
    used, dry, flies = np.zeros((3, len(wall)), dtype=bool)
    used[raw.cells[:count]] = True
    dry[raw.cells[count:]] = True
    flies[: len(flight.loose)] = flight.loose
    stays, is_old = used | (wall & dry) | flies, ~cavities.is_new
    is_old[before:] = False
    kept = np.concatenate([np.flatnonzero(stays & is_old), np.flatnonzero(stays & ~is_old)])
    if sort:  # with nodes behind them as they were: no equation is at these
        kept = kept[np.argsort(along_curve(cavities.x[kept], particles.spacing), kind="stable")]
    number, nodes = np.full(len(stays), -1, dtype=np.int32), np.flatnonzero(dry & ~stays)
    number[kept], number[nodes] = np.arange(len(kept)), len(kept) + np.arange(len(nodes))
    result = np.where(number[:before] < len(kept), number[:before], np.int32(-1))
    position, cells, neighbours = np.ascontiguousarray(cavities.x[kept]), number[raw.cells], raw.neighbours[:count]
    mesh = Mesh(position, cells[:count], rules.labels.fluid[label[:count]])
    if rules.open:
        front, volume = np.zeros(len(stays), dtype=bool), np.zeros(len(stays))
        cell, i = np.divmod(np.flatnonzero(neighbours.ravel() >= count), 4)
        for k in (1, 2, 3):
            front[raw.cells[cell, (i + k) % 4]] = True
        volume[flies] = flight.volume[flies[: len(flight.loose)]]
        masks = front[kept], ~used[kept], flies[kept] & ~used[kept]
        beside, neighbours = raw.neighbours[count:], np.where(neighbours < count, neighbours, np.int32(-1))
        surface = Surface(*masks, volume[kept], np.zeros(len(kept)), cells[count:], cavities.x[nodes], beside)
        mesh = Mesh(position, mesh.cells, mesh.fluid, surface=surface)
    mesh = with_components(mesh.with_(neighbours=neighbours), len(rules.fluids))
    d, fields = particles.dimension, cavities.fields[kept]
    rank = highest(mesh.cells, label[:count], len(kept))
    fluid = np.where(rank >= 0, rules.labels.fluid[rank], 0).astype(np.int32)
    flying = np.flatnonzero(flies[kept] & (rank < 0))
    fluid[flying] = rules.labels.fluid[flight.label[kept[flying]]]
    pressure = np.where(used[kept], fields[:, -1], 0.0)
    taken = particles.shallow_copy(
        position=mesh.position,
        fluid=fluid,
        wall=wall[kept],
        velocity=np.ascontiguousarray(fields[:, :d]),
        acceleration=np.ascontiguousarray(fields[:, d : 2 * d]),
        pressure=pressure,
        target=particles.spacing * cavities.wide[kept],
    )
    return taken, mesh, result, ~is_old[kept]


def flight_of(state: State, labels: Labels) -> Flight:
    """The spray of a state."""
    surface, fluid = state.mesh.surface, state.particles.fluid
    return Flight(surface.loose, surface.volume, labels.of[fluid])


def renumbered(boundary: Boundary, number: Array, count: int) -> Boundary:
    """The same walls and wall particles under new numbers ``number`` (N,) among ``count`` particles."""
    new, there = copy.copy(boundary), number >= 0
    new.index = np.sort(number[boundary.index]).astype(np.int64)  # ascending, as at the start
    for name in ("still", "stays", "planes"):
        old = getattr(boundary, name)
        if old is not None:
            mask = np.zeros((count, *old.shape[1:]), dtype=bool)
            mask[number[there]] = old[there]
            setattr(new, name, mask)
    return new


def slipping(state: State, walls: WallsInStep | None) -> Slipping:
    """Particles of dry walls along which fluids slide; none without ``walls``."""
    domain, planes = state.boundary.domain, state.boundary.planes
    assert planes is not None
    assert isinstance(domain, Polyhedron)
    rows, along = np.zeros(0, dtype=np.int64), np.zeros((0, 3, 3))
    if walls is not None:
        dry = ~state.mesh.surface.used[walls.sliding]
        rows, along = walls.sliding[dry], walls.columns.reshape(-1, 3, 3)[dry]
    return Slipping(rows, along, planes, domain.kinds)


def slopes(boundary: Boundary) -> bool:
    """Whether a wall is at right angles to no axis."""
    domain = boundary.domain
    return isinstance(domain, Polyhedron) and bool((np.abs(domain.normal).max(axis=1) < 1).any())


def rates_of(particles: Particles) -> Array:
    """(N, 7) velocities, accelerations and pressures of particles."""
    return np.concatenate([particles.velocity, particles.acceleration, particles.pressure[:, None]], axis=1)
