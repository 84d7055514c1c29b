"""Remeshing with interfaces along edges: the triangulation moves with the particles and is repaired in place.

Every triangle belongs to one fluid, and so do those that replace it after flips, collapses and splits of edges. So
remeshing moves volume from one fluid to another only where an interface is coarsened, slides along a wall, or a film
breaks; `volumes` then restores the volumes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from tipfem.backend.launch import launch
from tipfem.case.numerics import FittedRule
from tipfem.case.particles import Particles
from tipfem.errors import TriangulationError
from tipfem.geometry.place import along_curve
from tipfem.geometry.plane.curves import old_ends, restored
from tipfem.mesh.components import ON_INTERFACE
from tipfem.mesh.mesh import Mesh, as_far_as_cells_bear
from tipfem.mesh.relabelled import Relabelled, SideEnergies
from tipfem.remesh.repair_account import NoAccount
from tipfem.remesh.triangles import films_contacts
from tipfem.remesh.triangles.edge_operations import ACCELERATION, OFF_WALLS, SLIDES, TARGET, VELOCITY
from tipfem.remesh.triangles.spray import Spray
from tipfem.remesh.triangles.triangulation import Crowding, Triangulation
from tipfem.remesh.volumes import Places, areas, restore_volumes, with_components
from tipfem.scratch import copied, filled, scratch
from tipfem.timers import timer
from tipfem.typing import Array

# Distance of a new particle from others, in target spacings; less where there is no such site.
ROOM = (0.6, 0.5, 0.4, 0.3, 0.2, 0.1)
# Where the number of particles follows the targets: distance of new particles from others, and factor on the length of
# edges they are inserted into. Several rounds, because a round changes no triangle twice.
WIDER = 1.15  # factor on the rule's limits then, with which N is within 5 % of that where it is kept
ROUNDS = ((0.6, 1.0), (0.6, 1.0), (0.5, 1.2), (0.4, 1.4), (0.3, 1.6))
REFINED = 3  # times that these are gone through where a drop is to come
# Height over a long interface edge, in target spacings, below which a particle is taken to be on it.
SLIVER = 0.05
GAP = 0.35  # of a contact to the next particles on its wall, in target spacings
RESTORED = 3.5  # distance within which volumes are restored first, in target spacings
LEAST = 0.02  # twice the smallest area that a change may leave, in target spacings squared


class Repaired(NamedTuple):
    """The result of a repair of N particles and their triangles."""

    particles: Particles  # the state, on N' particles
    mesh: Mesh  # the triangles
    relocated: Array  # (N',) mask of the particles that were relocated or are new
    renumbered: Array | None = None  # (N,) new number of each particle, -1 for those removed; None if no number changes
    # sides of the cells that changed their fluid, as where films break; None for none
    relabelled: Relabelled | None = None


def repair(
    particles: Particles,
    mesh: Mesh,
    density: Array,
    fixed: Array,
    rule: FittedRule,
    *,
    slippery: Array | None = None,
    total: Array | None = None,
    graded: bool = False,
    account: NoAccount | None = None,
    keep_cells: bool = False,
    energies: SideEnergies | None = None,
    spray: Spray | None = None,
    curved: Array | None = None,
    put_on_curves: Callable[[Array, Array, Array], Array] | None = None,
    at_rest: float = 0.0,
    closed: Callable[[Array, Array, Array], Array] | None = None,
    sort: bool = False,
) -> Repaired:
    """Remesh particles that have moved.

    Args:
        particles: the moved state on N particles with their target spacings; which of them are wall particles may
            change.
        mesh: the triangles they moved with, none inverted.
        density: (F,) of the fluids [kg/m^3].
        fixed: (N,) particles that must stay, such as those in corners of the tank.
        rule: limits for changes of the triangulation.
        slippery: (N,) mask of wall particles that slide with the fluid; where interfaces end there, they slide, too.
        total: (F,) volume that each fluid is to have afterwards [m^2]; by default changes of volume
            by the solve stay, and only those by remeshing are undone.
        graded: whether the number of particles follows the targets. Otherwise N is kept: particles that crowd others
            are relocated.
        account: of what each kind of repair adds to energy and momentum; none by default.
        keep_cells: whether edges need not be flipped, nor particles relocated; interfaces and volumes are always
            repaired, and what crowds a film that breaks.
        energies: of the sides of cells, by which films may break; None where only their thickness decides.
        spray: particles in no cell of a fluid, where there is empty space, a fluid without density; None without it.
        curved: (N,) mask of the particles on curves of a closed tank and of what is in it. Those left there when one is
            removed or new are moved so that the fluids have as much room as before; none by default.
        put_on_curves: returns the positions with those of new particles of curves put there, see
            `tipfem.physics.physics.Physics.put_on_curves`; by default they stay on chords.
        at_rest: displacement in each direction below which particles have not moved [m]. Interfaces among these stay,
            however thin what they bound is; none by default.
        closed: tells which cells of empty space are closed, see `tipfem.physics.physics.Physics.closed`.
        sort: whether particles and cells get new numbers, in the order of their places.

    Raises:
        TriangulationError: the repair did not terminate, or left a triangle without area.
    """
    moved = areas(particles.position, mesh)
    if moved.min(initial=1.0) <= 0:
        raise TriangulationError("a triangle was inverted before it could be repaired")
    held = np.asarray(fixed, dtype=bool)
    with timer("flips"):
        t = Triangulation.of(particles, mesh, density, moved, np.inf if keep_cells else rule.flip_tolerance)
        if slippery is not None:
            t.wall[slippery] = SLIDES
        account = account or NoAccount()
        account.observe(t)
        flips = t.make_delaunay(rule.flip_tolerance, stale_only=True)
    fluid = copied(t.fluid, "repair.fluid")
    sticks = held if slippery is None else np.logical_or(held, slippery, out=scratch("repair.sticks", len(held), bool))
    path = np.subtract(particles.position, mesh.position, out=scratch("repair.path", particles.position.shape))
    path = mesh.period.shortest(path)
    stays, still = scratch("repair.stays", len(held), np.int8), scratch("repair.still", len(fluid), np.int8)
    # What crowds others where nothing around has moved is no worse than before.
    if launch(films_contacts.find_rest, path, t.cells, t.fluid, stays, still, at_rest):
        held = held | stays.view(bool)
    with timer("interface repair"):
        broken, taken = t.repair_interfaces(
            sticks,
            path,
            reach=rule.contact_reach,
            gap=GAP,
            least_area=LEAST,
            film=rule.thin_film,
            sliver=SLIVER,
            energies=energies,
            still=still,
            closed=closed,
        )
        changed = None
        if broken or taken:
            there = Mesh(t.state[:, :2], t.cells, t.fluid, period=mesh.period).with_(neighbours=t.neighbours)
            changed = Relabelled.of(there, fluid)
        if taken:
            flips += taken + t.make_delaunay(rule.flip_tolerance, stale_only=True)
    changes = np.not_equal(t.fluid, fluid, out=scratch("repair.changes", len(fluid), bool))
    places = [t.middles(np.flatnonzero(changes))]
    if spray is not None:
        with timer("spray"):
            broken += spray.settle(t, fluid)
            places.append(spray.places)
    with timer("relocation"):
        if keep_cells and not (broken or taken):
            relocated = np.zeros(len(held), dtype=bool)
        else:
            relocated = _follow_targets(t, held, rule) if graded else _relocate_crowded(t, held, rule)
    t.compact()
    order = None
    if sort:
        order = np.argsort(along_curve(t.state[:, :2], particles.spacing), kind="stable")
        t.sort_cells(order)
    if spray is not None:
        spray.rejoin(t)
    _put_on_curves(t, relocated, particles.wall, curved, put_on_curves, moved.sum())
    place = copied(t.state[:, :2], "repair.position")
    new = Mesh(place, t.cells, t.fluid, period=mesh.period)
    new = new.with_(neighbours=t.neighbours)
    slides = filled(False, "repair.slides", len(t.state), bool)
    if slippery is not None:
        here = slides[: len(held)]
        np.greater(slippery, np.logical_or(held, relocated[: len(held)], out=here), out=here)
    with timer("volumes"):
        components = with_components(mesh, len(density)).components
        assert components is not None
        left = np.flatnonzero(relocated[: len(held)])
        places.append(particles.position[left[components.mark[left] & ON_INTERFACE > 0]])
        reach = np.multiply(RESTORED, t.state[:, TARGET], out=scratch("repair.reach", len(t.state)))
        changes = Places(np.concatenate(places), reach)
        limit = 0.05 * particles.spacing
        gained = None if spray is None else np.append(spray.landed, 0.0)
        if spray is not None and total is not None:
            carried = np.bincount(spray.fluid[spray.loose], spray.volume[spray.loose], minlength=len(total))
            total = np.append(total - carried, 0.0)
        free = density == 0
        new = restore_volumes(new, mesh, moved, relocated, total, limit, len(density), slides, changes, free, gained)
    account.add_mesh("volumes", new, t.state[:, VELOCITY:ACCELERATION])
    position = new.period.wrapped(new.position.copy() if new.position is place else new.position)
    if not (sort or flips or broken or relocated.any() or (position != particles.position).any()):
        return Repaired(particles, mesh.moved(particles.position, moved), relocated)
    renumbered = None
    if sort or len(t.removed) or len(t.state) > len(particles):
        numbers, kept = t.drop_removed(order)
        position, relocated = position.take(kept, axis=0), relocated.take(kept)
        renumbered = numbers[: len(particles)]
        assert new.components is not None
        new = new.with_(components=new.components.renumbered(kept))
    return Repaired(*_taken(t, particles, new, position), relocated, renumbered, changed)


def _put_on_curves(
    t: Triangulation,
    relocated: Array,
    wall: Array,
    curved: Array | None,
    put_on_curves: Callable[[Array, Array, Array], Array] | None,
    area: float,
) -> None:
    """Put new particles of walls on their curves, as far as cells bear; and keep the area, see `repair`."""
    if put_on_curves is None and (curved is None or not curved.any()):
        return
    is_new = relocated & (t.wall != OFF_WALLS)
    is_new[t.removed] = False
    if not (is_new.any() or relocated[: len(wall)][wall].any()):
        return
    edges = hull_edges(Mesh(t.state[:, :2], t.cells).with_(neighbours=t.neighbours))
    if put_on_curves is not None and is_new.any():
        position = np.ascontiguousarray(t.state[:, :2])
        goal = put_on_curves(position, *old_ends(edges, is_new))
        moves = (goal != position).any(axis=1)
        if moves.any():
            t.state[:, :2] = as_far_as_cells_bear(Mesh(position, t.cells, period=t.period), position, goal, moves)
    if curved is not None and curved.any():
        left = np.zeros(len(t.state), dtype=bool)
        left[: len(wall)] = curved & ~relocated[: len(wall)]
        t.state[:, :2] = restored(t.state[:, :2], edges, left, area, t.period)


def _relocate_crowded(t: Triangulation, held: Array, rule: FittedRule) -> Array:
    """Remove particles that crowd others and insert them into large triangles; return their mask (N,)."""
    limits = Crowding(
        too_close=rule.too_close,
        along_interface=rule.too_close_along_interface,
        to_interface=rule.too_close_to_interface,
        film=rule.thin_film,
        least_area=LEAST,
        long_edge=rule.long_edge,
    )
    edges, needed = t.coarsen(held, limits, most=len(held))
    if needed > len(t.removed):
        # No crowded particle is left: remove particles where they are closest to each other.
        edges, _ = t.coarsen(held, limits._replace(too_close=rule.removable), most=needed - len(t.removed))
    relocated = filled(False, "", len(held), bool)
    relocated[t.removed] = True
    for room in ROOM:
        if not len(t.removed):
            break
        t.refine(edges, room)
        t.make_delaunay(rule.flip_tolerance, stale_only=True)
        if len(t.removed):
            edges, _ = t.longest_edges(rule.long_edge, t.candidates())
    if len(t.removed):
        raise TriangulationError(f"{len(t.removed)} particles that crowded others have no insertion site")
    return relocated


def _follow_targets(t: Triangulation, held: Array, rule: FittedRule) -> Array:
    """Remove particles where there are too many, and insert some where there are too few; return their mask (N',).

    Those that are not inserted stay in ``t.removed``.
    """
    before = len(held)
    limits = Crowding(
        too_close=WIDER * rule.too_close,
        along_interface=WIDER * rule.too_close_along_interface,
        to_interface=rule.too_close_to_interface,
        film=rule.thin_film,
        least_area=LEAST,
        long_edge=WIDER * rule.long_edge,
    )
    edges, _ = t.coarsen(held, limits, most=before, every_edge=True)
    removed = t.removed
    for number, (room, longer) in enumerate(ROUNDS):
        if number:
            edges = t.long_edges(longer * WIDER * rule.long_edge)
        if not len(edges):
            break
        t.provide(len(edges))
        t.refine(edges, room)
        t.make_delaunay(rule.flip_tolerance, stale_only=True)
    relocated = np.zeros(len(t.state), dtype=bool)
    relocated[removed] = True
    relocated[before:] = True
    return relocated


def refined(particles: Particles, mesh: Mesh, density: Array, rule: FittedRule) -> tuple[Particles, Mesh]:
    """Particles (N',) and mesh, with new ones behind the N others where edges within a fluid are longer than targets.

    Args:
        particles: N with their target spacings.
        mesh: their triangles, with fluids.
        density: (F,) of the fluids [kg/m^3].
        rule: limits for changes of the triangulation.
    """
    t = Triangulation.of(particles, mesh, density, mesh.measure, rule.flip_tolerance)
    for room, longer in ROUNDS * REFINED:
        edges = t.long_edges(longer * WIDER * rule.long_edge)
        edges = edges[t.neighbours[edges // 3, edges % 3] >= 0]
        if not len(edges):
            break
        t.provide(len(edges))
        t.refine(edges, room)
        t.make_delaunay(rule.flip_tolerance, stale_only=True)
    t.compact()
    t.drop_removed()
    position = t.state[:, :2].copy()
    new = Mesh(position, t.cells, t.fluid, period=mesh.period).with_(neighbours=t.neighbours)
    new = with_components(new.with_(measure=areas(position, new)), len(density))
    return _taken(t, particles, new, position)


def _taken(t: Triangulation, particles: Particles, new: Mesh, position: Array) -> tuple[Particles, Mesh]:
    """State, still without fluids, and mesh of a repaired triangulation at its last positions (N', 2).

    The mesh takes over what ``new`` has computed; see `repair` for errors.
    """
    if new.measure.min(initial=1.0) <= 0:
        corner = position[t.cells[np.argmin(new.measure), 0]].tolist()
        raise TriangulationError(f"the triangle at {corner} has no area after the repair")
    state = particles.shallow_copy(
        position=position,
        wall=copied(t.wall, "", bool),
        fluid=filled(0, "", len(position), np.int32),
        **t.particle_fields(),
    )
    mesh = Mesh(position, t.cells, t.fluid, components=new.components, period=new.period)
    return state, mesh.with_(neighbours=t.neighbours, measure=new.measure)


def with_fluids(mesh: Mesh, particles: Particles, rank: Array) -> Mesh:
    """Assign to each triangle of a first mesh its fluid: the lightest of its particles' fluids.

    So interfaces run along edges through the outermost particles of the heavier fluid.

    Args:
        mesh: Delaunay triangles.
        particles: their particles, walls with a fluid too.
        rank: (F,) of the fluids from the lightest, 0, to the heaviest.
    """
    fluid = np.argsort(rank)[rank[particles.fluid[mesh.cells]].min(axis=1)].astype(np.int32)
    return with_components(Mesh(mesh.position, mesh.cells, fluid, period=mesh.period), len(rank))


def particle_fluid(mesh: Mesh, count: int, rank: Array) -> Array:
    """(N,) the heaviest fluid at each of ``count`` particles."""
    fluid, components = filled(0, "", count, np.int32), with_components(mesh, len(rank)).components
    assert components is not None
    for f in np.argsort(rank):
        at = components.at_particle[f]
        np.copyto(fluid, f, where=np.greater_equal(at, 0, out=scratch("repair.at", count, bool)))
    return fluid


def hull_edges(mesh: Mesh) -> Array:
    """(E, 2) the particles along the hull, two and two, with the mesh on their left."""
    return np.stack(mesh.hull[2:], axis=1)


def hull_corners(mesh: Mesh) -> Array:
    """(N,) mask of the particles at corners of the hull."""
    a, b = hull_edges(mesh).T
    direction = mesh.sides(a, b)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    total = np.zeros_like(mesh.position)
    np.add.at(total, a, direction)
    np.add.at(total, b, direction)
    on = np.zeros(len(mesh.position), dtype=bool)
    on[a] = True
    return np.asarray(on & (np.linalg.norm(total, axis=1) < 2 - 1e-9))
