"""Stages of a remeshing in 3-D, by changes of cells in rounds; see `tipfem.remesh.cavity`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from tipfem.errors import TriangulationError
from tipfem.fem.time_integration import StepControl
from tipfem.geometry.blocks import BlockedBox
from tipfem.mesh.mesh import Mesh
from tipfem.remesh.cavity.balance import Wanted, components_of, keep_momentum, restore_nearby, restore_volumes
from tipfem.remesh.cavity.cavities import Cavities, measures, touching
from tipfem.remesh.cavity.empty_cells import Slipping
from tipfem.remesh.cavity.flight import Flight, dissolved, landed, released, stopped
from tipfem.remesh.cavity.sheets import stop_flattening
from tipfem.remesh.parts import imposed
from tipfem.remesh.stages.conversion import cavities_of, flight_of, renumbered, slipping, taken, whole
from tipfem.remesh.stages.remeshing import Remeshing
from tipfem.timers import timer
from tipfem.typing import Array

AT_REST = 1e-6  # speed of particles at rest, relative to that of a fall through a spacing
SORTED = 16  # steps after which cells are sorted by their places, too, if some have changed


@dataclass(frozen=True)
class RemeshingInSpace(Remeshing):
    """A state in 3-D that becomes the next one; its mesh has the cells of empty space, and labels, from there on.

    Until the repair is taken over, it is in the cavities.
    """

    flight: Flight = field(init=False)  # of the spray
    volumes: Wanted = field(init=False)  # that pieces of fluids are to have
    cavities: Cavities = field(init=False)
    fields: Array = field(init=False)  # those of the cavities before the repair
    place: Array = field(init=False)  # where corners of cavities are before volumes are restored [m]
    pieces: Array = field(init=False)  # of fluids: the number of each of their cells


def placed(r: RemeshingInSpace) -> RemeshingInSpace:
    """Put wall particles where the walls are, with the rates that these prescribe."""
    walls = r.solved.walls
    return r.with_(particles=walls.imposed(imposed(r.parts, walls.set_back(r.particles))))


def kept_in_tank(r: RemeshingInSpace) -> RemeshingInSpace:
    """Move particles of dry walls along with the walls, and stop the surface and the spray there."""
    if not r.rules.open:
        return r
    before, walls, surface = r.before, r.solved.walls, r.before.mesh.surface
    particles = walls.carry(before.particles, r.particles, surface.dry(r.particles.wall))
    assert before.boundary.planes is not None
    may, domain = surface.front | surface.loose, before.boundary.domain
    blocks = domain if isinstance(domain, BlockedBox) else None
    return r.with_(particles=stopped(particles, may, walls, before.boundary.planes, blocks))


@timer("empty space")
def with_empty_cells(r: RemeshingInSpace) -> RemeshingInSpace:
    """Add the cells of empty space, and label all."""
    if (measures(r.particles.position, r.mesh.cells) <= 0).any():
        raise TriangulationError("a tetrahedron was inverted before it could be repaired")
    particles, mesh = whole(r.rules, r.before, r.particles, r.solved.walls)
    return r.with_(particles=particles, mesh=mesh)


def with_landed_spray(r: RemeshingInSpace) -> RemeshingInSpace:
    """Land the spray that has met a fluid; find what volume each piece is to have."""
    before, labels, open_ = r.before, r.rules.labels, r.rules.open
    total = before.wanted_volume if r.rules.keep else before.volume
    flight = flight_of(before, labels)
    total = np.append(total - flight.by_fluid(r.particles.fluid, len(total)), 0.0) if open_ else total
    assert before.mesh.components is not None
    known = before.mesh.components.label
    particles, volumes = r.particles, Wanted.of_mesh(r.mesh, total[labels.fluid], empty=open_, known=known)
    if open_:
        way = particles.position - before.particles.position
        particles, flight, volumes = landed(r.mesh, particles, flight, volumes, labels.density, way)
    return r.with_(particles=particles, flight=flight, volumes=volumes)


@timer("cavities")
def with_sound_cells(r: RemeshingInSpace) -> RemeshingInSpace:
    """Repair the cells, and break films."""
    before, solved, particles = r.before, r.solved, r.particles
    fall = np.sqrt(np.linalg.norm(solved.force, axis=1).max() * particles.spacing)
    moves = np.linalg.norm(particles.velocity, axis=1) > AT_REST * fall
    cavities = cavities_of(r.rules, r.mesh, particles, before.boundary, before.fixed, moves)
    fields = cavities.fields[: len(r.mesh.position)].copy()
    if r.account.columns:
        cavities.observer = _observer(r, cavities)
    cavities.observer("landing")
    cavities.repair(r.rules.fitting.thin_film, solved.dt if r.rules.open else 0.0)
    if r.rules.open:
        wet(cavities, slipping(before, solved.walls))
        cavities.observer("wetting")
    return r.with_(cavities=cavities, fields=fields)


def _observer(r: RemeshingInSpace, cavities: Cavities) -> Callable[[str], None]:
    """A function that books a kind of repair of the cavities."""
    account = r.account

    def observed(kind: str) -> None:
        there = np.flatnonzero(cavities.label > 0 if r.rules.open else cavities.label >= 0)
        mesh = Mesh(cavities.x, cavities.cells[there], r.rules.labels.fluid[cavities.label[there]])
        account.add_mesh(kind, mesh, np.ascontiguousarray(cavities.fields[:, : cavities.dim]))

    account.flies(r.particles, r.flight.loose, r.flight.volume)
    return observed


@timer("volumes")
def volumes_restored(r: RemeshingInSpace) -> RemeshingInSpace:
    """Restore the volumes of pieces of fluids, first where the repair has taken them."""
    restore_nearby(r.cavities, r.mesh, r.rules.labels.density)
    cavities, place = r.cavities, r.cavities.x.copy()
    pieces = components_of(cavities.x, cavities.cells, cavities.across, cavities.label, empty=r.rules.open)
    if r.rules.open:
        dissolved(cavities, pieces)
    restore_volumes(cavities, r.volumes, pieces, r.rules.open)
    cavities.observer("volumes")
    return r.with_(place=place, pieces=pieces)


@timer("momentum")
def momentum_restored(r: RemeshingInSpace) -> RemeshingInSpace:
    """Restore the momentum of patches of changed cells, and stop particles that would flatten cells in a step."""
    density = r.rules.labels.density
    keep_momentum(r.cavities, r.place, r.mesh, r.fields, density)
    if r.rules.open:
        stop_flattening(r.cavities, density, StepControl.growth * r.solved.dt)
    return r


def with_small_pieces_released(r: RemeshingInSpace) -> RemeshingInSpace:
    """Release pieces that are too small for cells into flight: the next step would take its time for them alone."""
    return r.with_(flight=released(r.cavities, r.pieces, r.flight)) if r.rules.open else r


def taken_over(r: RemeshingInSpace) -> RemeshingInSpace:
    """Take particles and mesh over from the cavities, without the cells of empty space."""
    sort, given = r.cavities.changes > 0, (r.rules, r.cavities, r.particles, r.flight)
    sort_cells = sort and r.before.step % SORTED == 0
    particles, mesh, renumbered, relocated = taken(*given, sort=sort, sort_cells=sort_cells)
    mesh = mesh.with_(measure=measures(mesh.position, mesh.cells))
    if (mesh.measure <= 0).any():
        raise TriangulationError("a tetrahedron has no volume after the repair")
    return r.with_(particles=particles, mesh=mesh, renumbered=renumbered, relocated=relocated)


def renumbered_on_walls(r: RemeshingInSpace) -> RemeshingInSpace:
    """Find the wall of each wall particle, and give it the velocity that it prescribes; renumber what is held."""
    before, number, particles, fixed = r.before, r.renumbered, r.particles, np.zeros(len(r.particles), dtype=bool)
    assert number is not None
    if before.boundary.active:
        particles, boundary = r.solved.walls.reassign(particles, r.mesh, None)
    else:
        boundary = renumbered(before.boundary, number, len(particles))
    fixed[number[before.fixed]] = True
    reference = int(number[before.reference]) if before.reference >= 0 else -1
    return r.with_(particles=particles, boundary=boundary, fixed=fixed, reference=reference)


def booked(r: RemeshingInSpace) -> RemeshingInSpace:
    """Book what restoring momentum has done to the energy."""
    r.account.add("momentum", r.particles, r.mesh, r.material)
    return r


def wet(cavities: Cavities, slipping: Slipping) -> None:
    """Set rates of particles of dry walls that a fluid has reached to those of its particles beside them; in place.

    Along the walls: there they were at rest, and would stop within a step what meets them.
    """
    new = np.full(len(cavities.x), -1)
    new[slipping.rows] = np.arange(len(slipping.rows))
    new[cavities.is_new] = -1
    cells = cavities.cells[touching(new >= 0, cavities.cells) & (cavities.label > 0)]
    row, corner = np.nonzero(new[cells] >= 0)
    here, rates = new[cells[row, corner]], cavities.fields[:, :6].reshape(-1, 2, 3)
    known = np.where(new[cells[row]] < 0, 1.0, 0.0)
    count = np.bincount(here, known.sum(axis=1), len(slipping.rows))
    total = np.zeros((len(slipping.rows), 2, 3))
    np.add.at(total, here, np.einsum("rk,rkia->ria", known, rates[cells[row]]))
    reached = np.flatnonzero(count)
    i = slipping.rows[reached]
    change = total[reached] / count[reached, None, None] - rates[i]
    cavities.fields[i, :6] += np.einsum("rab,rib->ria", slipping.along[reached], change).reshape(-1, 6)
