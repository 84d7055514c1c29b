"""Volumes of fluids whose interfaces run along edges: each connected component of a fluid keeps its own.

The constraint J = 1 holds at particles, for the elements around them together. At an interface these belong to two
fluids, and one may lose what the other gains: no equation distinguishes them, and no source can. So the deficit of
every connected component is measured after each step, and restored by moving the interfaces.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import minres

from tipfem.backend.arrays import sums_by_label
from tipfem.backend.launch import launch
from tipfem.geometry.period import Period, no_period
from tipfem.mesh.components import Components
from tipfem.mesh.mesh import Mesh
from tipfem.remesh import volume_kernels as kernels
from tipfem.scratch import copied, filled, owned, scratch
from tipfem.typing import Array

# Least angle between an interface and a wall at a contact that moves with the interface [rad].
STEEP = np.pi / 3

# Of Newton's method, see `move_interfaces`; and with empty space, in which one step may close a large gap.
ROUNDS, ROUNDS_AT_SURFACES = 4, 16

# Components whose volumes a dense matrix restores, in time K^3; and the least part of the largest singular value, or
# of the largest diagonal entry, that counts.
FEW, TRUNCATED = 128, 1e-10


class Places(NamedTuple):
    """Places where remeshing has changed the volumes of fluids."""

    position: Array  # (P, 2) of the places [m]
    reach: Array  # (N,) distance from a place within which each particle is moved to restore them [m]

    def beside(self, mesh: Mesh, particles: Array) -> Array:
        """Particles of a mesh within reach of a place, among some given by their numbers."""
        apart = mesh.period.shortest(mesh.position[particles][:, None] - self.position)
        near = np.einsum("npk,npk->np", apart, apart) < self.reach[particles, None] ** 2
        return np.asarray(particles[near.any(axis=1)])


def areas(position: Array, mesh: Mesh, name: str = "") -> Array:
    """(M,) signed areas of triangles at a ``position`` (N, 2) [m^2]; new or in memory of a ``name``, see `scratch`."""
    measure = scratch(name, len(mesh.cells))
    given = np.ascontiguousarray(position), np.ascontiguousarray(mesh.cells), mesh.period.array
    launch(kernels.measure_cells, *given, measure, work=(len(measure), kernels.CELL))
    return measure


def label_components(
    position: Array, cells: Array, neighbours: Array, fluid: Array, fluids: int, period: Period | None = None
) -> tuple[Components, Array, Array]:
    """The connected components of fluids.

    Args:
        cells: (M, d + 1), in 2-D see `edge_operations.TriangleArrays`.
        neighbours: (M, d + 1) of the cells.
        fluid: (M,) of the cells; removed ones (fluid -1) belong to no component, label -1.
        fluids: F.
        period: of the positions; none by default.

    Returns:
        The components; (M,) measures of the cells, undefined for removed ones, and (K,) those of the components [m^d].
    """
    work = len(cells), kernels.CELL
    fluid, period = np.ascontiguousarray(fluid, dtype=np.int32), no_period(2) if period is None else period
    cells, (label, mark, measure), (number, of, near), volume = _joined(position, cells, neighbours, fluid, period)
    count = len(volume)
    # By size, not by first cells: whatever follows must not depend on an order of cells.
    order = np.argsort(-volume, kind="stable")
    rank, movable, at = np.empty(count, np.int32), np.zeros(count, bool), owned((fluids, len(mark)), np.int32)
    rank[order] = np.arange(count, dtype=np.int32)
    places = cells, fluid, mark, number, rank, label, movable.view(np.int8), near, at, cells.shape[1] - 1
    beside = launch(kernels.place_components, *places, work=work)
    return Components(label, of[order], at, mark, movable, near[:beside].copy()), measure, volume[order]


def _joined(
    position: Array, cells: Array, neighbours: Array, fluid: Array, period: Period
) -> tuple[Array, tuple[Array, Array, Array], Array, Array]:
    """Components by their lowest cells, see `label_components`.

    Returns:
        The cells; (M,) the lowest one of each one's component, (N,) marks and (M,) measures; (3, M) numbers of the
        lowest cells, the K components' fluids and room for further ones, and (K,) measures.
    """
    elements, work = len(cells), (len(cells), kernels.CELL)
    label, measure, mark = owned(elements, np.int32), owned(elements), filled(0, "", len(position), np.int32)
    cells, neighbours = (np.ascontiguousarray(array, dtype=np.int32) for array in (cells, neighbours))
    given = np.ascontiguousarray(position), cells, neighbours, fluid, period.array
    launch(kernels.join_cells, *given, label, mark, measure, cells.shape[1] - 1, work=work)
    number, volume = scratch("components", (3, elements), np.int32), scratch("components.volume", elements)
    count = launch(kernels.number_components, fluid, label, measure, number[0], number[1], volume)
    return cells, (label, mark, measure), number, volume[:count]


def component_numbers(position: Array, cells: Array, neighbours: Array, fluid: Array) -> tuple[Array, int]:
    """The component (M,) of each cell, numbered by their lowest cells, -1 for removed ones, and how many there are."""
    _, (label, _, _), number, volume = _joined(position, cells, neighbours, fluid, no_period(2))
    return np.where(fluid >= 0, number[0][label], -1), len(volume)


def with_components(mesh: Mesh, fluids: int) -> Mesh:
    """The mesh with the components of ``fluids`` fluids labelled; the same mesh if it has them.

    Raises:
        ValueError: the cells of the mesh have no fluids.
    """
    if mesh.components is not None and len(mesh.components.at_particle) == fluids:
        return mesh
    if mesh.fluid is None:
        raise ValueError("components: the cells of this mesh have no fluids")
    found = label_components(mesh.position, mesh.cells, mesh.neighbours, mesh.fluid, fluids, mesh.period)
    return mesh.with_(components=found[0])


def restore_volumes(
    new: Mesh,
    old: Mesh,
    moved: Array,
    relocated: Array,
    total: Array | None,
    limit: float,
    fluids: int,
    slides: Array | None = None,
    places: Places | None = None,
    free: Array | None = None,
    gained: Array | None = None,
) -> Mesh:
    """The mesh ``new`` with its interfaces moved so that each component has its prescribed volume.

    What collapses and broken films have changed is restored close to these places first, as far as particles may move:
    the fluid that comes back there has the velocity of what was lost. The rest is restored along all interfaces.

    Args:
        new: the triangles after remeshing, with their fluids.
        old: the mesh of the step, at its start.
        moved: (M,) areas of the old triangles after the step's motion [m^2].
        relocated: (N,) mask of the particles that were relocated.
        total: (F,) volume that each fluid is to have [m^2]; by default its volume after the motion.
        limit: of a particle's displacement in a round [m].
        fluids: F.
        slides: (N,) mask of the particles that may move along their walls; none by default.
        places: where remeshing has changed the volumes of fluids; nowhere by default.
        free: (F,) mask of fluids whose volume is what the others leave, as of empty space; none by default.
        gained: (F,) volume that has come from spray, less what has become spray [m^2]; none by default.

    Returns:
        The same triangles at the new positions, with areas and components.
    """
    assert old.fluid is not None
    assert new.fluid is not None
    components, measure, volume = label_components(
        new.position, new.cells, new.neighbours, new.fluid, fluids, new.period
    )
    before = with_components(old, fluids).components
    assert before is not None
    after_motion = sums_by_label(old.fluid, moved, fluids)
    if gained is not None:
        after_motion = after_motion + gained
    none = np.zeros(fluids, dtype=bool) if free is None else free
    left = none[components.fluid] if none.any() else None  # components without a volume of their own
    new = new.with_(measure=measure, components=components)
    if places is not None and len(places.position):
        wanted = apportion(volume, np.zeros(len(volume)), components.fluid, after_motion, components.movable, none)
        new = move_interfaces(new, volume, wanted, limit, places=places, left=left)
        volume = sums_by_label(components.label, new.measure, len(volume))
    if total is None:
        deficit: Array = np.zeros(len(before))
        total = after_motion
    else:
        lost = np.subtract(old.measure, moved, out=scratch("volumes.lost", len(moved)))
        deficit = sums_by_label(before.label, lost, len(before))
    due = transfer_deficits(before.at_particle, components.at_particle, deficit, relocated, len(volume))
    wanted = apportion(volume, due, components.fluid, total, components.movable, none)
    return move_interfaces(new, volume, wanted, limit, slides, left=left)


def transfer_deficits(old: Array, new: Array, deficit: Array, relocated: Array, count: int) -> Array:
    """Deficits of the components of a new mesh, from those of the old one.

    The deficit of a component is divided equally among its particles, so that components may merge and split.

    Args:
        old: (F, N) `Components.at_particle`.
        new: the same after remeshing, possibly of more particles.
        deficit: (K,) of the old components [m^2].
        relocated: (N,) mask of particles that were relocated; they have no part of the deficit.
        count: K', number of new components.

    Returns:
        (K',) deficits of the new components [m^2]; the deficit of a component that vanished is dropped.
    """
    result, parts = np.zeros(count), np.zeros(len(deficit), dtype=np.int32)
    launch(kernels.transfer_deficits, old, new, relocated.view(np.int8), deficit, parts, result)
    return result


def apportion(
    volume: Array, deficit: Array, fluid: Array, total: Array, movable: Array, free: Array | None = None
) -> Array:
    """Volumes (K,) that components are to have: own deficits restored, the rest of a fluid's apportioned by size.

    Args:
        volume: (K,) of the components [m^2].
        deficit: (K,) of the components [m^2].
        fluid: (K,) of the components.
        total: (F,) that each fluid is to have [m^2].
        movable: (K,) mask of components whose surface can move; others keep their volume.
        free: (F,) mask of the fluids that have what the others leave; none by default.
    """
    wanted = np.where(movable, np.maximum(volume + deficit, 0.5 * volume), volume)
    has = np.bincount(fluid, weights=wanted, minlength=len(total))
    part = np.bincount(fluid, weights=wanted * movable, minlength=len(total))
    if not part.any():
        return wanted
    lack = np.where(part > 0, total - has, 0.0)
    if free is not None and free.any():
        lack[free] = 0.0
        return np.asarray(wanted + lack[fluid] * wanted * movable / np.maximum(part[fluid], 1e-300))
    # A fluid without a component cannot get its volume back; the others must still fill the tank.
    lack -= (lack.sum() + wanted.sum() - volume.sum()) * part / part.sum()
    return np.asarray(wanted + lack[fluid] * wanted * movable / np.maximum(part[fluid], 1e-300))


def sliding_contacts(mesh: Mesh, slides: Array) -> tuple[Array, Array, Array]:
    """Contacts of interfaces that may move along straight walls, and the directions of these.

    Args:
        mesh: triangles with their components.
        slides: (N,) mask of the particles that may move along their walls. Those whose interface is less than `STEEP`
            from their wall stay: what restoring takes from the contact of a thin front would hold it back.

    Returns:
        (S,) numbers of the contacts, int32; (S, 2) unit vectors along their walls; and the cells at such particles.
    """
    assert mesh.components is not None
    count = len(slides)
    sizes = {"nodes": count, "near": len(mesh.cells), "found": 2}
    nodes, near, found = (scratch(f"contacts.{name}", size, np.int32) for name, size in sizes.items())
    tangent, length = scratch("contacts.tangent", (count, 2)), scratch("contacts.length", count)
    flag = scratch("contacts.flag", count, np.int8)
    launch(
        kernels.list_contacts,
        mesh.position,
        *(np.ascontiguousarray(values) for values in (mesh.cells, mesh.neighbours, mesh.fluid)),
        mesh.period.array,
        mesh.components.mark,
        slides.view(np.int8),
        float(np.cos(STEEP)),
        flag,
        length,
        kernels.Contacts(tangent, nodes, near, found),
    )
    there = nodes[: found[0]].copy()
    return there, tangent[there], near[: found[1]].copy()


def factors(pair: Array, product: Array, missing: Array) -> Array:
    """Factors (K,) of the gradients that change volumes as wanted, by least squares.

    The volumes sum to that of the tank, so that one combination of the factors has no effect: the matrix is singular.
    Conjugate gradients, in MINRES' form, solve such systems. The matrix of a fluid with K - 1 drops in it, scaled to a
    diagonal of 1, has few different eigenvalues: about ten iterations.

    Args:
        pair: (P, 2) of components, see `volume_kernels.products`.
        product: (P,) of their gradients, summed to the matrix [m^2].
        missing: (K,) volumes [m^2].
    """
    count = len(missing)
    if count <= FEW:
        index = pair[:, 0].astype(np.int64) * count + pair[:, 1]
        dense = np.bincount(index, weights=product, minlength=count * count).reshape(count, count)
        return np.asarray(np.linalg.lstsq(dense, missing, rcond=TRUNCATED)[0])
    matrix = sparse.coo_matrix((product, pair.T), shape=(count, count)).tocsr()
    diagonal = matrix.diagonal()
    scale = np.where(diagonal > TRUNCATED * diagonal.max(), 1.0 / np.sqrt(np.maximum(diagonal, 1e-300)), 0.0)
    scaled = sparse.diags(scale) @ matrix @ sparse.diags(scale)
    return np.asarray(scale * minres(scaled, scale * missing, rtol=1e-14, maxiter=count)[0])


def move_interfaces(
    mesh: Mesh,
    volume: Array,
    wanted: Array,
    limit: float,
    slides: Array | None = None,
    places: Places | None = None,
    left: Array | None = None,
) -> Mesh:
    """Move the interfaces of a mesh until its components have the volumes wanted.

    Every movable particle is displaced by sum_k lambda_k dV_k / dx, with the factors lambda that give the volumes, in
    a few rounds, because volumes are quadratic in positions. Contacts on walls that slip move along these, by twice the
    part of dV_k / dx in that direction, see `volume_kernels.gradients`: if they stayed, the interface would lag behind
    at the wall.

    Args:
        mesh: M triangles with their components.
        volume: (K,) of the components [m^2].
        wanted: (K,) volumes [m^2].
        limit: of a particle's displacement in one round [m].
        slides: (N,) mask of the particles that may move along their walls; none by default.
        places: near which particles may move; everywhere by default.
        left: (K,) mask of components that have what the others leave; none by default.

    Returns:
        The same triangles at the new positions, with their areas.
    """
    components = mesh.components
    assert components is not None
    nodes, near, label = components.movable_particles, components.interface_cells, components.label
    if not len(nodes):
        return mesh
    if places is not None:
        nodes = places.beside(mesh, nodes)
        if not len(nodes):
            return mesh
    tangent = np.zeros((len(nodes), 2))
    if slides is not None:
        contacts, along, cells = sliding_contacts(mesh, slides)
        if len(contacts):
            nodes, tangent = np.append(nodes, contacts), np.concatenate([tangent, along])
            either = filled(False, "volumes.either", len(mesh.cells), bool)
            either[near] = either[cells] = True
            near = np.flatnonzero(either).astype(np.int32)
    x, measure = copied(mesh.position), copied(mesh.measure)
    size = 3 * len(near), 2
    entries = kernels.Gradients(
        filled(kernels.FIXED, "volumes.head", len(x), np.int32),
        scratch("volumes.chain", size, np.int32),
        scratch("volumes.gradient", size),
    )
    displacement = scratch("volumes.displacement", (len(x), 4))
    total = (wanted if left is None else wanted[~left]).sum()
    for _ in range(ROUNDS if left is None else ROUNDS_AT_SURFACES):
        missing = wanted - volume
        if left is not None:
            missing[left] = 0.0
        if np.abs(missing).max() <= 1e-14 * total:
            break
        gain = np.zeros(len(wanted))
        given = x, mesh.cells, mesh.period.array, label, near, nodes
        pairs = launch(kernels.gradients, *given, tangent, entries)
        pair, product = np.empty((pairs, 2), dtype=np.int32), np.empty(pairs)
        launch(kernels.products, nodes, tangent, entries, pair, product)
        if left is not None:
            product[left.take(pair).any(axis=1)] = 0.0
        factor = factors(pair, product, missing)
        moved = launch(kernels.shift_interfaces, *given, entries, factor, displacement, measure, gain, limit)
        if not moved:
            break
        volume = volume + gain
    return mesh.moved(x, measure)
