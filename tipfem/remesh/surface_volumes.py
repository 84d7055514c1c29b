"""Volumes and momenta where fluids end at a free surface: each connected component keeps its own.

A new mesh has other cells at the surface: an alpha-shape adds some where the surface folds or meets a wall, and leaves
some out where it is torn. What the cells of a step hold goes to their particles, in equal parts, and with them to the
components of the new mesh or into free flight. Each component is then given the volume of its particles, by moving its
surface; and one that touches no wall their momentum and angular momentum, by a rigid motion.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
from scipy.spatial import ConvexHull, cKDTree

from tipfem.backend.launch import launch
from tipfem.case.particles import Particles
from tipfem.geometry.plane.vectors import turned
from tipfem.linalg.parts import connected_parts
from tipfem.mesh.mesh import Mesh, Surface, simplex_measure, volume_gradient
from tipfem.physics.physics import Moved
from tipfem.physics.state import Solved
from tipfem.remesh.carry_kernels import carry
from tipfem.typing import Array

ROUNDS = 4  # of Newton's method in `restore_volumes` for cells that are too small
ROUNDS_OF_EXCESS = 12  # the same for cells that are too large
LARGEST_EXCESS = 1e-3  # of a component's cells, beyond its fluid, above which its particles are spray
ROUND_OFF = 1e-12  # of a component's volume: a smaller deficit is none
LARGEST_SHIFT = 0.05  # of a particle in a round [spacings]
IN_FRONT = 0.05  # distance from a wall of a particle that has passed through it [spacings]
ON_PLANE = 1e-3  # distance of wall particles from the plane of their wall [spacings]
LEAST = 0.5  # part of its volume that a cell keeps in a round


def kept_inside(particles: Particles) -> Particles:
    """Particles that passed through a wall of a convex tank in a step in front of it, at rest against it.

    Spray in free flight has no cell that would hold it off a wall.
    """
    x, h = particles.position, particles.spacing
    free = np.flatnonzero(~particles.wall)
    walls = x[particles.wall]
    if len(walls) <= particles.dimension or not len(free):
        return particles
    centre = walls.mean(axis=0)
    facets = ConvexHull((walls - centre) / h).equations
    facets = facets[np.unique(facets.round(9), axis=0, return_index=True)[1]]
    height = -((x[free] - centre) / h @ facets[:, :-1].T + facets[:, -1])
    flying = (height < 0).any(axis=1)
    if not flying.any():
        return particles
    index, height = free[flying], height[flying]
    kept = particles.copy()
    for facet, above in zip(facets, height.T, strict=True):
        n = -facet[:-1]
        gone = index[above < 0]
        kept.position[gone] += ((IN_FRONT - above[above < 0]) * h)[:, None] * n
        wall_velocity = _mean_velocity(particles, n, centre + facet[-1] * h * n)
        for values, rest in ((kept.velocity, wall_velocity), (kept.acceleration, 0.0 * wall_velocity)):
            across = (values[gone] - rest) @ n
            values[gone] -= np.minimum(across, 0.0)[:, None] * n
    return kept


def _mean_velocity(particles: Particles, normal: Array, point: Array) -> Array:
    """Mean velocity (d,) of the wall particles on the plane through a point [m/s]."""
    height = (particles.position - point) @ normal
    on = particles.wall & (np.abs(height) < ON_PLANE * particles.spacing)
    return np.asarray(particles.velocity[on].mean(axis=0)) if on.any() else np.zeros(len(normal))


class Carried(NamedTuple):
    """Quantities that N particles carry from one mesh to the next."""

    volume: Array  # (N,) [m^2, or m^3 in 3-D]
    mass: Array  # (N,) [kg]
    momentum: Array  # (N, d) [N s]
    moment: Array  # (N, k) angular momentum about the origin, k = 1 in 2-D and 3 in 3-D [N m s]
    force: Array  # (N, d) mass times acceleration [N]


def carried(before: Mesh, mass: Array, own_mass: Array, particles: Particles, leaves: Array) -> Carried:
    """Quantities that the particles take along from the cells of a step, on its mesh moved to its end.

    Masses are of cells (M,) and, used of those in no cell, particles (N,) [kg]. The mask ``leaves`` is of those that
    take nothing: relocated ones, and wall particles that are dry afterwards.
    """
    cells, surface, n = before.cells, before.surface, len(leaves)
    v, a, x = particles.velocity, particles.acceleration, particles.position
    per_mass = np.column_stack([np.ones(n), v, _cross(x, v), a])
    share, columns = before.parts_of(np.ones(len(cells))), per_mass.shape[1]
    total, lost = np.zeros((n, 1 + columns)), np.empty(len(cells), dtype=np.int32)
    given = map(np.ascontiguousarray, (cells, share, before.measure, mass, per_mass, leaves.view(np.int8)))
    lost = lost[: launch(carry, *given, total, lost, columns, cells.shape[1])]
    flying = surface.loose
    total[flying, 1:] += own_mass[flying, None] * per_mass[flying]
    remain = np.flatnonzero(~leaves & (before.used | surface.loose))
    own = surface.volume + surface.deficit
    gone = np.flatnonzero(leaves & (own != 0))
    if len(remain) and (len(lost) or len(gone)):
        # What no particle of a cell takes along goes to the nearest particle that takes something.
        tree = cKDTree(x[remain])
        if len(lost):
            nearest = remain[tree.query(x[cells[lost]].mean(axis=1))[1]]
            sums = [np.einsum("ek,ekc->ec", share[lost], per_mass[cells[lost]]), share[lost].sum(axis=1)]
            np.add.at(total[:, 0], nearest, before.measure[lost] * sums[1])
            np.add.at(total[:, 1:], nearest, mass[lost, None] * sums[0])
        if len(gone):
            nearest = remain[tree.query(x[gone])[1]]
            np.add.at(own, nearest, own[gone])
            np.add.at(total, nearest, total[gone])
            own[gone], total[gone] = 0.0, 0.0
    total[:, 0] += own
    d = particles.dimension
    return Carried(total[:, 0], total[:, 1], total[:, 2 : 2 + d], total[:, 2 + d : -d], total[:, -d:])


def carried_through(solved: Solved, start: Particles, leaves: Array, renumbered: Array | None = None) -> Carried:
    """Quantities that particles take from the cells of a step to a mesh; see `carried_past`."""
    before = solved.before
    # The volumes that the cells are to have: what the solve's tolerance has left of those is restored, too.
    moved = solved.mesh.with_(measure=before.mesh.measure * (1 + solved.growth))
    mass = before.material.density * before.mesh.measure
    return _renumbered(moved, mass, before.mass, start, leaves, renumbered)


def leave(mesh: Mesh, wall: Array, relocated: Array) -> Array:
    """(N,) mask of the particles of a new mesh that take nothing along: relocated ones, and dry ones on walls."""
    return np.asarray((relocated & ~mesh.surface.loose) | mesh.surface.dry(wall))


def carried_past(
    end: Moved, start: Mesh, mass: Array, own_mass: Array, leaves: Array, renumbered: Array | None
) -> Carried:
    """Results of `carried_through` where particles have come and gone, as at openings, and have other numbers.

    The end of the step is without what has left; masses are of its cells and particles [kg]. ``leaves`` (N',) masks new
    particles that take nothing along; ``renumbered`` (N,) has new numbers, -1 for those removed, None if none changes.
    """
    moved = start.with_(measure=simplex_measure(end.particles.position, start.cells, start.period))
    return _renumbered(moved, mass, own_mass, end.particles, leaves, renumbered)


def _renumbered(
    moved: Mesh, mass: Array, own_mass: Array, particles: Particles, leaves: Array, renumbered: Array | None
) -> Carried:
    """`carried`, by new numbers of the particles."""
    if renumbered is None:
        return carried(moved, mass, own_mass, particles, leaves)
    stays, gone = renumbered >= 0, np.ones(len(renumbered), dtype=bool)
    gone[stays] = leaves[renumbered[stays]]
    found = carried(moved, mass, own_mass, particles, gone)
    result = Carried(*(np.zeros((len(leaves), *values.shape[1:])) for values in found))
    for new, values in zip(result, found, strict=True):
        new[renumbered[stays]] = values[stays]
    return result


def with_momenta(
    solved: Solved, given: Carried, particles: Particles, mesh: Mesh, density: Array, mass: Array
) -> Particles:
    """The particles on a new mesh with the momenta of before: see `return_momenta` and `restore_momenta`."""
    before = solved.before
    old = before.mesh.cells, before.material.density * before.mesh.measure
    velocity = solved.particles.velocity
    given = without_spin_of_spray(given, particles.position, mesh)
    if solved.uniform:  # also of components that have just come apart, between which no force acts any longer
        given = given._replace(force=given.mass[:, None] * solved.force)
    particles = return_momenta(particles, velocity, old, (mesh.cells, density * mesh.measure), before.boundary.still)
    return restore_momenta(particles, mesh, mass, given)


def without_spin_of_spray(given: Carried, position: Array, mesh: Mesh) -> Carried:
    """Quantities of N particles, without the spin that particles in free flight take of the cells they had.

    A particle that flies alone does not turn. Its spin stays with the component that is nearest.
    """
    flying, index = np.flatnonzero(mesh.surface.loose), np.flatnonzero(mesh.surface.front)
    if not len(flying) or not len(index):
        return given
    moment, own = given.moment.copy(), _cross(position[flying], given.momentum[flying])
    nearest = index[cKDTree(position[index]).query(position[flying])[1]]
    np.add.at(moment, nearest, moment[flying] - own)
    moment[flying] = own
    return given._replace(moment=moment)


def _cross(x: Array, v: Array) -> Array:
    """x times v, (K, 1) in 2-D and (K, 3) in 3-D."""
    if x.shape[1] == 2:
        return np.asarray((x[:, 0] * v[:, 1] - x[:, 1] * v[:, 0])[:, None])
    return np.asarray(np.cross(x, v))


def restore_volumes(mesh: Mesh, wall: Array, volume: Array, spacing: float) -> Mesh:
    """The mesh with its surface moved so that its components have the volumes (N,) of their particles [m^d].

    Particles on the surface and off the walls are displaced along the gradient of the component's volume, in a few
    rounds. What cannot be restored so is the mesh's `Surface.deficit`. Cells that are too large hold fluid that there
    is not: they have more rounds than those that are too small, whose particles carry the rest as spray does. Where
    they stay too large even so, and no particle is below their surface, the component's particles go on as spray.
    """
    s = mesh.surface
    count, label = mesh.connected
    used = label >= 0
    wanted = np.bincount(label[used], volume[used], count)
    of_cell = label[mesh.cells[:, 0]]
    movable, limit = s.front & ~wall & used, LARGEST_SHIFT * spacing
    x, measure = mesh.position, mesh.measure
    for number in range(ROUNDS_OF_EXCESS):
        missing = wanted - np.bincount(of_cell, measure, count)
        if number >= ROUNDS:
            missing = np.minimum(missing, 0.0)
        if np.abs(missing).max(initial=0.0) <= 1e-14 * wanted.sum():
            break
        gradient = volume_gradient(mesh.moved(x), movable)
        square = (gradient**2).sum(axis=1)
        gram = np.bincount(label[movable], square[movable], count)
        factor = np.divide(missing, gram, out=np.zeros(count), where=gram > 0)
        shift = gradient * 0.0
        shift[movable] = factor[label[movable], None] * gradient[movable]
        length = np.linalg.norm(shift, axis=1)
        shift *= np.minimum(1.0, np.divide(limit, length, out=np.ones_like(length), where=length > 0))[:, None]
        for _ in range(ROUNDS):
            trial = Mesh(x + shift, mesh.cells, period=mesh.period).measure
            halved = trial < LEAST * measure
            if not halved.any():
                break
            shift[mesh.cells[halved]] = 0.0
        else:
            break
        x, measure = x + shift, trial
    missing = wanted - np.bincount(of_cell, measure, count)
    # In proportion to what they have of the cells: so none carries less than nothing.
    held, width = np.bincount(of_cell, measure, count), mesh.cells.shape[1]
    lacking = np.divide(missing, held, out=np.zeros(count), where=held > 0)
    deficit = np.bincount(mesh.cells.ravel(), np.repeat(lacking[of_cell] * measure / width, width), len(x))
    own = np.where(s.loose, volume, 0.0)
    restored = Mesh(x, mesh.cells, surface=Surface(s.front, s.pinned, s.loose, own, deficit), period=mesh.period)
    too_large = (lacking < -LARGEST_EXCESS) & (np.bincount(label[used & ~wall], minlength=count) > 0)
    too_large[label[used & ~s.front & ~wall]] = False
    return _without(restored, mesh.position, wall, volume, too_large, label) if too_large.any() else restored


def _without(mesh: Mesh, start: Array, wall: Array, volume: Array, given_up: Array, label: Array) -> Mesh:
    """A mesh without the components ``given_up`` (K,), whose particles fly on with the volume of them all.

    They were at ``start`` (N, d); the ``volume`` (N,) of their wall particles goes to those off the walls.
    """
    s, of = mesh.surface, label[mesh.cells[:, 0]]
    leaves = np.zeros(len(label), dtype=bool)
    leaves[label >= 0] = given_up[label[label >= 0]]
    flies = leaves & ~wall
    total, count, flying = (
        np.bincount(label[some], values[some], len(given_up))
        for some, values in ((leaves, volume), (flies, np.ones(len(wall))), (flies, volume))
    )
    own = s.volume.copy()
    own[flies] = volume[flies] + ((total - flying) / np.maximum(count, 1))[label[flies]]
    x = np.where(leaves[:, None], start, mesh.position)
    surface = Surface(s.front & ~leaves, s.pinned | leaves, s.loose | flies, own, np.where(leaves, 0.0, s.deficit))
    return Mesh(x, np.ascontiguousarray(mesh.cells[~given_up[of]]), surface=surface)


def mass_factor(mesh: Mesh) -> Array | None:
    """Mass of the fluid in the cells of each component, over that of their own volume, (M,); None where all are 1.

    Cells of particles that have just landed are smaller than the fluid that the particles carry. With its mass they are
    heavier, by one part in a component, so that no momentum appears or vanishes with the volume.
    """
    deficit, cells = mesh.surface.deficit, mesh.cells
    if not deficit.any():
        return None
    width = cells.shape[1]
    held = np.bincount(cells.ravel(), np.repeat(mesh.measure / width, width), len(deficit))
    lacking = (deficit / np.maximum(held, 1e-300))[cells[:, 0]]
    return np.where(np.abs(lacking) > ROUND_OFF, 1 + lacking, 1.0)


def return_momenta(
    particles: Particles, velocity: Array, old: tuple[Array, Array], new: tuple[Array, Array], held: Array
) -> Particles:
    """The particles, with the momentum that remeshing took from them in patches of cells that have changed.

    A flip of an edge gives mass to two particles and takes it from two others, which have other velocities. Connected
    cells that have changed are a patch; what its momentum has lost goes to its particles, by one velocity for all. A
    patch with a particle that is held (N,) keeps its velocities: the wall takes up the momentum. And no patch gets more
    energy than it has lost. ``velocity`` (N, d) is before remeshing; ``old`` and ``new`` are cells and their masses
    [kg].
    """
    n, split, d = len(held), len(old[0]), particles.dimension
    both = np.sort(np.concatenate([old[0], new[0]]).astype(np.int64), axis=1)
    _, number, count = np.unique(both, axis=0, return_inverse=True, return_counts=True)
    changed = count[number.ravel()] == 1
    cells, mass = np.concatenate([old[0], new[0]])[changed], np.concatenate([old[1], new[1]])[changed]
    if not len(cells):
        return particles
    is_new = np.flatnonzero(changed) >= split
    patch = connected_parts(n, np.repeat(cells[:, 0], d), cells[:, 1:].ravel())[1]
    of, patches, among = patch[cells[:, 0]], patch.max() + 1, np.unique(cells)
    v = np.where(is_new[:, None, None], particles.velocity[cells], velocity[cells])
    # Mass, momentum and twice the kinetic energy of the patches, before and after.
    sums = np.column_stack([mass, mass[:, None] * v.mean(axis=1), mass * (v**2).sum(axis=2).mean(axis=1)])
    before, after = (
        np.stack([np.bincount(of[part], column[part], patches) for column in sums.T], axis=1)
        for part in (~is_new, is_new)
    )
    ratio = np.divide(after[:, 0], before[:, 0], out=np.zeros(patches), where=before[:, 0] > 0)
    free = ratio > 0
    free[patch[among[held[among]]]] = False
    # All particles of a patch move, with masses that they have of other cells, too.
    own = particles_mass(new, n)
    total, momentum = (
        np.stack([np.bincount(patch[among], column[among], patches) for column in values.T], axis=1)
        for values in (own[:, None], own[:, None] * particles.velocity)
    )
    change = np.where(free[:, None], ratio[:, None] * before[:, 1:-1] - after[:, 1:-1], 0.0)
    change /= np.maximum(total, 1e-300)
    # s of it: 2 s P . change + s^2 M |change|^2 is at most the energy lost.
    lost = np.maximum(ratio * before[:, -1] - after[:, -1], 0.0)
    linear, square = (momentum * change).sum(axis=1), total[:, 0] * (change**2).sum(axis=1)
    root = np.sqrt(linear**2 + square * lost)
    part = np.divide(root - linear, square, out=np.ones(patches), where=square > 0)
    moved = particles.velocity.copy()
    some = among[own[among] > 0]
    moved[some] += (np.clip(part, 0.0, 1.0)[:, None] * change)[patch[some]]
    return particles.shallow_copy(velocity=moved)


def particles_mass(mesh: tuple[Array, Array], n: int) -> Array:
    """(N,) lumped mass of n particles from cells (M, d + 1) and their masses (M,) [kg]."""
    cells, mass = mesh
    width = cells.shape[1]
    return np.asarray(np.bincount(cells.ravel(), np.repeat(mass / width, width), n))


def _rotation(arm: Array, mass: Array, of: Array, moment: Array) -> Array:
    """Velocities (K, d) of rigid rotations by which components gain the angular momentum ``moment`` (C, k) [N m s]."""
    count, square = len(moment), (arm**2).sum(axis=1)
    if arm.shape[1] == 2:
        inertia = np.bincount(of, mass * square, count)
        spin = np.divide(moment[:, 0], inertia, out=np.zeros(count), where=inertia > 0)[of]
        return np.asarray(spin[:, None] * turned(arm))
    tensor = mass[:, None, None] * (square[:, None, None] * np.eye(3) - np.einsum("ki,kj->kij", arm, arm))
    inertia = np.stack([np.bincount(of, column, count) for column in tensor.reshape(-1, 9).T], axis=1)
    inverse = np.linalg.pinv(inertia.reshape(-1, 3, 3), rcond=1e-9)
    return np.cross(np.einsum("kij,kj->ki", inverse, moment)[of], arm)


def balanced(solved: Solved) -> Solved:
    """The step, after which components of the fluids that touch no wall have the momenta that they must.

    Only gravity and body forces change them. Newton's tolerance leaves an error of the momentum, and the time
    integration one of the angular momentum: it takes positions, velocities and forces at different times, so that the
    sum of x times m v changes by a part to dt^3 in a step of a smooth flow. Each component is given one velocity and
    one acceleration, so that

        sum m (v + (1/2 - alpha_f) dt a) grows by dt sum m b,    sum m a_alpha = sum m b,

    and a rigid rotation, by which its angular momentum about the centre of mass is that of before. The latter only
    where b is uniform and steady and has no moment: otherwise the moment in the step is not known to second order. Of
    rings in an axisymmetric flow only what is along z is balanced.
    """
    before, after, scheme = solved.before, solved.particles, solved.scheme
    count, label = before.mesh.connected
    held = np.zeros(count + 1, dtype=bool)
    held[label[after.wall]] = held[-1] = True  # the last one is that of the particles in no cell, -1
    some = np.flatnonzero(~held[label])
    if not len(some):
        return solved
    of, m, shift = label[some], before.mass[some], (0.5 - scheme.alpha_f) * scheme.dt
    weight = np.maximum(np.bincount(of, m, count), 1e-300)[:, None]

    def mean(values: Array) -> Array:
        return np.stack([np.bincount(of, m * column, count) for column in values.T], axis=1) / weight

    x, v, a = (getattr(before.particles, name)[some] for name in ("position", "velocity", "acceleration"))
    end, velocity, acceleration = after.position[some], after.velocity[some], after.acceleration[some]
    force = mean(solved.force[some])
    rate = scheme.next_rate(force, mean(a))
    wanted = mean(v) + shift * mean(a) + scheme.dt * force - shift * rate
    acceleration = acceleration + (rate - mean(acceleration))[of]
    velocity = velocity + (wanted - mean(velocity))[of]
    if before.mesh.period.axial:  # rings: their hoops change the momentum along r, and they have no spin
        for values, solve in ((velocity, after.velocity), (acceleration, after.acceleration)):
            values[:, 0] = solve[some, 0]
    elif solved.uniform:
        arm, spin = end - mean(end)[of], mean(_cross(x - mean(x)[of], v - mean(v)[of]))
        velocity = velocity + _rotation(arm, m, of, weight * (spin - mean(_cross(arm, velocity - wanted[of]))))
    new = after.copy()
    new.velocity[some], new.acceleration[some] = velocity, acceleration
    return dataclasses.replace(solved, particles=new)


def restore_momenta(particles: Particles, mesh: Mesh, mass: Array, given: Carried) -> Particles:
    """The particles on a new mesh, with the momenta of those components that touch no wall as ``given``."""
    count, label = mesh.connected
    used = label >= 0
    held = np.zeros(max(count, 1), dtype=bool)
    held[label[used & particles.wall]] = True
    some = used.copy()
    some[used] = ~held[label[used]]
    velocity, acceleration = particles.velocity.copy(), particles.acceleration.copy()
    alone = mesh.surface.loose & (given.mass > 0)
    velocity[alone] = given.momentum[alone] / given.mass[alone, None]
    if not some.any():
        return particles.shallow_copy(velocity=velocity)
    of = label[some]

    def total(values: Array) -> Array:
        return np.stack([np.bincount(of, column, count) for column in values.T], axis=1)

    m, x, v = mass[some, None], particles.position[some], particles.velocity[some]
    weight = np.bincount(of, mass[some], count)
    whole = np.maximum(weight, 1e-300)[:, None]
    # The masses have changed a little too, by what is yet to be restored of the volume: velocities are kept.
    ratio = weight / np.maximum(np.bincount(of, given.mass[some], count), 1e-300)
    centre = total(m * x) / whole
    change = (ratio[:, None] * total(given.momentum[some]) - total(m * v)) / whole
    a = particles.acceleration[some]
    force = (ratio[:, None] * total(given.force[some]) - total(m * a)) / whole
    if mesh.period.axial:  # see `balanced`
        change[:, 0] = force[:, 0] = 0.0
    arm = x - centre[of]
    moved = v + change[of]
    if not mesh.period.axial:
        lost = ratio[:, None] * total(given.moment[some]) - total(m * _cross(x, moved))
        moved = moved + _rotation(arm, mass[some], of, lost)
    velocity[some], acceleration[some] = moved, a + force[of]
    return particles.shallow_copy(velocity=velocity, acceleration=acceleration)
